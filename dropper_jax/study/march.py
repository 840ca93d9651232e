"""Runs on one time grid whose step is a plain argument: every step size shares one compiled program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.analysis.angles import link_angles
from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.adaptive import accepted_steps, control_of
from dropper_jax.stepping.equal_steps import next_progress
from dropper_jax.stepping.integrate import advance, empty_rows, scan_steps
from dropper_jax.stepping.progress import Progress, begin

#: Rows of a run, traced or on the host.
Rows = Array | np.ndarray


def link_vectors(model: Model, r: Rows, t: np.ndarray) -> np.ndarray:
    """Link vectors (k, n, 3) [m] of free nodes r (k, nodes, 3) at times t (k,), in the precision of r."""
    return np.asarray(_links(model, jnp.asarray(r), jnp.asarray(t, model.dtype))).astype(r.dtype)


@cached_jit()
def _links(model: Model, r: Array, t: Array) -> Array:
    return jax.vmap(lambda nodes, time: model.links(nodes, model.ends(time)))(r, t)


def rms(x: Rows) -> float:
    """Root of the mean square; infinite if any entry is not finite."""
    with np.errstate(over="ignore"):
        if np.all(np.isfinite(x)):
            return np.sqrt(np.mean(np.square(x)))
        return float("inf")


def rms_angle(d: np.ndarray, reference: np.ndarray) -> float:
    """RMS over times and links of the angle [rad] between link vectors (..., 3) and those of a reference.

    In a plane it is the difference of the polar angles; in space it has no singular direction, unlike an azimuth.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        u = d / np.linalg.norm(d, axis=-1, keepdims=True)
        w = reference / np.linalg.norm(reference, axis=-1, keepdims=True)
        return rms(2 * np.arcsin(np.minimum(0.5 * np.linalg.norm(u - w, axis=-1), 1.0)))


def rms_position(r: Rows, reference: Rows) -> float:
    """RMS over times and nodes of the distance between nodes [m]."""
    return rms(np.linalg.norm(r - reference, axis=-1))


class Marched(NamedTuple):
    """States at the grid's times (k saved times, the start not included), and the status of the steps.

    Attributes:
        r, v: free nodes (k, nodes, 3) [m], [m/s].
        tension: of the step that ends at the saved time, and of the one that starts at the previous time (k, 2, n) [N].
        work: (k, w) [J].
        residual: maximum scaled residual so far (k,).
        bad: number of the first failed step, -1 before any failure (k,).
        retried: steps solved by the fallback so far (k,).
        path: sum over nodes and steps of |r1 - r0|^2 / h (k,) [m^2/s]: energy that a damping of 1 kg/s would dissipate
        [J].
    """

    r: Array
    v: Array
    tension: Array
    work: Array
    residual: Array
    bad: Array
    retried: Array
    path: Array


class _SoFar(NamedTuple):
    """Of a run: its last step, tensions of the first step since the saved row, and `Marched`'s values up to now."""

    progress: Progress
    first: Array
    worst: Array
    retried: Array
    path: Array


@cached_jit(static=("stepper", "capacity"), kernel=True)
def march(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: Array | float,
    every: Array | int,
    saves: Array | int,
    capacity: int,
) -> Marched:
    """`saves` times `every` steps of `dt` from s, in the first of `capacity` rows.

    dt, `every` and `saves` are traced, so other step sizes and durations do not compile again.
    """
    dt = jnp.asarray(dt, model.dtype)

    def one(i: Array, so_far: _SoFar) -> _SoFar:
        after, taken = next_progress(stepper, model, so_far.progress, dt)
        path = so_far.path + jnp.sum((after.state.r - so_far.progress.state.r) ** 2) / dt
        first = jnp.where(i == 0, after.state.tension, so_far.first)
        return _SoFar(after, first, jnp.maximum(so_far.worst, taken.row), so_far.retried + taken.retried, path)

    def row(so_far: _SoFar) -> Marched:
        progress, first, worst, retried, path = so_far
        s = progress.state
        return Marched(s.r, s.v, jnp.stack([s.tension, first]), s.work, worst, progress.first_bad, retried, path)

    def save(so_far: _SoFar, _: Array) -> tuple[_SoFar, Marched]:
        so_far = jax.lax.fori_loop(0, every, one, so_far)
        return so_far, row(so_far)

    zero = jnp.zeros((), model.dtype)
    start = _SoFar(begin(stepper, model, s), jnp.zeros_like(s.tension), zero, jnp.zeros((), jnp.int32), zero)
    return scan_steps(save, start, saves, empty_rows(jax.eval_shape(row, start), capacity))[1]


