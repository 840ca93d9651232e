"""Many members of one function computed side by side in the vector registers of a processor."""

from dropper_jax.lanes.interpreter import Fallbacks, lanes

__all__ = ["Fallbacks", "lanes"]
