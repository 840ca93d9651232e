"""Many members of one function computed side by side in the vector registers of a processor."""

from dropper_jax.lanes.batch import lanes
from dropper_jax.lanes.interpreter import Fallbacks

__all__ = ["Fallbacks", "lanes"]
