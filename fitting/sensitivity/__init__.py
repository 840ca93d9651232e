"""Sensitivity of a quantity: exact derivatives along the whole run, and indices over ranges of parameters."""

from dropper_jax.run.quantities import quantity
from fitting.sensitivity.derivatives import Local, local, windows
from fitting.sensitivity.problem import Study, ranges, study
from fitting.sensitivity.screening import Global, global_indices

__all__ = ["Global", "Local", "Study", "global_indices", "local", "quantity", "ranges", "study", "windows"]
