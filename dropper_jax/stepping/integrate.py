"""Many steps as one compiled program, the functional core under `simulate`, and observed quantities of their states."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.one_kernel import forbids_callbacks
from dropper_jax.base.numerics import safe_norm
from dropper_jax.integrators.consistent import consistent
from dropper_jax.model import Frozen, Model, Parted, State, as_parted, state
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.growth_watch import SEGMENTS, start_meter, watch
from dropper_jax.stepping.step import step
from dropper_jax.stepping.stepper import FULL_STEP, Report, Stepper

Carry = TypeVar("Carry")
Rows = TypeVar("Rows")


class Observed(NamedTuple):
    """One instant as reported: all nodes' positions and velocities (n + 1, 3), energies [J], length error [m]."""

    positions: jax.Array
    velocities: jax.Array
    kinetic: jax.Array
    potential: jax.Array
    closure: jax.Array


def consistent_velocity(model: Model, s: State) -> jax.Array:
    """Velocities (nodes, 3) [m/s] projected to the constraints, about which those of a midpoint scheme oscillate
    slightly.

    For output, restart and hand-over only: a projection inside the steps would dissipate energy.
    """
    if model.line.axial.elastic:
        return s.v
    return consistent(model.kinematics(s.r, s.v, s.t))[0]


def observe(
    model: Model,
    r: jax.Array,
    v: jax.Array,
    t: jax.Array,
    parted: Parted | None = None,
    internal: Mapping[str, Frozen] | None = None,
) -> Observed:
    """Observe one instant; energies are those of the raw velocities, which the scheme conserves."""
    model = as_parted(model, parted).with_internal_state(internal or {})
    s = replace(state(model, r), v=v, t=t)
    ends = model.ends(t)
    k = model.instant(r, v, t, ends)
    line = model.line
    rigid = np.flatnonzero(line.axial.rigid(line.links))
    closure = jnp.max(jnp.abs(safe_norm(k.links) - line.length)[rigid], initial=0.0)
    return Observed(
        positions=k.nodes,
        velocities=model.nodes(consistent_velocity(model, s), ends, rates=True),
        kinetic=model.kinetic_energy(k),
        potential=model.potential_energy(k),
        closure=closure,
    )


#: Maximum relative change of a rigid link's length under a scheme with constraint drift (explicit Euler).
DRIFT_LIMIT = 0.1


class Trajectory(NamedTuple):
    """Saved states of a run (k saved times), the start not included.

    Attributes:
        r, v: free nodes (k, nodes, 3) [m], [m/s]; v is the scheme's raw velocity.
        tension: (k, n) [N].
        work: (k, w) [J], see `work_names`.
        residual: maximum scaled residual since the last saved time (k,).
        retried: steps repeated by the fallback solvers since then (k,).
        failed: steps since then that ended above tolerance (k,).
        first_bad: number of the first failed step of the run, -1 before any failure (k,).
        parted: broken links, each (k, m), if the scene has failures.
        own: internal states of effects, by effect, each leaf (k, ...).
        extremes: of the watched signals over the steps since the last saved time (k, m), if signals are watched.
    """

    r: jax.Array
    v: jax.Array
    tension: jax.Array
    work: jax.Array
    residual: jax.Array
    retried: jax.Array
    failed: jax.Array
    first_bad: jax.Array
    parted: Parted | None = None
    own: dict[str, Frozen] | None = None
    extremes: Extremes | None = None


class Progress(NamedTuple):
    """State of a run: the dynamic state, steps done, the first failed step (-1: no failure)."""

    state: State
    done: jax.Array
    first_bad: jax.Array

    @property
    def steps_done(self) -> jax.Array:
        """Steps done."""
        return self.done

    @property
    def t(self) -> jax.Array:
        """Time reached [s]."""
        return self.state.t

    @property
    def has_failed(self) -> jax.Array:
        """Whether a step failed."""
        return self.first_bad >= 0


def begin(stepper: Stepper, model: Model, s: State) -> Progress:
    """The carry of a run that starts from `s`."""
    s = stepper.integrator.begin(model.with_internal_state(s.own), s)
    if not stepper.track_work:
        s = replace(s, work=jnp.zeros(0, model.dtype))
    return Progress(s, jnp.zeros((), jnp.int32), jnp.asarray(np.int32(-1)))


def checked_step(
    stepper: Stepper, model: Model, s: State, dt: jax.Array, solvable: jax.Array
) -> tuple[State, Report, jax.Array]:
    """One step of dt [s], its report and whether it failed; without retries if not `solvable` (the run is lost)."""
    s, report = step(stepper, model, s, dt, solvable)
    return s, report, step_failed(stepper, model, s, report.residual)