class MarchResult(NamedTuple):
    """Result of `march_with_accuracy`: states at the grid's times, accepted and rejected steps."""

    run: Marched
    taken: Array
    refused: Array


@cached_jit(static=("stepper", "saves"), kernel=True)
def march_with_accuracy(
    stepper: Stepper, model: Model, s: State, grid: Array | float, accuracy: Array | float, saves: int
) -> MarchResult:
    """`march` in steps that follow an accuracy, on a grid [s]; `path` by the trapezoidal rule, tensions are means."""
    grid = jnp.asarray(grid, model.dtype)
    start = begin(stepper, model, s, follows=True)
    end, found = advance(stepper, model, start, grid, saves, accuracy=jnp.asarray(accuracy, model.dtype))
    both = jnp.stack([found.tension, jnp.roll(found.tension, 1, axis=0)], axis=1)
    first = jnp.sum(jnp.square(s.v))
    speed = jnp.sum(jnp.square(found.v), axis=(1, 2))
    # a loop, not `cumsum`, which would prevent one kernel
    passed = jax.lax.scan(lambda total, x: (total + x, total + x), 0.5 * first, speed)[1]
    path = grid * (passed - 0.5 * speed)
    run = Marched(found.r, found.v, both, found.work, found.residual, found.first_bad, found.retried, path)
    return MarchResult(run, accepted_steps(found), control_of(end).refused)


def spare_rows(saves: int) -> int:
    """Rows of a program that serves many durations: `saves` if that is small, else 640, or a larger power of two."""
    if saves <= 32:
        return saves
    if saves <= 640:
        return 640
    return 1 << (saves - 1).bit_length()


@dataclass(frozen=True)
class GridRun:
    """A run on a time grid: its rows on the host, and what follows from them.

    Attributes:
        t: times of the rows (k,) [s].
    """

    stepper: Stepper
    model: Model
    start: State
    t: np.ndarray
    rows: Marched

    @property
    def r(self) -> Rows:
        """Positions of the free nodes (k, nodes, 3) [m]."""
        return self.rows.r

    @property
    def status(self) -> str:
        """`ok` or the named failure, with the status names of `simulate`."""
        failed = self.rows.bad[-1] >= 0
        if not failed and np.all(np.isfinite(self.r[-1])):
            return "ok"
        if not failed or not np.isfinite(self.rows.residual[-1]):
            return "non_finite"
        return "retry_exhausted" if self.stepper.halvings else "not_converged"

    @property
    def links(self) -> np.ndarray:
        """Link vectors (k, n, 3) [m]."""
        return link_vectors(self.model, self.r, self.t)

    @property
    def angles(self) -> np.ndarray:
        """Polar and azimuth (2, k, n) [rad]; NaN of a failed run."""
        nodes = np.concatenate([np.zeros((len(self.t), 1, 3)), np.cumsum(self.links, axis=1)], axis=1)
        if self.status != "ok":
            nodes = np.full_like(nodes, np.nan)
        return np.stack(link_angles(nodes))

    @property
    def energy_loss(self) -> np.ndarray:
        """Energy balance error since the start (k,) [J]: energies of the raw velocities minus all counted work."""
        s = self.start
        states = [jnp.asarray(x, self.model.dtype) for x in (self.r, self.rows.v, self.t)]
        energies = np.asarray(_energies(self.model, *states))
        start = float(_energies(self.model, s.r[None], s.v[None], s.t[None])[0])
        with np.errstate(invalid="ignore", over="ignore"):
            return start - (energies - np.sum(np.asarray(self.rows.work, float), axis=1))


@cached_jit()
def _energies(model: Model, r: Array, v: Array, t: Array) -> Array:
    """Energies (k,) [J] of states (k, nodes, 3) at times (k,)."""

    def total(r: Array, v: Array, time: Array) -> Array:
        k = model.instant(r, v, time)
        return model.kinetic_energy(k) + model.potential_energy(k)

    return jax.vmap(total)(r, v, t)


def grid_run(stepper: Stepper, model: Model, s: State, grid: float, every: int, saves: int) -> GridRun:
    """`march` with the step `grid / every` [s], by a program with spare rows."""
    run = march(stepper, model, s, grid / every, every, saves, spare_rows(saves))
    rows = jax.tree.map(lambda x: np.asarray(x)[:saves], run)
    return GridRun(stepper, model, s, grid * np.arange(1, saves + 1), rows)
