"""Names for extensions: effects of your own, their fields and errors (see docs/python.md)."""

from dropper_jax.base.errors import SceneError, SimulationError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects import Effect, register
from dropper_jax.model import Kinematics
from dropper_jax.scene.data import SceneData

__all__ = [
    "Effect",
    "Kinematics",
    "SceneData",
    "SceneError",
    "SimulationError",
    "component",
    "nearest",
    "option",
    "parameter",
    "register",
    "safe_norm",
    "scatter_add",
]