def next_progress(
    stepper: Stepper, model: Model, progress: Progress, dt: jax.Array
) -> tuple[Progress, Report, jax.Array]:
    """The progress after one step of dt [s], the report of the step and whether it failed."""
    s, report, bad = checked_step(stepper, model, progress.state, dt, progress.first_bad < 0)
    first_bad = jnp.where(bad & (progress.first_bad < 0), progress.done, progress.first_bad)
    return Progress(s, progress.done + 1, first_bad), report, bad


def scan_steps(
    advance: Callable[[Carry, Any], tuple[Carry, Rows]], carry: Carry, count: jax.Array | int, rows: Rows
) -> tuple[Carry, Rows]:
    """Call `advance(carry, number)` `count` times; its results replace the first of the `rows` (capacity, ...).

    `count` may be traced, which `scan` does not allow: one program serves runs of any length up to the capacity.
    """

    def fill(i: jax.Array, both: tuple[Carry, Rows]) -> tuple[Carry, Rows]:
        carry, row = advance(both[0], i)
        put = lambda all_, one: jax.lax.dynamic_update_index_in_dim(all_, one.astype(all_.dtype), i, axis=0)  # noqa: E731
        return carry, jax.tree.map(put, both[1], row)

    return jax.lax.fori_loop(0, count, fill, (carry, rows))


def empty_rows(row: Rows, capacity: int) -> Rows:
    """Rows (capacity, ...) of zeros like this one."""
    return jax.tree.map(lambda a: jnp.zeros((capacity, *jnp.shape(a)), a.dtype), row)


def advance(
    stepper: Stepper,
    model: Model,
    progress: Progress,
    dt: jax.Array,
    saves: int,
    save_every: int = 1,
    watch: Watch | None = None,
) -> tuple[Progress, Trajectory]:
    """Advance by `saves * save_every` steps of dt [s], scalar or (saves, save_every), saved every `save_every`."""
    sizes = dt if jnp.ndim(dt) else None

    def save(carry: Progress, row: jax.Array | None) -> tuple[Progress, Trajectory]:
        return advance_and_save(stepper, model, carry, dt if row is None else row, save_every, watch)

    return jax.lax.scan(save, progress, sizes, length=saves)


def advance_some(
    stepper: Stepper,
    model: Model,
    progress: Progress,
    dt: jax.Array,
    count: jax.Array,
    capacity: int,
    save_every: int = 1,
    watch: Watch | None = None,
) -> tuple[Progress, Trajectory]:
    """Advance by `count` saves, at most `capacity`, which is the number of rows of the trajectory: the first are
    filled.

    One program runs chunks of any length, which allows progress reports and interruption.
    """
    rows = empty_trajectory(progress, capacity, no_extremes(watch, model, progress.state))
    save = partial(advance_and_save, stepper, model, dt=dt, save_every=save_every, watch=watch)
    return scan_steps(lambda carry, _: save(carry), progress, count, rows)


def empty_trajectory(progress: Progress, capacity: int, extremes: Extremes | None = None) -> Trajectory:
    """A trajectory with `capacity` rows of zeros for states like this one."""
    s, number = progress.state, jnp.zeros((), jnp.int32)
    counts = jnp.zeros((), s.r.dtype), number, number, number
    return empty_rows(Trajectory(s.r, s.v, s.tension, s.work, *counts, s.parted, s.own, extremes), capacity)


def advance_and_save(
    stepper: Stepper, model: Model, carry: Progress, dt: jax.Array, save_every: int, watch: Watch | None = None
) -> tuple[Progress, Trajectory]:
    """Advance by `save_every` steps of dt [s], scalar or (save_every,), and save the result."""

    def one(
        both: tuple[Progress, Extremes | None], size: jax.Array | None
    ) -> tuple[tuple[Progress, Extremes | None], tuple[jax.Array, ...]]:
        carry, extremes = both
        after, report, bad = next_progress(stepper, model, carry, dt if size is None else size)
        extremes = with_step(extremes, watch, model, carry.state, after.state)
        return (after, extremes), (report.residual, report.level > FULL_STEP, bad)

    sizes = dt if jnp.ndim(dt) else None
    both = carry, no_extremes(watch, model, carry.state)
    if save_every == 1:
        (carry, extremes), (residual, retried, bad) = one(both, None if sizes is None else sizes[0])
        retried, bad = retried.astype(jnp.int32), bad.astype(jnp.int32)
    else:
        (carry, extremes), (residual, retried, bad) = jax.lax.scan(one, both, sizes, length=save_every)
        residual, retried, bad = jnp.max(residual), jnp.sum(retried), jnp.sum(bad)
    s = carry.state
    counts = residual, retried, bad, carry.first_bad
    return carry, Trajectory(s.r, s.v, s.tension, s.work, *counts, s.parted, s.own, extremes)


