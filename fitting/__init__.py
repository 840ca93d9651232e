"""Fitting simulated droppers to measured traces; it builds on `dropper_jax`, never the other way round."""

import dropper_jax  # noqa: F401 - turns on float64 before anything is traced
from fitting.fit import fit, prepare
from fitting.result import FitResult
from fitting.traces import Convention, Trace, read_trace, write_trace

__all__ = ["Convention", "FitResult", "Trace", "fit", "prepare", "read_trace", "write_trace"]
