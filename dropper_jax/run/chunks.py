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
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.end_of_run import Last, Row, last_row, name_leaves
from dropper_jax.run.row_store import InMemory
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.extremes import Watch
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import Progress, Trajectory, begin

#: Fraction of the free memory that a run may use.
MEMORY_SHARE = 0.9


def check_memory(model: Model, start: Row, run: RunSpec, scratch: Path | None) -> None:
    """Reject a run whose saved states do not fit.

    Raises:
        SceneError: with the required and the free size.
    """
    links = model.line.links
    # positions and velocities of all nodes, tensions, angles, energies
    numbers = 6 * (model.free_nodes + 2 * max(1, links // 8)) + 3 * links + 16
    if run.save_every > 1 or run.accuracy is not None:
        # extremes and their times: of links, ends of lines and fixed points
        numbers += 4 * (links + 2 * len(model.geometry.members) + 3 * len(model.geometry.held_points))
    size = run.rows * (numbers * np.dtype(model.dtype).itemsize + _bytes((start.parted, start.own)))
    if scratch is None:
        # copies of all saved states in memory at once (measured), if nothing is stored on disk
        # memory of JAX and its programs [bytes]
        left = available_memory()
        need = 5 * size + 600_000_000
        where = "memory"
        way = (
            "a larger run.save_every, a shorter run.duration, or `dropper run --out FILE.nc`, which stores them on disk"
        )
    else:
        # copies on disk: the raw states, the observed states, and the output file
        left = shutil.disk_usage(scratch).free
        need = 3 * size
        where = "disk"
        way = "a larger run.save_every, or a shorter run.duration"
    if need > MEMORY_SHARE * left:
        raise SceneError(
            f"run.duration: {run.duration:g} s give {run.rows} saved states, which need {in_words(need)} of {where}, "
            f"and {in_words(left)} are free. Use {way}"
        )


def _bytes(tree: Any) -> int:
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

#: A carry, the maximum number of saves, and 0 for the run, 1 for its finer companion, -1 for the coarser one -> the
#: carry after them, the saved states.
Advance = Callable[[Progress, int, int], tuple[Progress, Trajectory]]

# Compiled once for all calls: a second run that differs in values only is not compiled again.
_advance = cached_jit(static=("stepper", "saves", "save_every"), kernel=True)(advance)


class Program(NamedTuple):
    """A compiled run: its first carry, what continues it, and in words what it or its companion follows."""

    carry: Progress
    advance: Advance
    words: Callable[[int], str]

    def go_on(self, carry: Progress, left: int) -> tuple[Progress, Trajectory]:
        """The carry after at most this number of saves, and the saved states."""
        return self.advance(carry, left, 0)

    def companion(self, finer: bool) -> Companion:
        """The same run from its start with finer or coarser steps."""
        return Companion(self, finer)


class Companion(NamedTuple):
    """A second run: finer, with two saves for each of the first run, or coarser, with one save for two."""

    program: Program
    finer: bool

    @property
    def words(self) -> str:
        """What it follows."""
        return self.program.words(1 if self.finer else -1)

    def go(self, saves: int) -> Iterator[Trajectory]:
        """Its rows, in pieces, for this number of saves of the first run; ends early if a step fails."""
        level = 1 if self.finer else -1
        left = 2 * saves if self.finer else saves // 2
        carry = self.program.carry
        while left > 0:
            carry, piece = self.program.advance(carry, left, level)
            if carry.has_failed:
                return
            left -= len(piece.r)
            yield piece


class RunOutcome(NamedTuple):
    """Outcome of a run: the saved states, the last carry, its time [s], whether the user stopped it, the disk error if
    one stopped it."""

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

    def steps(level: int) -> tuple[Array, Array | None]:
        """Step, or interval and accuracy, of the run or a companion."""
        length = run.step if run.accuracy is None else run.interval
        # steps end at the saved times: with the interval of the run those of both would be equal where it is short
        return jnp.asarray(length / 2.0**level, model.dtype), _array(_accuracy(run, level), model)

    none = np.int32(0)
    dt, accuracy = steps(0)
    settings = {"saves": saves, "save_every": run.save_every}
    program = _advance.program(stepper, model, carry, dt, accuracy=accuracy, count=none, watch=watch, **settings)

    def advance(carry: Progress, left: int, level: int) -> tuple[Progress, Trajectory]:
        count = min(saves, left)  # never beyond the end, where the run may go on
        dt, accuracy = steps(level)
        after, rows = program(model, carry, dt, accuracy, np.int32(count), watch)
        return after, jax.tree.map(lambda a: np.array(np.asarray(a)[:count]), rows)

    return Program(carry, advance, partial(_steps_in_words, run))


def _accuracy(run: RunSpec, level: int) -> float | None:
    """Accuracy of the run or a companion; None if its steps are equal."""
    return None if run.accuracy is None else min(run.accuracy / FACTOR**level, 1.0)


def _array(value: float | None, model: Model) -> Array | None:
    return None if value is None else jnp.asarray(value, model.dtype)


def _steps_in_words(run: RunSpec, level: int) -> str:
    accuracy = _accuracy(run, level)
    if accuracy is None:
        return f"a run with steps of {run.step / 2.0**level:.4g} s"
    return f"a run with accuracy {accuracy:.2g}"


def _chunk_size(s: State, run: RunSpec) -> int:
    """Maximum number of saves of a chunk."""
    if run.accuracy is not None:
        return max(size for size in CHUNK_SIZES if size == 1 or size * MIN_CHUNKS <= run.rows)
    size = _bytes((s.r, s.v, s.tension, s.work, s.parted, s.own))
    return max(1, min(MOST_SAVES, 2 ** int(np.log2(max(CHUNK_BYTES / max(size, 1), 1.0)))))


def run_chunks(run: Program, saves: int, say: Callable[[float, str], None], rows: InMemory | None = None) -> RunOutcome:
    """Run chunks until the end, a failure or an interruption, which includes a full disk.

    Args:
        rows: store for the chunks; default: in memory.
    """
    rows = InMemory() if rows is None else rows
    at = run.carry, 0  # what is kept: one name, so that a stop leaves both as they belong together
    count = 1
    started = time.perf_counter()
    interrupted = False
    refused = ""
    try:
        while at[1] < saves and not at[0].has_failed:
            chunk_started = time.perf_counter()
            carry, piece = run.go_on(at[0], min(count, saves - at[1]))
            rows.append(at[1], (jax.tree.map(np.asarray, piece), name_leaves(Last(last_row(piece), carry))))
            at = carry, at[1] + len(piece.r)
            say(min(at[1] / saves, 1.0), f"t = {float(carry.t):.3g} s")
            longer = SECONDS / max(time.perf_counter() - chunk_started, 1e-9)
            count = min(max(1, int(count * min(longer, LONGER))), max(1, saves // MIN_CHUNKS))
    except (KeyboardInterrupt, OSError) as error:
        if not at[1]:
            raise
        interrupted = True
        if isinstance(error, OSError):
            refused = f"stopped: {error.strerror or error}"
    run_s = time.perf_counter() - started
    return RunOutcome(rows.read(at[1]), at[0], run_s, interrupted, refused)
