"""Many members of one function side by side in the registers of a processor."""

from dropper_jax.lanes.batch import lanes
from dropper_jax.lanes.interpreter import Fallbacks

__all__ = ["Fallbacks", "lanes"]
