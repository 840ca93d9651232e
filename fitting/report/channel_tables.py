"""Tables of fits to channels."""

from __future__ import annotations

from fitting.channels.result import ChannelFit
from fitting.report.tables import named_rows, significant, step_text


def channel_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Every channel with its residuals, with a heading."""
    rows = [("channel", "kind", "samples", "RMS of residuals", "noise", "kept", "correlation left")]
    for row in result.channels():
        noise = f"{row['noise']:.3g} {row['noise_unit']}"
        if row["noise_unit"] == "-":
            noise = f"{100 * row['noise']:.3g} %"
        rows.append(
            (
                row["name"],
                row["kind"],
                str(row["samples"]),
                f"{row['rms']:.3g} {row['unit']}",
                noise,
                f"{row['kept']:.2g}",
                f"{row['correlation']:.2f}",
            )
        )
    return rows


def sensitivity_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Sensitivity of each channel to each parameter, with a heading."""
    names = [s.channel.name for s in result.solution.problem.data.sensors]
    return named_rows("parameter", names, result.solution.problem.names, result.errors.sensitivity, ".2g")


def between_rows(result: ChannelFit) -> list[tuple[str, ...]]:
    """Parameters over runs, with a heading."""
    rows = [("parameter", "mean", "std error", "90 % low", "high", "spread between runs", "runs")]
    for b in result.between:
        digits = significant(b.mean, b.std_error)
        numbers = (f"{b.mean:.{digits}g}", f"{b.std_error:.2g}", f"{b.low:.{digits}g}", f"{b.high:.{digits}g}")
        rows.append((b.name, *numbers, f"{b.spread:.2g}", str(len(b.values))))
    return rows


def channel_summary(result: ChannelFit) -> list[tuple[str, str]]:
    """Further facts about a fit to channels."""
    blocks = result.errors.blocks
    return [
        ("time step", step_text(result, result.solution.problem.dt)),
        ("errors from", f"{blocks} blocks of time" if blocks else "the noise"),
        ("runs", f"{result.iterations} with derivatives"),
        ("wall time", f"{result.seconds:.1f} s"),
    ]
