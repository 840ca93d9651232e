"""The sea: waves, current and their kinematics at a position."""

from dropper_jax.sea.water import Current, Sea, Water
from dropper_jax.sea.waves import Motion, Waves

__all__ = ["Current", "Motion", "Sea", "Water", "Waves"]
