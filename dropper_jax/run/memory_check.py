"""Room that a run needs, in memory or on disk, told before it begins."""

from __future__ import annotations

import shutil
from pathlib import Path

import jax
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.model import Model, State
from dropper_jax.scene import RunSpec

#: Copies of all saved states that are in memory at once, as measured, where nothing is kept on disk.
COPIES = 5
#: On disk: as they come, as they are reported, and the file that is written of them.
COPIES_ON_DISK = 3
#: What else a process holds [bytes]: JAX, its programs.
BESIDE = 600_000_000
#: Share of what is left that a run may take.
SHARE = 0.9


def check_memory(model: Model, start: State, run: RunSpec, scratch: Path | None) -> None:
    """Refuse a run whose saved states have no room.

    Raises:
        SceneError: with what it needs and what is left.
    """
    size = run.saves * row_bytes(model, start)
    if scratch is None:
        left, need, where = available_memory(), COPIES * size + BESIDE, "memory"
        way = (
            "a larger run.save_every, a shorter run.duration, or `dropper run --out FILE.nc`, which keeps them on disk"
        )
    else:
        left, need, where = shutil.disk_usage(scratch).free, COPIES_ON_DISK * size, "disk"
        way = "a larger run.save_every, or a shorter run.duration"
    if need > SHARE * left:
        raise SceneError(
            f"run.duration: {run.duration:g} s are {run.saves} saved states, which need {in_words(need)} of {where}, "
            f"and {in_words(left)} are left; allowed: {way}"
        )


def row_bytes(model: Model, s: State) -> int:
    """Bytes of a saved state as it is reported: places and velocities of all nodes, tensions, angles, energies."""
    own = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((s.parted, s.own)))
    nodes = model.free_nodes + 2 * max(1, model.line.links // 8)
    return int(np.dtype(model.dtype).itemsize * (2 * 3 * nodes + 3 * model.line.links + 16) + own)
