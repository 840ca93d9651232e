"""Facts about a fit, as rows and pairs for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fitting.calibration.advice import Candidate
from fitting.calibration.law_fits import Law
from fitting.calibration.result import FitResult
from fitting.estimate.scene_fit import SceneFit


def parameter_rows(result: SceneFit) -> list[tuple[str, ...]]:
    """Name, value, error, interval, unit and remarks of every parameter, with a heading."""
    u = result.uncertainty
    rows = [("parameter", "value", "std error", "90 % low", "high", "unit", "")]
    for i, p in enumerate(result.parameters):
        digits = significant(result.values[i], u.std_error[i])
        ends = (f"{x:.{digits}g}" for x in (u.low[i], u.high[i]))
        row = (f"{result.values[i]:.{digits}g}", f"{u.std_error[i]:.2g}", *ends)
        rows.append((p.name, *row, p.unit, result.note(i)))
    return rows


def interval_rows(result: SceneFit) -> list[tuple[str, ...]]:
    """90 % intervals by profile likelihood, bootstrap and posterior, if requested, with a heading."""
    rows = [("parameter", "by", "90 % low", "high")]
    digits = {
        p.name: significant(v, s)
        for p, v, s in zip(result.parameters, result.values, result.uncertainty.std_error, strict=True)
    }
    for p in result.profiles:
        by = "profile" if p.converged else "profile, not converged"
        rows.append((p.name, by, *(f"{x:.{digits[p.name]}g}" for x in (p.low, p.high))))
    if result.bootstrap is not None:
        for name, found in result.bootstrap_table().items():
            rows.append((name, "bootstrap", *(f"{found[key]:.{digits[name]}g}" for key in ("low", "high"))))
    if result.posterior is not None:
        for name, found in result.posterior.to_json()["parameters"].items():
            rows.append((name, "posterior", *(f"{found[key]:.{digits[name]}g}" for key in ("low", "high"))))
    return rows


def noise_text(result: FitResult) -> str:
    """Size and kind of the noise estimated from the residuals."""
    found = result.noise_table()
    sizes = ", ".join(f"{x:.2g}" for x in np.ravel(found["sigma_rad"])[:8])
    more = ", ..." if np.size(found["sigma_rad"]) > 8 else ""
    kind = {
        "white": "",
        "correlated": f"; a sample keeps {np.mean(found.get('kept', 0)):.2g} of the previous one",
        "jitter": f"; frame times have errors of {np.mean(found.get('delay_s', 0)) * 1e3:.2g} ms",
    }
    return f"{sizes}{more} rad by link{kind[found['kind']]}"


def significant(value: float, error: float) -> int:
    """Digits that show a value down to the second digit of its error."""
    if not (error > 0 and np.isfinite(error) and value != 0):
        return 5
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(error)) + 2, 3, 12))


def step_text(result: SceneFit, step: float) -> str:
    """The step [s], and how far it shifts the estimates."""
    bias = result.step_bias
    moves = (
        "" if bias is None else f", shifts the estimates by {np.nanmax(np.abs(bias), initial=0):.2g} standard errors"
    )
    return f"{step:.3g} s{moves}"


def combination(result: FitResult) -> list[tuple[str, str]]:
    """The best-determined combination of linear and quadratic damping, if both are fitted."""
    best = result.best_combination
    if best is None:
        return []
    text = (
        f"b_l + ({best['speed_m_per_s']:.3g} m/s) b_q = {best['value']:.5g} +- {best['std_error']:.2g} {best['unit']}"
    )
    return [("best determined", text)]


def window_lengths(result: FitResult) -> str:
    """Lengths of the windows, which follow the motion."""
    shortest, longest = result.windows.lengths.min(), result.windows.length
    return f"{longest:.3g} s" if longest < 1.01 * shortest else f"{shortest:.3g} to {longest:.3g} s"


def summary(result: FitResult) -> list[tuple[str, str]]:
    """Further facts about a fit."""
    gap = result.solution.gap_weight
    joined = "separate" if gap is None else "joined exactly" if gap == 0 else f"joined, gap weight {gap:g}"
    pairs = [
        ("windows", f"{result.windows.count} of {window_lengths(result)}, {joined}"),
        ("error", f"{result.rms:.3g} rad RMS, noise {result.noise:.3g} rad, chi2 per dof {result.chi2_per_dof:.3g}"),
        ("noise of the residuals", noise_text(result)),
        *combination(result),
        ("time step", step_text(result, result.windows.dt / result.windows.substeps)),
        ("chaos", f"small errors grow as exp({result.lyapunov:.2g} t)"),
        ("iterations", f"{result.iterations}"),
        ("wall time", f"{result.seconds['compile']:.1f} s compilation, {result.seconds['run']:.1f} s run"),
    ]
    if descent := result.descent:
        pairs.append(
            (
                "descent",
                f"{len(descent) - 1} steps, loss per sample {descent[0]['loss']:.3g} to {descent[-1]['loss']:.3g}",
            )
        )
    pairs += [(f"held out {h.low:g}-{h.high:g} s", f"{h.rms:.3g} rad RMS") for h in result.held_out]
    return pairs


def comparison_rows(laws: Sequence[Law]) -> list[tuple[str, ...]]:
    """The table as text."""
    lowest = min(law.bic for law in laws)
    rows = [
        ("law", "coefficients", "rms [rad]", "held out [rad]", "+- to best", "log score", "share", "BIC - minimum", "")
    ]
    for law in laws:
        numbers = (f"{law.rms:.4g}", f"{law.held_out:.4g}", f"{law.held_out_error:.2g}")
        scores = (f"{law.score:.1f} +- {law.score_error:.1f}", f"{law.share:.0%}", f"{law.bic - lowest:.1f}")
        name = " = ".join((law.name, *law.equals))
        note = "<- simplest possible" if law.chosen else "possible" if law.possible else law.refuted
        rows.append((name, str(law.coefficients), *numbers, *scores, note))
    return rows


def advice_rows(candidates: Sequence[Candidate]) -> list[tuple[str, ...]]:
    """Other possible faults, as text."""
    rows = [("may be wrong", "frees", "gain", "p", "")]
    for row in candidates:
        note = (
            " or ".join(["<-", *row.alike])
            if row.worth_naming
            else ""
            if row.identifiable
            else "indistinguishable from free parameters"
        )
        numbers = (f"{row.gain:.1f}", f"{row.p:.2g}") if row.identifiable else ("-", "-")
        rows.append((row.name, ",".join(row.free), *numbers, note))
    return rows
