"""The sea: waves, current and their kinematics at a position."""

from dropper_jax.sea.current import Current
from dropper_jax.sea.water import Sea, Water
from dropper_jax.sea.waves import Motion, Waves

__all__ = ["Current", "Motion", "Sea", "Water", "Waves"]
