"""Sensitivity of a quantity: exact derivatives along the whole run, and indices over ranges of parameters."""

from fitting.sensitivity.derivatives import Global, Local, global_indices, local, windows
from fitting.sensitivity.problem import Study, ranges, study
from fitting.sensitivity.quantities import quantity

__all__ = ["Global", "Local", "Study", "global_indices", "local", "quantity", "ranges", "study", "windows"]
