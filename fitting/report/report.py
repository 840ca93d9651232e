"""The report of a fit: Markdown and pictures in one folder, each file written atomically."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write, prepare_folder
from dropper_jax.base.markdown import Rows, bullets, literal, markdown_table
from dropper_jax.base.toml_text import as_toml
from dropper_jax.plots import figures, scales, style
from dropper_jax.run.build import build_model, equilibrium
from dropper_jax.statics.modes import damping_at, natural_modes
from fitting.calibration.decision import verdict
from fitting.calibration.prediction import Prediction, predict
from fitting.calibration.result import FitResult, direction_text
from fitting.channels.result import ChannelFit
from fitting.estimate.scene_fit import SceneFit
from fitting.parameters.fitted_scene import fitted_scene
from fitting.report.channel_tables import between_rows, channel_rows, channel_summary, sensitivity_rows
from fitting.report.pictures import PICTURES, channel_picture, descent, fit_over_trace, link_panels
from fitting.report.tables import (
    advice_rows,
    comparison_rows,
    interval_rows,
    law_rows,
    named_rows,
    parameter_rows,
    summary,
)
from fitting.traces.noise import column_medians
from fitting.traces.trace import Trace

#: Parts of a trace [s]: those of the thesis, whose traces end at 50 s.
TRACE_PARTS = (("head", -np.inf, 12.0), ("middle", 12.0, 25.0), ("tail", 25.0, np.inf))


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
        *_first_parts(result, f"Method `{result.method}`; status"),
        *_quality(summary(result)),
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
        *_warnings(result),
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


def _first_parts(result: SceneFit, status: str) -> list[str]:
    """Title, status and parameters of any fit."""
    message = ""
    if result.message:
        message = f": {result.message}"
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


def _quality(facts: Sequence[tuple[str, str]]) -> list[str]:
    """Facts about a fit."""
    return ["## Quality", bullets(f"{name}: {value}" for name, value in facts)]


def _warnings(result: SceneFit) -> list[str]:
    """The warnings of any fit."""
    return ["## Warnings", bullets(map(literal, result.warnings)) or "None."]


def write_channel_report(result: ChannelFit, folder: str | Path) -> list[Path]:
    """Write `report.md`, a picture of every run, and `fitted.toml`, the scene with the fitted values; if runs have
    separate values, one scene each, `fitted_RUN.toml`."""
    folder = prepare_folder(folder, "report.md")
    runs = result.solution.problem.data.runs
    files = [channel_picture(result, i, folder / f"channels_{i + 1}.png") for i in range(len(runs))]
    files += write_scenes(result, folder)
    between = []
    if result.between:
        between = ["## Over the runs", markdown_table(*between_rows(result))]
    parts = [
        *_first_parts(result, "Status"),
        *between,
        "## Channels",
        markdown_table(*channel_rows(result)),
        "## Sensitivity",
        "The percentage by which a channel changes for a change of a parameter by 1 %: for tensions relative to their "
        "root mean square, for other channels relative to their standard deviation.",
        markdown_table(*sensitivity_rows(result)),
        *_quality(channel_summary(result)),
        *_warnings(result),
        *(f"## {literal(run.name)}\n\n![{literal(run.name)}](channels_{i + 1}.png)" for i, run in enumerate(runs)),
    ]
    files.append(atomic_write(folder / "report.md", "\n\n".join(parts) + "\n"))
    return files


def write_scenes(result: ChannelFit, folder: Path) -> list[Path]:
    """The fitted scenes as TOML."""
    scenes = {f"fitted_{run.name}.toml": i for i, run in enumerate(result.solution.problem.data.runs)}
    if not result.between and not any(run.own for run in result.solution.problem.data.runs):
        scenes = {"fitted.toml": 0}
    return [atomic_write(folder / name, as_toml(result.fitted_scene(i).as_written())) for name, i in scenes.items()]


def _modes(result: FitResult) -> str:
    """Periods and damping ratios of the slowest modes with the fitted values, about the pose at rest."""
    model = build_model(fitted_scene(result.scene, result.model, result.parameters, result.values))
    pose = equilibrium(model)
    if pose.status != "ok" or pose.state is None:
        return f"No equilibrium was found: {pose.message}."
    modes = natural_modes(model, pose.state, 6)
    amplitude = 0.1 * float(np.mean(model.line.length))
    large = damping_at(model, pose.state, modes, amplitude)
    columns = enumerate(zip(modes.period, modes.damping_ratio, large, strict=True), start=1)
    rows = [(str(i), f"{period:.4g}", f"{small:.3g}", f"{ratio:.3g}") for i, (period, small, ratio) in columns]
    swings = ("damping ratio, small swings (b_l)", f"swings of {amplitude:.3g} m (b_l and b_q)")
    return markdown_table(("mode", "period [s]", *swings), *rows)


def part_rows(result: FitResult) -> Rows:
    """RMS angle error of head, middle and tail of every run, per link and in all."""
    links = result.windows.theta.shape[2]
    rows = [("run", "part", *(f"link {j + 1}" for j in range(links)), "all")]
    for run, trace in fitted_runs(result):
        t, measured, simulated = fit_over_trace(result, run)
        for name, low, high in TRACE_PARTS:
            inside = (t >= low) & (t < high)
            if not inside.any():
                continue
            square = (measured[inside] - simulated[inside]) ** 2
            each = np.sqrt(np.ma.masked_invalid(square).mean(axis=0).filled(np.nan))  # NaN of a link without samples
            cells = [f"{x:.3g}" for x in (*each, np.sqrt(np.nanmean(square)))]
            rows.append((trace.name, f"{name} {max(low, t[0]):.3g}-{min(high, t[-1]):.3g} s", *cells))
    return rows


@style.plot_style()
def one_run_picture(found: Prediction, name: str, path: Path) -> Path:
    """Measured angles and the run, per link [rad from the horizontal]; faint beyond the prediction horizon."""
    title = f"{name}: one run over the trace [rad from the horizontal]"
    figure, axes = link_panels(found.measured.shape[1], title, margin=1.5)
    good = found.t <= found.trusted
    # whole turns are removed once, where the run is reliable
    turns = np.nan_to_num(column_medians((found.measured - found.simulated)[good])) / (2 * np.pi)
    simulated = found.simulated + 2 * np.pi * np.round(turns)
    beyond = {"lw": 0.8, "color": style.FIRST, "alpha": 0.55, "label": "beyond the prediction horizon"}
    for j, ax in enumerate(axes):
        ax.plot(found.t, found.measured[:, j], ".", ms=1.2, color=style.DARK, label="measured")
        ax.plot(found.t[good], simulated[good, j], lw=1.4, color=style.FIRST, label="one run")
        if not good.all():
            ax.plot(found.t[~good], simulated[~good, j], **beyond)
            ax.axvline(found.trusted, color=style.SECOND, lw=1.0, ls="--")
    figures.legend_above(axes[0], 3, markerscale=4)
    scales.time_axis(axes[-1], found.t)
    return figures.save(figure, path)