def step_failed(stepper: Stepper, model: Model, s: State, residual: jax.Array) -> jax.Array:
    """Whether the step that led to `s` failed: not converged, not finite, or with constraint drift."""
    bad = ~(residual <= stepper.limit(model))
    if stepper.integrator.holds_length:
        return bad
    size = safe_norm(model.links(s.r, model.ends(s.t)))
    return bad | ~(jnp.max(jnp.abs(size / model.line.length - 1.0)) <= DRIFT_LIMIT)


def _advance_watched(
    stepper: Stepper,
    model: Model,
    carry: tuple[Progress, jax.Array],
    dt: jax.Array,
    saves: int,
    save_every: int,
    last: int,
) -> tuple[tuple[Progress, jax.Array], Trajectory]:
    """`advance` with a meter of the growth of derivatives, which measures every `last // SEGMENTS` saves before the
    `last` one (see `growth_watch`)."""
    sizes = dt if jnp.ndim(dt) else None

    def save(carry: tuple[Progress, jax.Array], row: jax.Array | None) -> tuple[tuple[Progress, jax.Array], Trajectory]:
        progress, meter = carry
        progress, saved = advance_and_save(stepper, model, progress, dt if row is None else row, save_every)
        at_end = (last - progress.done // save_every) % max(1, last // SEGMENTS) == 0
        r, meter = watch(progress.state.r, meter, at_end)
        return (progress._replace(state=replace(progress.state, r=r)), meter), saved

    return jax.lax.scan(save, carry, sizes, length=saves)


def integrate(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: float | jax.Array,
    steps: int,
    save_every: int = 1,
    checkpoint: bool = False,
    warn: bool = True,
) -> tuple[State, Trajectory]:
    """Run `steps` steps of `dt` from `s`: a pure function to `jit`, `grad`, `jacfwd` and `vmap` over model, s and dt.

    Args:
        stepper: from `make_stepper`; static.
        dt: step [s], or one for each step (steps,), such as `followed_steps` finds.
        steps: a multiple of `save_every`.
        checkpoint: for long reverse-mode runs: store states at about sqrt(steps) times only and repeat the steps from
            there in the backward pass (one more forward run, memory ~ sqrt(steps)). Not needed in forward mode.
        warn: whether a derivative in reverse mode that has grown by more than e^10 gives a `RuntimeWarning`, once. It
            takes a call of Python per gradient, so JAX does not cache the compiled gradient between processes, and
            is left out of what `dj.one_kernel` compiles.

    Returns:
        The last state, and the saved ones.
    """
    if steps % save_every:
        raise ValueError(f"steps: {steps} is not a multiple of save_every = {save_every}")
    saves = steps // save_every
    progress = begin(stepper, model, s)
    dt = jnp.asarray(dt, model.dtype)
    if dt.ndim:
        dt = dt.reshape(saves, save_every)
    warn = warn and not forbids_callbacks()
    if warn:
        floats = [x for x in jax.tree.leaves((model, s, dt)) if jnp.issubdtype(jnp.result_type(x), jnp.inexact)]
        carry = progress, start_meter([jnp.asarray(x) for x in floats])
        run = partial(_advance_watched, stepper, save_every=save_every, last=saves)
    else:
        carry = progress
        run = partial(advance, stepper, save_every=save_every)
    carry, trajectory = _run_saves(run, model, carry, dt, saves, save_every, checkpoint)
    return (carry[0] if warn else carry).state, trajectory


def _run_saves(
    run: Callable[..., tuple[Carry, Trajectory]],
    model: Model,
    carry: Carry,
    dt: jax.Array,
    saves: int,
    save_every: int,
    checkpoint: bool,
) -> tuple[Carry, Trajectory]:
    """The carry and the rows after all `saves` of a run; with checkpoints at about sqrt(saves) of them."""
    if not checkpoint or saves < 4:
        return run(model, carry, dt, saves=saves)
    per = math.isqrt(saves)
    bunches, rest = divmod(saves, per)

    @jax.checkpoint
    def bunch(model: Model, carry: Carry, dt: jax.Array) -> tuple[Carry, Trajectory]:
        return run(model, carry, dt, saves=per)

    whole = bunches * per
    sizes = dt[:whole].reshape(bunches, per, save_every) if dt.ndim else jnp.broadcast_to(dt, bunches)
    carry, trajectory = jax.lax.scan(lambda c, size: bunch(model, c, size), carry, sizes)
    trajectory = jax.tree.map(lambda a: a.reshape(bunches * per, *a.shape[2:]), trajectory)
    if rest:
        carry, tail = run(model, carry, dt[whole:] if dt.ndim else dt, saves=rest)
        trajectory = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), trajectory, tail)
    return carry, trajectory
