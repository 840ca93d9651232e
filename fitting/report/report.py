"""The report of a fit: Markdown and pictures in one folder, each file written atomically."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write, prepare_folder
from dropper_jax.base.markdown import Rows, bullets, cells, literal, markdown_table
from dropper_jax.base.toml_text import as_toml
from dropper_jax.modelling.build import build_model, equilibrium
from dropper_jax.plots import figures, style
from dropper_jax.statics.modes import damping_at, natural_modes
from fitting.calibration.prediction import Prediction, predict
from fitting.calibration.result import FitResult, direction_text
from fitting.estimate.scene_fit import SceneFit
from fitting.laws.decision import verdict
from fitting.parameters.fitted_scene import fitted_scene
from fitting.report.pictures import PICTURES, descent, fit_over_trace, one_run_picture
from fitting.report.tables import (
    advice_rows,
    comparison_rows,
    interval_rows,
    law_rows,
    named_rows,
    parameter_rows,
    summary,
)
from fitting.traces.trace import Trace

#: Parts of a trace [s]: those of the thesis, whose traces end at 50 s.
PART_LIMITS = (("head", -np.inf, 12.0), ("middle", 12.0, 25.0), ("tail", 25.0, np.inf))
#: Number of modes in a report.
MODES = 6
#: Amplitude of their larger swings, over the mean length of a link.
LARGE_SWING = 0.1
#: Digits of a damping ratio: those beyond are rounding of the mode shapes.
RATIO_DIGITS = 6


def write_report(result: FitResult, folder: str | Path) -> list[Path]:
    """Write `report.md`, its pictures and `fitted.toml`, the scene with the fitted values; returns the files."""
    folder = prepare_folder(folder, "report.md")
    fitted = fitted_scene(result.scene, result.model, result.parameters, result.values)
    files = [atomic_write(folder / "fitted.toml", as_toml(fitted.as_written())), *draw_fit(result, folder)]
    runs = {}
    for run, trace in fitted_runs(result):
        found = predict(result, run)
        if found is not None:
            runs[run] = found
            files.append(one_run_picture(found, trace.name, folder / f"one_run_{run + 1}.png"))
    files.append(atomic_write(folder / "report.md", report(result, runs)))
    return files


@style.plot_style()
def draw_fit(result: FitResult, folder: str | Path) -> list[Path]:
    """The pictures of every fitted run, `NAME_RUN.png`, and of a descent, written to a folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for run, _ in fitted_runs(result):
        for name, draw in PICTURES.items():
            files.append(figures.save(draw(result, run), folder / f"{name}_{run + 1}.png"))
    if result.descent:
        files.append(figures.save(descent(result), folder / "descent.png"))
    return files


def fitted_runs(result: FitResult) -> list[tuple[int, Trace]]:
    """Number and trace of every run with fitted samples."""
    return [(run, trace) for run, trace in enumerate(result.traces) if (result.windows.run == run).any()]


def report(result: FitResult, full_runs: Mapping[int, Prediction]) -> str:
    """The Markdown text; `full_runs` are uninterrupted runs by the number of their trace."""
    names = result.solution.problem.names
    tests = []
    if result.laws.tests:
        tests = ["## Tests of the law", markdown_table(*law_rows(result.laws))]
    parts = [
        *first_parts(result, f"Method `{result.method}`; status"),
        *quality_parts(summary(result)),
        *tests,
        "## Errors along the trace",
        "RMS of measured minus fitted angles [rad], window by window, each with its own start.",
        markdown_table(*part_rows(result)),
        "## Damping of the slowest modes",
        _modes(result),
        "## Correlation",
        markdown_table(*named_rows("", names, names, result.uncertainty.correlation, ".3f")),
        "## What was not identifiable",
        bullets(map(direction_text, result.uncertainty.undetermined))
        or "Every direction is determined to better than its own size.",
        *warnings_parts(result),
    ]
    if result.descent:
        parts += ["## Descent", "Loss and parameters from step to step.", "![descent](descent.png)"]
    if result.advice:
        parts += ["## What may be wrong", markdown_table(*advice_rows(result.advice))]
    if result.comparison:
        parts += [
            "## Damping laws",
            verdict(result.comparison) + ".",
            markdown_table(*comparison_rows(result.comparison)),
        ]
    for run, trace in fitted_runs(result):
        parts.append(f"## {literal(trace.name)}")
        parts += [f"![{name}]({name}_{run + 1}.png)" for name in PICTURES]
        if run in full_runs:
            text = full_runs[run].text
            parts += [f"{text[0].upper()}{text[1:]}.", f"![one run](one_run_{run + 1}.png)"]
    return "\n\n".join(parts) + "\n"


def first_parts(result: SceneFit, status: str) -> list[str]:
    """Title, status and parameters of any fit."""
    message = f": {result.message}" if result.message else ""
    parts = [
        f"# Fit of {literal(result.scene.name)}",
        f"{status} **{result.status}**{message}.",
        "## Parameters",
        markdown_table(*parameter_rows(result)),
    ]
    rows = interval_rows(result)
    if len(rows) > 1:
        parts += ["## Other intervals", markdown_table(*rows)]
    return parts


def quality_parts(facts: Sequence[tuple[str, str]]) -> list[str]:
    """Facts about a fit."""
    return ["## Quality", bullets(f"{name}: {value}" for name, value in facts)]


def warnings_parts(result: SceneFit) -> list[str]:
    """The warnings of any fit."""
    return ["## Warnings", bullets(map(literal, result.warnings)) or "None."]


def _modes(result: FitResult) -> str:
    """Periods and damping ratios of the slowest modes with the fitted values, about the pose at rest."""
    model = build_model(fitted_scene(result.scene, result.model, result.parameters, result.values))
    pose = equilibrium(model)
    if pose.status != "ok" or pose.state is None:
        return f"No equilibrium was found: {pose.message}."
    modes = natural_modes(model, pose.state, MODES)
    amplitude = LARGE_SWING * float(np.mean(model.line.length))
    large = damping_at(model, pose.state, modes, amplitude)
    ratios = np.round([modes.damping_ratio, large], RATIO_DIGITS) + 0.0  # -0 becomes 0
    rows = []
    for i, (period, ratio) in enumerate(zip(modes.period, ratios.T, strict=True), start=1):
        rows.append((str(i), f"{period:.4g}", *cells(ratio, ".3g")))
    swings = ("damping ratio, small swings (b_l)", f"swings of {amplitude:.3g} m (b_l and b_q)")
    return markdown_table(("mode", "period [s]", *swings), *rows)


def part_rows(result: FitResult) -> Rows:
    """RMS angle error of head, middle and tail of every run, per link and in all."""
    links = result.windows.theta.shape[2]
    rows = [("run", "part", *(f"link {j + 1}" for j in range(links)), "all")]
    for run, trace in fitted_runs(result):
        t, measured, simulated = fit_over_trace(result, run)
        for name, low, high in PART_LIMITS:
            inside = (t >= low) & (t < high)
            if not inside.any():
                continue
            square = (measured[inside] - simulated[inside]) ** 2
            each = np.sqrt(np.ma.masked_invalid(square).mean(axis=0).filled(np.nan))  # NaN of a link without samples
            cells = [f"{x:.3g}" for x in (*each, np.sqrt(np.nanmean(square)))]
            rows.append((trace.name, f"{name} {max(low, t[0]):.3g}-{min(high, t[-1]):.3g} s", *cells))
    return rows
