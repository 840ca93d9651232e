"""Facts about a fit, as rows and pairs for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.markdown import Rows, cells, text_row
from fitting.calibration.candidate import Candidate
from fitting.calibration.disagreement import STRETCHES, Disagreement
from fitting.calibration.result import FitResult
from fitting.estimate.scene_fit import SceneFit
from fitting.laws.law_tests import LawTests
from fitting.laws.laws import Law


def parameter_rows(result: SceneFit) -> Rows:
    """Name, value, error, interval, unit and remarks of every parameter, with a heading; a failed fit has no errors."""
    u = result.uncertainty
    rows = [("parameter", "value", "std error", "90 % low", "high", "unit", "")]
    for i, p in enumerate(result.parameters):
        digits = significant(result.values[i], u.std_error[i])
        value, *errors = cells((result.values[i], u.low[i], u.high[i]), f".{digits}g")
        errors = [f"{u.std_error[i]:.2g}", *errors]
        if not result.has_errors:
            errors = ["-", "-", "-"]
        rows.append((p.name, value, *errors, p.unit, result.note(i)))
    return rows


def interval_rows(result: SceneFit) -> Rows:
    """90 % intervals by profile likelihood and bootstrap, if requested, with a heading."""
    estimates = result.estimates()
    rows = [("parameter", "by", "90 % low", "high")]
    for by, table in result.intervals().items():
        for name, found in table.items():
            digits = significant(estimates[name]["value"], estimates[name]["std_error"])
            note = ""
            if not found.get("converged", True):
                note = ", not converged"
            rows.append((name, by + note, *cells((found["low"], found["high"]), f".{digits}g")))
    return rows


def named_rows(corner: str, columns: Sequence[str], names: Sequence[str], numbers: np.ndarray, style: str) -> Rows:
    """A matrix of numbers with names of its rows and columns."""
    rows = [(corner, *columns)]
    for name, row in zip(names, numbers, strict=True):
        rows.append((name, *cells(row, style)))
    return rows


#: Maximum number of links whose noise is listed.
MOST_NOISE_SIZES = 8


def noise_text(result: FitResult) -> str:
    """Size and kind of the noise estimated from the residuals."""
    noise = result.noise_table()
    sizes = [f"{size:.2g}" for size in np.ravel(noise["sigma_rad"])]
    if len(sizes) > MOST_NOISE_SIZES:
        sizes = [*sizes[:MOST_NOISE_SIZES], "..."]
    text = f"{', '.join(sizes)} rad by link"
    if noise["kind"] == "correlated":
        return f"{text}; a sample keeps {np.mean(noise['kept']):.2g} of the previous one"
    if noise["kind"] == "jitter":
        return f"{text}; frame times have errors of {np.mean(noise['delay_s']) * 1e3:.2g} ms"
    return text


def significant(value: float, error: float) -> int:
    """Digits that show a value down to the second digit of its error."""
    if not (error > 0 and np.isfinite(error) and value != 0):
        return 5
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(error)) + 2, 3, 12))


def step_text(result: SceneFit, step: float) -> str:
    """The step [s], and how far it shifts the estimates."""
    bias = result.step_bias
    if bias is None:
        return f"{step:.3g} s"
    return f"{step:.3g} s, shifts the estimates by {np.nanmax(np.abs(bias), initial=0):.2g} standard errors"


def summary(result: FitResult) -> list[tuple[str, str]]:
    """Further facts about a fit."""
    gap = result.solution.gap_weight
    shortest = result.windows.lengths.min()
    longest = result.windows.length
    lengths = f"{longest:.3g} s"
    if longest >= 1.01 * shortest:
        lengths = f"{shortest:.3g} to {lengths}"
    joined = "separate" if gap is None else f"joined, gap weight {gap:g}"
    pairs = [
        ("windows", f"{result.windows.count} of {lengths}, {joined}"),
        ("error", f"{result.rms:.3g} rad RMS, noise {result.noise:.3g} rad, chi2 per dof {result.chi2_per_dof:.3g}"),
        ("noise of the residuals", noise_text(result)),
    ]
    if result.has_errors and (best := result.best_combination) is not None:
        text = "b_l + ({0.speed_m_per_s:.3g} m/s) b_q = {0.value:.5g} +- {0.std_error:.2g} {0.unit}"
        pairs.append(("best determined", text.format(best)))
    pairs += [
        ("time step", step_text(result, result.windows.dt / result.windows.substeps)),
        ("chaos", f"small errors grow as exp({result.lyapunov:.2g} t)"),
        ("iterations", f"{result.iterations}"),
        ("wall time", "{compile:.1f} s compilation, {run:.1f} s run".format(**result.seconds)),
    ]
    if descent := result.descent:
        losses = f"loss per sample {descent[0]['loss']:.3g} to {descent[-1]['loss']:.3g}"
        pairs.append(("descent", f"{len(descent) - 1} steps, {losses}"))
    return pairs + [(f"held out {h.low:g}-{h.high:g} s", f"{h.rms:.3g} rad RMS") for h in result.held_out]


def comparison_rows(laws: Sequence[Law]) -> Rows:
    """The table as text."""
    lowest = min(law.bic for law in laws)
    rows = [
        ("law", "coefficients", "rms [rad]", "held out [rad]", "+- to best", "log score", "share", "BIC - minimum", "")
    ]
    numbers = (
        "{0.coefficients}|{0.rms:.4g}|{0.held_out:.4g}|{0.held_out_error:.2g}|{0.score:.1f} +- {0.score_error:.1f}|"
        "{0.share:.0%}|{1:.1f}"
    )
    for law in laws:
        note = law.refuted
        if law.chosen:
            note = "<- simplest possible"
        elif law.possible:
            note = "possible"
        rows.append((" = ".join((law.name, *law.equals)), *text_row(numbers, law, law.bic - lowest), note))
    return rows


def advice_rows(candidates: Sequence[Candidate]) -> Rows:
    """Other possible faults, as text."""
    rows = [("may be wrong", "frees", "gain", "p", "")]
    for row in candidates:
        numbers = ("-", "-")
        note = "indistinguishable from free parameters"
        if row.identifiable:
            numbers = text_row("{0.gain:.1f}|{0.p:.2g}", row)
            note = ""
        if row.identifiable and row.worth_naming:
            note = " or ".join(["<-", *row.alike])
        rows.append((row.name, ",".join(row.free), *numbers, note))
    return rows


def recording_rows(rows: Sequence[Disagreement]) -> Rows:
    """Where recordings of one motion disagree, as text."""
    found = [
        ("recording", "link", "samples", "RMS [rad]", "noise [rad]", "farthest off [rad]", "std error", "at [s]", "")
    ]
    numbers = (
        "{0.link}|{0.samples}|{0.rms:.3g}|{0.noise:.3g}|{0.mean:+.2g}|{0.std_error:.1g}|{0.low:.3g} to {0.high:.3g}"
    )
    for row in rows:
        note = ""
        if row.disagrees:
            note = f"<- disagrees in {row.stretches} of {STRETCHES} stretches"
        found.append((row.recording, *text_row(numbers, row), note))
    return found


def law_rows(laws: LawTests) -> Rows:
    """Score tests of forces that the scene lacks, as text."""
    rows = [("the scene may lack", "size", "std error", "t", "p over all", "changes a value", "frees it")]
    for test in laws.tests:
        numbers = text_row("{0.change:.3g}|{0.error:.2g}|{0.t:.1f}|{0.p:.2g}", test)
        name = " or ".join((test.name, *test.alike))
        matters = "yes" if test.matters else "no"
        rows.append((name, *numbers, matters, ",".join(test.free) or "-"))
    return rows
