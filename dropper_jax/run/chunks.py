"""A run in pieces: compiled once, gone through with progress, stopped by a failure or by the user.

Steps of one length go on in pieces of any number of saves by one program; a piece takes about `SECONDS`, so that
progress is shown and a stop is answered. Where a piece ends makes no difference to a number.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.programs import cached_jit
from dropper_jax.integrators.projected import ProjectedRungeKutta
from dropper_jax.model import Model, State
from dropper_jax.run.build import allowed_error
from dropper_jax.run.row_store import InMemory
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.adaptive import Adaptive, Within, adaptive_start, advance_adaptively
from dropper_jax.stepping.controlled import Controlled, advance_controlled, start_controlled
from dropper_jax.stepping.integrate import Progress, Trajectory, advance_some, begin
from dropper_jax.stepping.stepper import Stepper

#: A run is cut into at least this many pieces, where it has so many saves.
PIECES = 32
#: Wanted time of a piece [s], and how many times longer than the one before it may be.
SECONDS, LONGER = 1.0, 8
#: Most saves and most bytes of a piece.
MOST_STEPS, BYTES = 1024, 16_000_000
#: Saves of a piece of steps that differ in length: one of these, so that runs of other lengths share the program.
SAVES = (1, 2, 16, 128, 1024)

#: Steps of a system of lines from which on its run is made one kernel: compiled as one, its program takes 2 to 15 s
#: longer, and each step 60 to 120 us less.
WORTH_ONE_KERNEL = 20_000

#: What a run carries from piece to piece, and what is known of its steps beside the trajectory.
Carry = Progress | Adaptive | Controlled
Beside = Within | jax.Array | None
#: A carry and how many saves are wanted at most -> the carry after them, what was saved.
GoOn = Callable[[Any, int], tuple[Any, tuple[Trajectory, Beside]]]

# Compiled once for all calls: a second run that differs in values only is not compiled again.
_advance = cached_jit(static=("stepper", "capacity", "save_every"))(advance_some)
_advance_briefly = cached_jit(static=("stepper", "capacity", "save_every"), brief=True)(advance_some)
_advance_adaptively = cached_jit(static=("stepper", "saves"))(advance_adaptively)
_advance_controlled = cached_jit(static=("stepper", "saves"))(advance_controlled)
_start_controlled = cached_jit(static=("stepper",))(start_controlled)


class ChunkedRun(NamedTuple):
    """What goes on from a carry, and the first carry."""

    go_on: GoOn
    carry: Carry


class RunOutcome(NamedTuple):
    """A run that was gone through: what was saved, its last carry, time [s] of it and of compiling meanwhile, whether
    the user stopped it, why the disk did, and carries that it passed with the saves behind each."""

    trajectory: Trajectory
    beside: Beside
    carry: Carry
    run_s: float
    late_s: float
    interrupted: bool
    refused: str = ""
    passed: tuple[tuple[int, Carry], ...] = ()


def first_carry(stepper: Stepper, model: Model, start: State, run: RunSpec) -> Carry:
    """The carry of a run that begins at `start`."""
    if isinstance(stepper.integrator, ProjectedRungeKutta):
        allowed = jnp.asarray(allowed_error(stepper, model, run), model.dtype)
        return _start_controlled(stepper, model, start, allowed)
    progress = begin(stepper, model, start)
    if run.step_tolerance is None:
        return progress
    return adaptive_start(progress, jnp.asarray(run.dt, model.dtype))


def compile_run(stepper: Stepper, model: Model, carry: Carry, run: RunSpec, before: int = 0) -> ChunkedRun:
    """The compiled program of a run from a carry.

    Args:
        before: steps of a run that it goes on from, whose program it takes if that is for longer runs.
    """
    dt = jnp.asarray(run.dt, model.dtype)
    saves = max(size for size in SAVES if size == 1 or size * PIECES <= run.saves)
    if isinstance(carry, Progress):
        return ChunkedRun(_EqualSteps(stepper, model, carry, run, max(run.steps, before)), carry)
    if isinstance(carry, Controlled):
        limit, dt = jnp.asarray(allowed_error(stepper, model, run), model.dtype), dt * run.save_every
        several = _advance_controlled
    else:
        limit, several = jnp.asarray(run.step_tolerance, model.dtype), _advance_adaptively
    program = several.program(stepper, model, carry, dt, limit, saves=saves, count=jnp.zeros((), jnp.int32))

    def go_on(carry: Carry, left: int) -> tuple[Carry, tuple[Trajectory, Beside]]:
        count = min(saves, left)  # never beyond the end, where the run may go on
        after, rows = program(model, carry, dt, limit, jnp.asarray(count, jnp.int32))
        return after, jax.tree.map(lambda a: np.asarray(a)[:count], rows)

    return ChunkedRun(go_on, carry)


class _EqualSteps:
    """Steps of one length: by a program for steps that solve at once, until one does not.

    That piece is then taken again, and all after it, by the program that has means for steps that resist. Most runs
    never compile it: it is four times as large. Joints that stick need it at once.
    """

    def __init__(self, stepper: Stepper, model: Model, progress: Progress, run: RunSpec, steps: int) -> None:
        self.stepper, self.model, self.dt = stepper, model, run.dt
        self.settings = {"capacity": _chunk_size(progress.state), "save_every": run.save_every}
        self.longest = max(1, run.saves // PIECES)
        self.count = 1
        self.late_s = 0.0  # what compiling took once the run had begun
        self.plain = stepper.until_converged or not model.laws
        brief = stepper.until_converged and steps < WORTH_ONE_KERNEL
        self.advance = _advance_briefly if brief else _advance
        self.program = self._program(stepper.plain if self.plain else stepper, progress)

    def _program(self, stepper: Stepper, progress: Progress) -> Callable[..., Any]:
        dt = jnp.asarray(self.dt, self.model.dtype)
        return self.advance.program(stepper, self.model, progress, dt, jnp.zeros((), jnp.int32), **self.settings)

    def __call__(self, carry: Progress, left: int) -> tuple[Progress, tuple[Trajectory, None]]:
        count = min(self.count, self.longest, left, self.settings["capacity"])
        started = time.perf_counter()
        after, rows = self._take(carry, count)
        if self.plain and int(after.first_bad) >= 0 and self.stepper != self.stepper.plain:
            now = time.perf_counter()
            self.plain, self.program = False, self._program(self.stepper, carry)
            started = time.perf_counter()
            self.late_s += started - now
            after, rows = self._take(carry, count)
        share = SECONDS / max(time.perf_counter() - started, 1e-9)
        self.count = max(1, int(count * min(share, LONGER)))
        return after, (rows, None)

    def _take(self, carry: Progress, count: int, parts: int = 1) -> tuple[Progress, Trajectory]:
        dt = jnp.asarray(self.dt / parts, self.model.dtype)
        after, rows = self.program(self.model, carry, dt, jnp.asarray(count, jnp.int32))
        return after, jax.tree.map(lambda a: np.array(a[:count]), jax.tree.map(np.asarray, rows))

    def advance_at_half_step(self, carry: Progress, saves: int) -> tuple[Progress, Trajectory | None]:
        """The next `saves` again as twice as many of half the step, by the program of the run; None if a step fails."""
        done, rows = 0, []
        while done < 2 * saves:
            carry, piece = self._take(carry, min(2 * saves - done, self.settings["capacity"]), 2)
            done += len(piece.r)
            rows.append(piece)
            if int(carry.first_bad) >= 0:
                return carry, None
        return carry, jax.tree.map(lambda *parts: np.concatenate(parts), *rows)


def _chunk_size(s: State) -> int:
    size = sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves((s.r, s.v, s.tension, s.work, s.parted, s.own)))
    return max(1, min(MOST_STEPS, 2 ** int(np.log2(max(BYTES / max(size, 1), 1.0)))))


def run_chunks(
    run: ChunkedRun, saves: int, say: Callable[[float, str], None], rows: InMemory | None = None
) -> RunOutcome:
    """Pieces until the end, a failure or an interruption; a disk that takes no more is one too.

    Args:
        rows: where the pieces are kept; default: in memory.
    """
    carry, done, rows = run.carry, 0, InMemory() if rows is None else rows
    passed: list[tuple[int, Carry]] = []
    at = carry, done  # of what is kept: one name, so that a stop leaves both as they belong together
    started, interrupted, refused = time.perf_counter(), False, ""
    try:
        while done < saves:
            passed = [*(passed if len(passed) < 2 * PIECES else passed[::2]), (done, carry)]
            carry, piece = run.go_on(carry, saves - done)
            rows.append(jax.tree.map(np.asarray, piece))
            at = carry, done + len(piece[0].r)
            done = at[1]
            t, failed = _reached_time(carry)
            say(min(done / saves, 1.0), f"t = {t:.3g} s")
            if failed:
                break
    except (KeyboardInterrupt, OSError) as error:
        interrupted = True
        if not at[1]:
            raise
        refused = "" if isinstance(error, KeyboardInterrupt) else f"stopped: {error.strerror or error}"
    late_s = getattr(run.go_on, "late_s", 0.0)
    run_s = time.perf_counter() - started - late_s
    carry, done = at
    joined, beside = rows.concatenate(done)
    return RunOutcome(joined, beside, carry, run_s, late_s, interrupted, refused, tuple(passed))


def _reached_time(carry: Carry) -> tuple[float, bool]:
    """The time [s] that a run has come to, and whether it has failed."""
    if isinstance(carry, Controlled):
        return float(carry.now.t), bool(carry.bad)
    progress = carry if isinstance(carry, Progress) else carry.progress
    return float(progress.state.t), int(progress.first_bad) >= 0
