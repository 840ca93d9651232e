"""Many members of one function side by side: `jax.vmap` with the member axis last in memory."""

from dropper_jax.lanes.batch_last import lanes

__all__ = ["lanes"]
