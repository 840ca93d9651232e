"""Bootstrap of a fit: estimates from blocks of time drawn with replacement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.blocks import block_length, resample, time_pieces
from fitting.estimate.scene_fit import SceneFit
from fitting.estimate.uncertainty import FEW_BLOCKS


class Bootstrap(NamedTuple):
    """Parameters (draws, k) of a bootstrap, and its effective number of blocks of time."""

    draws: np.ndarray
    blocks: float

    @property
    def warning(self) -> str:
        """One line if blocks are few, otherwise empty."""
        if self.blocks >= FEW_BLOCKS:
            return ""
        uncertain = 100 / np.sqrt(2 * max(self.blocks - 1, 1))
        return (
            f"the bootstrap draws from the equivalent of {self.blocks:.1f} blocks of time, fewer than {FEW_BLOCKS}: "
            f"the width of its intervals is uncertain by {uncertain:.0f} %. Use longer traces"
        )


def bootstrap(result: SceneFit, draws: int = 200, block: int | None = None, seed: int = 0) -> Bootstrap:
    """Parameters refitted, to first order, to blocks of time drawn with replacement (`blocks.resample`).

    The information of a draw is that of all stretches, because a draw of few may leave a parameter undetermined (Kline
    and Santos 2012).

    Args:
        block: number of stretches drawn together: windows, or parts of few ones; default two correlation times.

    Raises:
        SceneError: fewer than two draws, or blocks longer than half of the time.
    """
    check_draws(draws)
    solution = result.solution
    free = solution.free
    parts = time_pieces(solution, free)
    information = solution.free_information
    if block is None:
        block = block_length(parts, information)
    most = max(len(parts.run) // 2, 1)
    if not 1 <= block <= most:
        raise SceneError(f"bootstrap: blocks of {block} stretches; allowed: 1 to {most}, so that draws differ")
    moved, blocks = resample(parts, information, block, draws, np.random.default_rng(seed))
    found = np.tile(solution.values, (draws, 1))
    found[:, free] -= moved
    return Bootstrap(np.clip(found, *solution.problem.bounds(solution.values)), blocks)


def check_draws(draws: int) -> None:
    """Reject a number of draws that has no spread."""
    if draws < 2:
        raise SceneError(f"bootstrap: {draws} draws are too few; allowed: 0 or at least 2")
