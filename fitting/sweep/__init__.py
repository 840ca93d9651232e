"""Grids of cases in batches over all devices, stored chunk by chunk, resumable; and scored against a trace."""

from fitting.sweep.against_trace import sweep_against_trace
from fitting.sweep.plan import QUANTITIES
from fitting.sweep.run import SweepResult, open_sweep, sweep
from fitting.sweep.scores import TraceScores
from fitting.sweep.store import SweepStopped

__all__ = [
    "QUANTITIES",
    "SweepResult",
    "SweepStopped",
    "TraceScores",
    "open_sweep",
    "sweep",
    "sweep_against_trace",
]
