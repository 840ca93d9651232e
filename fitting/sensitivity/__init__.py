"""Sensitivity of a quantity: derivatives along the whole run, and indices over ranges of parameters."""

from dropper_jax.quantities.quantity_names import quantity
from fitting.sensitivity.derivatives import local_derivatives, window_means
from fitting.sensitivity.global_indices import GlobalIndices, global_indices, parameter_ranges
from fitting.sensitivity.problem import Study, check_step, study
from fitting.sensitivity.result import LocalDerivatives

__all__ = [
    "GlobalIndices",
    "LocalDerivatives",
    "Study",
    "check_step",
    "global_indices",
    "local_derivatives",
    "quantity",
    "parameter_ranges",
    "study",
    "window_means",
]
