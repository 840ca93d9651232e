"""Sensitivity of a quantity: derivatives along the whole run, and indices over ranges of parameters."""

from dropper_jax.quantities.quantity_names import quantity
from fitting.sensitivity.derivatives import local, windows
from fitting.sensitivity.global_indices import Global, global_indices, ranges
from fitting.sensitivity.problem import Study, check_step, study
from fitting.sensitivity.result import Local

__all__ = [
    "Global",
    "Local",
    "Study",
    "check_step",
    "global_indices",
    "local",
    "quantity",
    "ranges",
    "study",
    "windows",
]
