"""Tables of fits to channels."""

from __future__ import annotations

from dropper_jax.base.markdown import Rows, text_row
from fitting.channels.result import ChannelFit
from fitting.report.tables import named_rows, significant, step_text


def channel_rows(result: ChannelFit) -> Rows:
    """Every channel with its residuals, with a heading."""
    rows = [("channel", "kind", "samples", "RMS of residuals", "noise", "kept", "correlation left")]
    for row in result.channels():
        noise = f"{row['noise']:.3g} {row['noise_unit']}"
        if row["noise_unit"] == "-":
            noise = f"{100 * row['noise']:.3g} %"
        cells = "{0[name]}|{0[kind]}|{0[samples]}|{0[rms]:.3g} {0[unit]}|{1}|{0[kept]:.2g}|{0[correlation]:.2f}"
        rows.append(text_row(cells, row, noise))
    return rows


def sensitivity_rows(result: ChannelFit) -> Rows:
    """Sensitivity of each channel to each parameter, with a heading."""
    names = [s.channel.name for s in result.solution.problem.data.sensors]
    return named_rows("parameter", names, result.solution.problem.names, result.errors.sensitivity, ".2g")


def between_rows(result: ChannelFit) -> Rows:
    """Parameters over runs, with a heading."""
    rows = [("parameter", "mean", "std error", "90 % low", "high", "spread between runs", "runs")]
    cells = "{0.name}|{0.mean:.{1}g}|{0.std_error:.2g}|{0.low:.{1}g}|{0.high:.{1}g}|{0.spread:.2g}|{2}"
    for row in result.between:
        rows.append(text_row(cells, row, significant(row.mean, row.std_error), len(row.values)))
    return rows


def channel_summary(result: ChannelFit) -> list[tuple[str, str]]:
    """Further facts about a fit to channels."""
    errors_from = "the noise"
    if result.errors.blocks:
        errors_from = f"{result.errors.blocks} blocks of time"
    return [
        ("time step", step_text(result, result.solution.problem.dt)),
        ("errors from", errors_from),
        ("runs", f"{result.iterations} with derivatives"),
        ("wall time", f"{result.seconds:.1f} s"),
    ]
