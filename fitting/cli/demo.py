"""Calibration part of `dropper demo` (entry-point group `dropper.demo`): the packaged example."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.cli.printing import listing, table

if TYPE_CHECKING:
    from dropper_jax.base.progress import Progress
    from dropper_jax.cli.demo import DemoPart

title = "calibrating synthetic traces of scenarios A, B and C"


def run_part(folder: Path, progress: Progress | None) -> DemoPart:
    """The calibration part of `dropper demo`."""
    from dropper_jax.base.markdown import markdown_table
    from dropper_jax.base.progress import silent
    from dropper_jax.cli.demo import DemoPart
    from fitting.report.example import EXAMPLE, LABEL, calibrate_synthetic, calibrated_rows
    from fitting.report.tables import summary

    result = calibrate_synthetic(folder, EXAMPLE, progress=progress or silent)
    rows = calibrated_rows(result, EXAMPLE)
    heading = f"Calibration of {len(result.traces)} runs together ({LABEL})"
    status = result.outcome
    pictures = "\n".join(f"- [{trace.name}]({folder.name}/traces_{i + 1}.png)" for i, trace in enumerate(result.traces))
    return DemoPart(
        status=result.status,
        text="\n".join([heading, "", table(rows), "", listing(summary(result)), "", status]),
        markdown="\n\n".join(
            [f"## {heading}", markdown_table(*rows), f"Status {status}; [report]({folder.name}/report.md).", pictures]
        ),
        values={"synthetic": True, "truth": EXAMPLE.truth, "start": EXAMPLE.start, **result.to_json()},
    )
