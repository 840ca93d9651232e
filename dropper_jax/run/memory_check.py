"""Whether the saved states of a run fit into memory or onto the disk, before it starts."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import available_memory, in_words
from dropper_jax.model import Model
from dropper_jax.run.end_of_run import Row
from dropper_jax.scene import RunSpec

#: Fraction of the free memory, or of the free disk, that a run may use.
MEMORY_SHARE = 0.9
#: Copies of all saved states in memory at once (measured), and memory of JAX and its programs [bytes].
COPIES_IN_MEMORY = 5
PROGRAM_BYTES = 600_000_000
#: Copies of all saved states on disk: the raw states, the observed states, and the output file.
COPIES_ON_DISK = 3


def check_memory(model: Model, start: Row, run: RunSpec, scratch: Path | None) -> None:
    """Reject a run whose saved states do not fit.

    Raises:
        SceneError: with the required and the free size.
    """
    size = run.rows * _row_bytes(model, start, run)
    if scratch is None:
        left = available_memory()
        need = COPIES_IN_MEMORY * size + PROGRAM_BYTES
        where = "memory"
        advice = (
            "a larger run.save_every, a shorter run.duration, or `dropper run --out FILE.nc`, which stores them on disk"
        )
    else:
        left = shutil.disk_usage(scratch).free
        need = COPIES_ON_DISK * size
        where = "disk"
        advice = "a larger run.save_every, or a shorter run.duration"
    if need > MEMORY_SHARE * left:
        raise SceneError(
            f"run.duration: {run.duration:g} s give {run.rows} saved states, which need {in_words(need)} of {where}, "
            f"and {in_words(left)} are free. Use {advice}"
        )


def _row_bytes(model: Model, start: Row, run: RunSpec) -> int:
    """Estimated size of a saved state: positions and velocities of all nodes, tensions, angles, energies, extremes."""
    links = model.line.links
    fixed_and_shared = 2 * max(1, links // 8)  # nodes that are not free, or belong to several lines
    numbers = 6 * (model.free_nodes + fixed_and_shared) + 3 * links + 16
    if run.save_every > 1 or run.accuracy is not None:
        # minima, maxima and their times: of links, ends of lines and the components at fixed points
        numbers += 4 * (links + 2 * len(model.geometry.members) + 3 * len(model.geometry.held_points))
    return numbers * np.dtype(model.dtype).itemsize + tree_bytes((start.parted, start.own))


def tree_bytes(tree: Any) -> int:
    """Size of all arrays of a tree."""
    return sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(tree))
