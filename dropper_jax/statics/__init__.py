"""Static equilibrium."""

from dropper_jax.statics.equilibrium import Equilibrium
from dropper_jax.statics.loads import nodal_loads
from dropper_jax.statics.rest_problem import rest
from dropper_jax.statics.static_pose import equilibrium, settle

__all__ = ["Equilibrium", "equilibrium", "nodal_loads", "rest", "settle"]
