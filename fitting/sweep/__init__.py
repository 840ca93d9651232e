"""Grids of cases in batches over all devices, kept chunk by chunk, resumable."""

from fitting.sweep.plan import QUANTITIES
from fitting.sweep.run import SweepResult, SweepStopped, open_sweep, sweep

__all__ = ["QUANTITIES", "SweepResult", "SweepStopped", "open_sweep", "sweep"]
