"""The report of a fit to channels: Markdown, a picture of every run and the fitted scenes in one folder."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.files import atomic_write, prepare_folder
from dropper_jax.base.markdown import literal, markdown_table
from dropper_jax.base.toml_text import as_toml
from dropper_jax.plots import figures, style
from fitting.channels.result import ChannelFit
from fitting.report.channel_tables import between_rows, channel_rows, channel_summary, sensitivity_rows
from fitting.report.report import first_parts, quality_parts, warnings_parts

#: Maximum length of the name of a run in that of a file [bytes]; 255 in all, which unfinished files have to meet too.
LONGEST_NAME = 160
#: Maximum number of columns of channels in one picture.
MOST_COLUMNS = 6


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
        *first_parts(result, "Status"),
        *between,
        "## Channels",
        markdown_table(*channel_rows(result)),
        "## Sensitivity",
        "The percentage by which a channel changes for a change of a parameter by 1 %: for tensions relative to their "
        "root mean square, for other channels relative to their standard deviation.",
        markdown_table(*sensitivity_rows(result)),
        *quality_parts(channel_summary(result)),
        *warnings_parts(result),
        *(f"## {literal(run.name)}\n\n![{literal(run.name)}](channels_{i + 1}.png)" for i, run in enumerate(runs)),
    ]
    files.append(atomic_write(folder / "report.md", "\n\n".join(parts) + "\n"))
    return files


def write_scenes(result: ChannelFit, folder: Path) -> list[Path]:
    """The fitted scenes as TOML, with the numbers of runs in place of names that are too long for a file."""
    runs = result.solution.problem.data.runs
    names = ["fitted.toml"]
    if result.between or any(run.own for run in runs):
        names = []
        for i, run in enumerate(runs):
            label = run.name if len(run.name.encode()) <= LONGEST_NAME else f"{i + 1}"
            names.append(f"fitted_{label}.toml")
    return [atomic_write(folder / name, as_toml(result.fitted_scene(i).as_written())) for i, name in enumerate(names)]


class ColumnPanel(NamedTuple):
    """A column of a channel in a run: its label, samples and the fitted run (k,), and its residuals.

    Attributes:
        known: times of the samples that are not missing [s], and `residual`, measured minus fitted over the noise.
    """

    label: str
    t: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    known: np.ndarray
    residual: np.ndarray


def column_panels(result: ChannelFit, run: int) -> list[ColumnPanel]:
    """The columns of all channels in a run."""
    problem = result.solution.problem
    shown = result.solution.evaluation.shown
    deviations = problem.data.deviations(shown)[..., None] * problem.windows.weight
    found = []
    for block, (r, c, known, j) in enumerate(problem.data.columns()):
        if r != run:
            continue
        channel = problem.data.sensors[c].channel
        label = channel.name
        if len(channel.columns) > 1:
            label = f"{label}: {channel.columns[j]}"
        t = problem.data.runs[run].t[c]
        measured = problem.data.runs[run].values[c][:, j]
        residual = -deviations[block, : known.sum(), 0]
        found.append(ColumnPanel(f"{label} [{channel.measures}]", t, measured, shown[run][c][:, j], t[known], residual))
    return found


@style.plot_style()
def channel_picture(result: ChannelFit, run: int, path: str | Path) -> Path:
    """Measured samples, the fitted run, and residuals in units of the noise, of a run's first columns."""
    every = column_panels(result, run)
    panels = every[:MOST_COLUMNS]
    figure = figures.new_figure(9.0, 1.0 + 1.7 * len(panels))
    axes = figure.subplots(len(panels), 2, sharex=True, width_ratios=(3, 1), squeeze=False)
    for panel, (over, beside) in zip(panels, axes, strict=True):
        over.plot(panel.t, panel.measured, ".", ms=2, color=style.SECOND, label="measured")
        over.plot(panel.t, panel.fitted, "-", lw=0.9, color=style.DARK, label="fitted")
        over.set_ylabel(panel.label)
        beside.plot(panel.known, panel.residual, ".", ms=2, color=style.SECOND)
        beside.locator_params(axis="x", nbins=3)
        beside.axhline(0.0, color=style.DARK, lw=0.8)
    figures.legend_above(axes[0, 0], 2)
    title = result.solution.problem.data.runs[run].name
    if len(every) > len(panels):
        title += f" ({len(every) - len(panels)} further columns are not drawn)"
    axes[0, 0].set_title(title, loc="left")
    axes[0, 1].set_title("residual / noise", loc="left")
    for low in axes[-1]:
        low.set_xlabel("t [s]")
    return figures.save(figure, path)
