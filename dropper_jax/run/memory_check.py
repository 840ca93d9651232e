"""Check before a run whether it fits in memory and on disk."""

from __future__ import annotations

import shutil
from pathlib import Path

import jax
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.model import Model, State
from dropper_jax.scene import RunSpec

#: Copies of all saved states in memory at once (measured), if nothing is stored on disk.
COPIES = 5
#: Copies on disk: the raw states, the observed states, and the output file.
COPIES_ON_DISK = 3
#: Memory of JAX and its programs [bytes].
BESIDE = 600_000_000
#: Fraction of the free memory that a run may use.
SHARE = 0.9


def check_memory(model: Model, start: State, run: RunSpec, scratch: Path | None) -> None:
    """Reject a run whose saved states do not fit.

    Raises:
        SceneError: with the required and the free size.
    """
    size = run.saves * row_bytes(model, start)
    if scratch is None:
        left, need, where = available_memory(), COPIES * size + BESIDE, "memory"
        way = (
            "a larger run.save_every, a shorter run.duration, or `dropper run --out FILE.nc`, which stores them on disk"
        )
    else:
        left, need, where = shutil.disk_usage(scratch).free, COPIES_ON_DISK * size, "disk"
        way = "a larger run.save_every, or a shorter run.duration"
    if need > SHARE * left:
        raise SceneError(
            f"run.duration: {run.duration:g} s give {run.saves} saved states, which need {in_words(need)} of {where}, "
            f"and {in_words(left)} are free. Use {way}"
        )


def row_bytes(model: Model, s: State) -> int:
    """Bytes of an observed state: positions and velocities of all nodes, tensions, angles, energies."""
    own = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((s.parted, s.own)))
    nodes = model.free_nodes + 2 * max(1, model.line.links // 8)
    return int(np.dtype(model.dtype).itemsize * (2 * 3 * nodes + 3 * model.line.links + 16) + own)
