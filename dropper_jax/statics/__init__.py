"""Poses at rest."""

from dropper_jax.statics.static_pose import Equilibrium, equilibrium, nodal_loads, rest, settle

__all__ = ["Equilibrium", "equilibrium", "nodal_loads", "rest", "settle"]
