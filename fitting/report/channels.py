"""The report of a fit to channels: tables, pictures, and the fitted scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write, folder_without
from dropper_jax.base.toml_text import as_toml, literal
from dropper_jax.plots import style
from dropper_jax.report.sections import markdown_table
from fitting.channels.result import ChannelFit
from fitting.report.tables import interval_rows, named_rows, parameter_rows, significant, step_text


def channel_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Every channel with its residuals, with a heading."""
    return [
        ("channel", "kind", "samples", "RMS of residuals", "noise", "kept", "correlation left"),
        *(
            (
                row["name"],
                row["kind"],
                str(row["samples"]),
                f"{row['rms']:.3g} {row['unit']}",
                f"{100 * row['noise']:.3g} %"
                if row["noise_unit"] == "-"
                else f"{row['noise']:.3g} {row['noise_unit']}",
                f"{row['kept']:.2g}",
                f"{row['correlation']:.2f}",
            )
            for row in result.channels()
        ),
    ]


def sensitivity_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Sensitivity of each channel to each parameter, with a heading."""
    names = [s.channel.name for s in result.solution.problem.data.sensors]
    return named_rows("parameter", names, [p.name for p in result.parameters], result.errors.sensitivity, ".2g")


def between_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Parameters over runs, with a heading."""
    rows = [("parameter", "mean", "std error", "90 % low", "high", "spread between runs", "runs")]
    for b in result.between:
        digits = significant(b.mean, b.std_error)
        numbers = (f"{b.mean:.{digits}g}", f"{b.std_error:.2g}", f"{b.low:.{digits}g}", f"{b.high:.{digits}g}")
        rows.append((b.name, *numbers, f"{b.spread:.2g}", str(len(b.values))))
    return rows


def summary(result: ChannelFit) -> list[tuple[str, str]]:
    """Further facts about a fit."""
    blocks = result.errors.blocks
    return [
        ("time step", step_text(result, result.solution.problem.dt)),
        ("errors from", f"{blocks} blocks of time" if blocks else "the noise"),
        ("runs", f"{result.iterations} with derivatives"),
        ("wall time", f"{result.seconds:.1f} s"),
    ]


def write_channel_report(result: ChannelFit, folder: str | Path) -> list[Path]:
    """Write `report.md`, a picture of every run, and `fitted.toml`, the scene with the fitted values; if runs have
    separate values, one scene each, `fitted_RUN.toml`."""
    folder = folder_without(folder, "report.md")
    runs = result.solution.problem.data.runs
    files = [picture(result, i, folder / f"channels_{i + 1}.png") for i in range(len(runs))]
    files += write_scenes(result, folder)
    parts = [
        f"# Fit of {literal(result.scene.name)}",
        f"Status **{result.status}**{': ' + result.message if result.message else ''}.",
        "## Parameters",
        markdown_table(parameter_rows(result)),
        *([] if len(rows := interval_rows(result)) == 1 else ["## Other intervals", markdown_table(rows)]),
        *(["## Over the runs", markdown_table(between_rows(result))] if result.between else []),
        "## Channels",
        markdown_table(channel_rows(result)),
        "## Sensitivity",
        "The percentage by which a channel changes for a change of a parameter by 1 %: for tensions relative to their "
        "root mean square, for other channels relative to their standard deviation.",
        markdown_table(sensitivity_rows(result)),
        "## Quality",
        "\n".join(f"- {name}: {value}" for name, value in summary(result)),
        "## Warnings",
        "\n".join(f"- {literal(warning)}" for warning in result.warnings) or "None.",
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


def picture(result: ChannelFit, run: int, path: str | Path) -> Path:
    """Measured samples, the fitted run, and residuals in units of the noise, of a run's first columns."""
    # maximum number of columns drawn in one picture
    most_columns = 6
    problem, e = result.solution.problem, result.solution.evaluation
    panels = []
    deviations = problem.data.deviations(e.shown)[..., None] * problem.windows.weight
    for block, (r, c, known, j) in enumerate(problem.data.columns()):
        channel, t, values = problem.data.sensors[c].channel, problem.data.runs[r].t[c], problem.data.runs[r].values[c]
        label = channel.name if len(channel.columns) == 1 else f"{channel.name}: {channel.columns[j]}"
        off = t[known], -deviations[block, : known.sum(), 0]
        if r == run:
            panels.append((f"{label} [{channel.measures}]", t, values[:, j], e.shown[r][c][:, j], off))
    left_out = len(panels) - most_columns
    panels = panels[:most_columns]
    with style.plot_style():
        figure = style.new_figure(9.0, 1.0 + 1.7 * len(panels))
        axes = np.atleast_2d(figure.subplots(len(panels), 2, sharex=True, width_ratios=(3, 1), squeeze=False))
        for (label, t, measured, shown, off), (over, beside) in zip(panels, axes, strict=True):
            over.plot(t, measured, ".", ms=2, color=style.SECOND, label="measured")
            over.plot(t, shown, "-", lw=0.9, color=style.DARK, label="fitted")
            over.set_ylabel(label)
            beside.plot(*off, ".", ms=2, color=style.SECOND)
            beside.locator_params(axis="x", nbins=3)
            beside.axhline(0.0, color=style.DARK, lw=0.8)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        more = f" ({left_out} further columns are not drawn)" if left_out > 0 else ""
        axes[0, 0].set_title(f"{problem.data.runs[run].name}{more}", loc="left")
        axes[0, 1].set_title("residual / noise", loc="left")
        for low in axes[-1]:
            low.set_xlabel("t [s]")
        return style.save(figure, path)
