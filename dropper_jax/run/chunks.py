"""A run in chunks: compiled once, with progress, stopped by a failure or by the user.

One program runs chunks of any number of saves with equal steps. A chunk takes about `SECONDS`, which allows progress
reports and a quick stop. The length of the chunks does not affect the results.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import available_memory, in_words
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.end_of_run import Last, Row, last_row, name_leaves
from dropper_jax.run.row_store import InMemory
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.extremes import Watch
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import Progress, Trajectory, begin

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
    return numbers * np.dtype(model.dtype).itemsize + _tree_bytes((start.parted, start.own))


def _tree_bytes(tree: Any) -> int:
    """Size of all arrays of a tree."""
    return sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(tree))


#: Minimum number of chunks of a run that has at least this number of saves.
MIN_CHUNKS = 32
#: Target time of a chunk [s], and the maximum ratio of its length to that of the previous one.
SECONDS = 1.0
LONGER = 8
#: Maximum number of saves and of bytes of a chunk.
MOST_SAVES = 1024
CHUNK_BYTES = 16_000_000
#: Saves of a chunk with steps of variable length: one of these, so that runs of other lengths share the program.
CHUNK_SIZES = (1, 2, 16, 128, 1024)

#: Accuracy of a companion over that of its run, or the inverse; its steps or intervals are half or twice as long.
FACTOR = 4.0
#: Levels of a run: the run itself, its finer companion, its coarser one. Steps are divided by 2^level.
OWN = 0
FINER = 1
COARSER = -1

#: A carry, the maximum number of saves and the level -> the carry after them, the saved states.
Advance = Callable[[Progress, int, int], tuple[Progress, Trajectory]]

# Compiled once for all calls: a second run that differs in values only is not compiled again.
_advance = cached_jit(static=("stepper", "saves", "save_every"), kernel=True)(advance)


class Program(NamedTuple):
    """A compiled run: its first carry, the function that continues it, and its steps in words, by level."""

    carry: Progress
    advance: Advance
    words: Callable[[int], str]


class Companion(NamedTuple):
    """The same run from its start with other steps: finer, with two saves for each of the first run, or coarser, with
    one save for two."""

    program: Program
    finer: bool

    @property
    def level(self) -> int:
        """Its level of steps."""
        return FINER if self.finer else COARSER

    @property
    def words(self) -> str:
        """Its steps in words."""
        return self.program.words(self.level)

    def chunks(self, saves: int) -> Iterator[Trajectory]:
        """Its saved states, chunk by chunk, for this number of saves of the first run; ends early if a step fails."""
        left = 2 * saves if self.finer else saves // 2
        carry = self.program.carry
        while left > 0:
            carry, chunk = self.program.advance(carry, left, self.level)
            if carry.has_failed:
                return
            left -= len(chunk.r)
            yield chunk


class RunOutcome(NamedTuple):
    """Outcome of a run.

    Attributes:
        trajectory: the saved states.
        carry: the last carry.
        run_s: wall time [s].
        interrupted: whether the user or a disk error stopped it.
        refused: the disk error in words, if one stopped it; else empty.
    """

    trajectory: Trajectory
    carry: Progress
    run_s: float
    interrupted: bool
    refused: str = ""


def first_carry(stepper: Stepper, model: Model, start: State, run: RunSpec) -> Progress:
    """The carry of a run that starts at `start`."""
    return _begin(stepper, model, start, run.accuracy is not None)


# One program: its sixty small operations would be compiled one by one at each start of a process.
_begin = cached_jit(static=("stepper", "follows"))(begin)


def compile_run(stepper: Stepper, model: Model, carry: Progress, run: RunSpec, watch: Watch | None = None) -> Program:
    """The compiled program of a run from a carry.

    Args:
        watch: signals whose extremes over all steps are saved, a pytree; see `stepping.extremes`.
    """
    saves = _chunk_size(carry.state, run)

    def step_and_accuracy(level: int) -> tuple[Array, Array | None]:
        """Equal step, or interval and accuracy, of the run or a companion."""
        length = run.step if run.accuracy is None else run.interval
        accuracy = _accuracy(run, level)
        # steps end at the saved times: with the interval of the run those of both would be equal where it is short
        step = jnp.asarray(length / 2.0**level, model.dtype)
        return step, None if accuracy is None else jnp.asarray(accuracy, model.dtype)

    dt, accuracy = step_and_accuracy(OWN)
    settings = {"saves": saves, "save_every": run.save_every}
    program = _advance.program(stepper, model, carry, dt, accuracy=accuracy, count=np.int32(0), watch=watch, **settings)

    def advance(carry: Progress, left: int, level: int) -> tuple[Progress, Trajectory]:
        count = min(saves, left)  # never beyond the end, from which the run may continue
        dt, accuracy = step_and_accuracy(level)
        after, rows = program(model, carry, dt, accuracy, np.int32(count), watch)
        return after, jax.tree.map(lambda a: np.array(np.asarray(a)[:count]), rows)

    return Program(carry, advance, partial(_steps_in_words, run))


def _accuracy(run: RunSpec, level: int) -> float | None:
    """Accuracy of the run or a companion; None if its steps are equal."""
    return None if run.accuracy is None else min(run.accuracy / FACTOR**level, 1.0)


def _steps_in_words(run: RunSpec, level: int) -> str:
    """The run or a companion by its steps."""
    accuracy = _accuracy(run, level)
    if accuracy is None:
        return f"a run with steps of {run.step / 2.0**level:.4g} s"
    return f"a run with accuracy {accuracy:.2g}"


def _chunk_size(s: State, run: RunSpec) -> int:
    """Maximum number of saves of a chunk."""
    if run.accuracy is not None:
        return max(size for size in CHUNK_SIZES if size == 1 or size * MIN_CHUNKS <= run.rows)
    size = _tree_bytes((s.r, s.v, s.tension, s.work, s.parted, s.own))
    return max(1, min(MOST_SAVES, 2 ** int(np.log2(max(CHUNK_BYTES / max(size, 1), 1.0)))))


def run_chunks(run: Program, saves: int, say: Callable[[float, str], None], rows: InMemory | None = None) -> RunOutcome:
    """Run chunks until the end, a failure or an interruption, which includes a full disk.

    Args:
        rows: store for the chunks; default: in memory.
    """
    rows = InMemory() if rows is None else rows
    # the carry and the number of saves before it: one name, so that an interruption cannot separate them
    reached = run.carry, 0
    count = 1
    started = time.perf_counter()
    interrupted = False
    refused = ""
    try:
        while reached[1] < saves and not reached[0].has_failed:
            chunk_started = time.perf_counter()
            before, done = reached
            carry, chunk = run.advance(before, min(count, saves - done), OWN)
            rows.append(done, (jax.tree.map(np.asarray, chunk), name_leaves(Last(last_row(chunk), carry))))
            done += len(chunk.r)
            reached = carry, done
            say(min(done / saves, 1.0), f"t = {float(carry.t):.3g} s")
            longer = SECONDS / max(time.perf_counter() - chunk_started, 1e-9)
            count = min(max(1, int(count * min(longer, LONGER))), max(1, saves // MIN_CHUNKS))
    except (KeyboardInterrupt, OSError) as error:
        if not reached[1]:
            raise
        interrupted = True
        if isinstance(error, OSError):
            refused = f"stopped: {error.strerror or error}"
    run_s = time.perf_counter() - started
    carry, done = reached
    return RunOutcome(rows.read(done), carry, run_s, interrupted, refused)
