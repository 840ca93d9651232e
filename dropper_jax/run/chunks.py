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

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.end_of_run import Last, Row, last_row, name_leaves
from dropper_jax.run.row_store import InMemory
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.adaptive import Adaptive, Within, adaptive_start, advance_adaptively
from dropper_jax.stepping.extremes import Watch
from dropper_jax.stepping.integrate import Progress, Trajectory, advance, begin

#: Fraction of the free memory that a run may use.
MEMORY_SHARE = 0.9


def check_memory(model: Model, start: Row, run: RunSpec, scratch: Path | None) -> None:
    """Reject a run whose saved states do not fit.

    Raises:
        SceneError: with the required and the free size.
    """
    size = run.rows * (row_bytes(model, start) + _extremes_bytes(model, run))
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


def row_bytes(model: Model, s: Row | State) -> int:
    """Bytes of an observed state: positions and velocities of all nodes, tensions, angles, energies."""
    own = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((s.parted, s.own)))
    nodes = model.free_nodes + 2 * max(1, model.line.links // 8)
    return int(np.dtype(model.dtype).itemsize * (2 * 3 * nodes + 3 * model.line.links + 16) + own)


def _extremes_bytes(model: Model, run: RunSpec) -> int:
    """Bytes of the extremes of a saved state and their times: of links, ends of lines and fixed points."""
    if run.save_every == 1 and run.accuracy is None:
        return 0
    signals = model.line.links + 2 * len(model.geometry.members) + 3 * len(model.geometry.held_points)
    return 4 * signals * int(np.dtype(model.dtype).itemsize)


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

#: Accuracy of a companion over that of its run, or the inverse.
FACTOR = 4.0

#: The state carried from chunk to chunk, and the data on its steps in addition to the trajectory.
Carry = Progress | Adaptive
Beside = Within | None
#: A carry and the maximum number of saves -> the carry after them, the saved states.
GoOn = Callable[[Any, int], tuple[Any, tuple[Trajectory, Beside]]]

# Compiled once for all calls: a second run that differs in values only is not compiled again.
_advance = cached_jit(static=("stepper", "saves", "save_every"), kernel=True)(advance)
_advance_adaptively = cached_jit(static=("stepper", "saves"), kernel=True)(advance_adaptively)


class Companion(NamedTuple):
    """A second run, coarser or finer than a first one.

    Attributes:
        go: yields its rows in pieces, for a number of saves of the first run; ends early if a step fails.
        finer: whether it has two saves for each of the first run, not one for two.
        words: what it follows.
    """

    go: Callable[[int], Iterator[tuple[Trajectory, Beside]]]
    finer: bool
    words: str


class Program(NamedTuple):
    """A compiled run: the function that continues from a carry, the first carry, and its companion, finer or not."""

    go_on: GoOn
    carry: Carry
    companion: Callable[[bool], Companion]


class RunOutcome(NamedTuple):
    """Outcome of a run: the saved states, the last carry, its time [s], whether the user stopped it, the disk error if
    one stopped it."""

    trajectory: Trajectory
    beside: Beside
    carry: Carry
    run_s: float
    interrupted: bool
    refused: str = ""


def first_carry(stepper: Stepper, model: Model, start: State, run: RunSpec) -> Carry:
    """The carry of a run that starts at `start`."""
    return _first_carry(stepper, model, start, run.accuracy is not None)


@cached_jit(static=("stepper", "follows"))
def _first_carry(stepper: Stepper, model: Model, start: State, follows: bool) -> Carry:
    """One program: its sixty small operations would be compiled one by one at each start of a process.

    Args:
        follows: whether the steps follow an accuracy.
    """
    progress = begin(stepper, model, start)
    if not follows:
        return progress
    return adaptive_start(stepper, model, progress)


def compile_run(stepper: Stepper, model: Model, carry: Carry, run: RunSpec, watch: Watch | None = None) -> Program:
    """The compiled program of a run from a carry.

    Args:
        watch: signals whose extremes over all steps are saved, a pytree; see `stepping.extremes`.
    """
    own = run.accuracy
    if own is None or isinstance(carry, Progress):
        equal = _EqualSteps(stepper, model, carry, run, watch)
        return Program(equal, carry, equal.companion)
    dt = jnp.asarray(run.interval, model.dtype)
    saves = max(size for size in CHUNK_SIZES if size == 1 or size * MIN_CHUNKS <= run.rows)
    accuracy = jnp.asarray(own, model.dtype)
    none = np.int32(0)
    program = _advance_adaptively.program(stepper, model, carry, dt, accuracy, count=none, watch=watch, saves=saves)

    def advance(
        carry: Carry, left: int, interval: jax.Array, accuracy: jax.Array
    ) -> tuple[Carry, tuple[Trajectory, Beside]]:
        count = min(saves, left)  # never beyond the end, where the run may go on
        after, rows = program(model, carry, interval, accuracy, np.int32(count), watch)
        return after, jax.tree.map(lambda a: np.asarray(a)[:count], rows)

    def companion(finer: bool) -> Companion:
        if finer:
            other = own / FACTOR
        else:
            other = min(own * FACTOR, 1.0)
        # steps end at the saved times: with the interval of the run those of both would be equal where it is short
        interval = 0.5 * dt if finer else 2.0 * dt
        go_on = partial(advance, interval=interval, accuracy=jnp.asarray(other, model.dtype))
        return Companion(partial(_second_run, go_on, carry, finer), finer, f"a run with accuracy {other:.2g}")

    return Program(partial(advance, interval=dt, accuracy=accuracy), carry, companion)


def _second_run(go_on: GoOn, carry: Carry, finer: bool, saves: int) -> Iterator[tuple[Trajectory, Beside]]:
    """The rows of a companion, in pieces, for this number of saves of the first run; ends early if a step fails."""
    left = 2 * saves if finer else saves // 2
    while left > 0:
        carry, piece = go_on(carry, left)
        if carry.has_failed:
            return
        left -= len(piece[0].r)
        yield piece


class _EqualSteps:
    """Equal steps; one that does not converge is halved."""

    def __init__(self, stepper: Stepper, model: Model, progress: Progress, run: RunSpec, watch: Watch | None) -> None:
        self.stepper, self.model, self.dt, self.watch = stepper, model, run.step, watch
        self.first = progress
        self.settings = {"saves": _chunk_size(progress.state), "save_every": run.save_every}
        self.longest = min(max(1, run.saves // MIN_CHUNKS), self.settings["saves"])
        self.count = 1
        dt = jnp.asarray(self.dt, self.model.dtype)
        none = np.int32(0)
        self.program = _advance.program(stepper, model, progress, dt, count=none, watch=watch, **self.settings)

    def __call__(self, carry: Progress, left: int) -> tuple[Progress, tuple[Trajectory, None]]:
        count = min(self.count, self.longest, left)
        started = time.perf_counter()
        found = self._take(carry, count)
        self.count = max(1, int(count * min(SECONDS / max(time.perf_counter() - started, 1e-9), LONGER)))
        return found

    def _take(self, carry: Progress, left: int, parts: float = 1.0) -> tuple[Progress, tuple[Trajectory, None]]:
        count = min(left, self.settings["saves"])
        dt = jnp.asarray(self.dt / parts, self.model.dtype)
        after, rows = self.program(self.model, carry, dt, np.int32(count), self.watch)
        return after, (jax.tree.map(lambda a: np.array(np.asarray(a)[:count]), rows), None)

    def companion(self, finer: bool) -> Companion:
        """The same run from its start with steps of half or twice the length."""
        parts = 2.0 if finer else 0.5
        go = partial(_second_run, partial(self._take, parts=parts), self.first, finer)
        return Companion(go, finer, f"a run with steps of {self.dt / parts:.4g} s")


def _chunk_size(s: State) -> int:
    size = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((s.r, s.v, s.tension, s.work, s.parted, s.own)))
    return max(1, min(MOST_SAVES, 2 ** int(np.log2(max(CHUNK_BYTES / max(size, 1), 1.0)))))


def run_chunks(
    run: Program,
    saves: int,
    say: Callable[[float, str], None],
    rows: InMemory | None = None,
) -> RunOutcome:
    """Run chunks until the end, a failure or an interruption, which includes a full disk.

    Args:
        rows: store for the chunks; default: in memory.
    """
    carry = run.carry
    done = 0
    rows = InMemory() if rows is None else rows
    at = carry, done  # of what is kept: one name, so that a stop leaves both as they belong together
    started = time.perf_counter()
    interrupted = False
    refused = ""
    try:
        while done < saves:
            carry, piece = run.go_on(carry, saves - done)
            rows.append(done, (jax.tree.map(np.asarray, piece), name_leaves(Last(last_row(piece[0]), carry))))
            at = carry, done + len(piece[0].r)
            done = at[1]
            say(min(done / saves, 1.0), f"t = {float(carry.t):.3g} s")
            if carry.has_failed:
                break
    except (KeyboardInterrupt, OSError) as error:
        interrupted = True
        if not at[1]:
            raise
        if isinstance(error, KeyboardInterrupt):
            refused = ""
        else:
            refused = f"stopped: {error.strerror or error}"
    run_s = time.perf_counter() - started
    carry, done = at
    joined, beside = rows.read(done)
    return RunOutcome(joined, beside, carry, run_s, interrupted, refused)
