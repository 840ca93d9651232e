"""Runs on one time grid whose step is a plain argument: every step size shares one compiled program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.analysis.angles import link_angles
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.equal_steps import next_progress
from dropper_jax.stepping.integrate import advance, empty_rows, scan_steps
from dropper_jax.stepping.progress import Progress, begin
from dropper_jax.stepping.stepper import make_stepper

#: Schemes with a weight gamma, and the default weights of a comparison.
SCHEME_WEIGHTS = {"theta": (0.51, 1.0), "theta_midpoint": (0.51,), "thesis_angles": (0.51,)}
#: Further solvers and precisions of the main schemes.
SOLVERS = {"energy_momentum": ("banded", "dense")}
SINGLE = ("energy_momentum", "rattle")
#: Schemes compared in waves.
IN_WAVES = ("energy_momentum", "rattle", "theta_midpoint", "rk4", "energy_momentum_4", "generalized_alpha")


@dataclass(frozen=True)
class Scheme:
    """An integrator with its weight, solver and precision."""

    integrator: str
    gamma: float | None = None
    solver: str = "auto"
    dtype: str = "float64"

    @classmethod
    def named(cls, name: str) -> Scheme:
        """An integrator with the first of its default weights."""
        return cls(name, SCHEME_WEIGHTS.get(name, (None,))[0])

    @property
    def label(self) -> str:
        """Name for tables and legends."""
        weight = "" if self.gamma is None else f"{self.gamma:g}"
        parts = (self.integrator, weight, self.solver, self.dtype)
        return " ".join(part for part in parts if part not in ("", "auto", "float64"))

    def stepper(self, model: Model, **settings: object) -> Stepper:
        """Raises `SceneError` if the scheme cannot run the model."""
        return make_stepper(model, self.integrator, self.solver, gamma=self.gamma, **settings)


def parse(text: str) -> Scheme:
    """A scheme from `NAME`, or `NAME:GAMMA` such as `theta:0.51`."""
    name, _, weight = text.strip().partition(":")
    if name not in INTEGRATORS:
        raise SceneError(f"--integrators: {name!r} is unknown; allowed: {', '.join(INTEGRATORS)}, with :GAMMA")
    if not weight:
        return Scheme.named(name)
    try:
        return Scheme(name, float(weight))
    except ValueError:
        raise SceneError(f"--integrators: {text!r}: {weight!r} is not a number; allowed: NAME or NAME:GAMMA") from None


def default_schemes(model: Model, quick: bool = False) -> list[Scheme]:
    """Every integrator; the main ones also with every solver and in single precision, unless `quick`.

    In waves one of each kind: a step costs 50 times as much there, and the others are known from calm scenes.
    """
    if model.sea is not None and model.sea.waves is not None:
        return [Scheme.named(name) for name in IN_WAVES]
    found = []
    for name in INTEGRATORS:
        plain = [Scheme(name, gamma) for gamma in SCHEME_WEIGHTS.get(name, (None,))]
        found += plain
        if quick:
            continue
        found += [replace(plain[0], solver=solver) for solver in SOLVERS.get(name, ())]
        if name in SINGLE:
            found.append(replace(plain[0], dtype="float32"))
    return found


def runnable(schemes: Sequence[Scheme], model: Model) -> tuple[list[Scheme], list[dict[str, str]]]:
    """The schemes that can run the model, and the others with their reasons."""
    good = []
    refused = []
    for scheme in schemes:
        try:
            scheme.stepper(model)
            good.append(scheme)
        except SceneError as error:
            refused.append({"scheme": scheme.label, "reason": str(error)})
    return good, refused


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
    speed = jnp.sum(jnp.square(found.v), axis=(1, 2))
    # a loop, not `cumsum`, which would prevent one kernel
    passed = jax.lax.scan(lambda total, x: (total + x, total + x), jnp.zeros((), model.dtype), speed)[1]
    path = grid * (passed - 0.5 * speed)
    run = Marched(found.r, found.v, both, found.work, found.residual, found.first_bad, found.retried, path)
    return MarchResult(run, jnp.sum(found.within.steps), end.control.refused)


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
        return np.stack(link_angles(nodes if self.status == "ok" else np.full_like(nodes, np.nan)))

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


SCHEMES = (Scheme("energy_momentum"), Scheme("thesis_angles", 0.51))


def convergence(
    model: Model, s: State, grid: float, saves: int, dts: list[float], schemes: tuple[Scheme, ...] = SCHEMES
) -> list[Table]:
    """RMS difference of each link's angles [rad] between a step and half of it, over the first `saves * grid` seconds.

    Returns:
        one {label, dts, polar (steps, n), azimuth (steps, n) or None in a plane, status (steps,)} per scheme that
        runs the model; NaN if either run failed.
    """
    found = []
    everies = sorted({max(1, round(grid / dt)) for dt in dts})
    for scheme in runnable(schemes, model)[0]:
        stepper = scheme.stepper(model)
        runs = [grid_run(stepper, model, s, grid, every, saves) for every in [*everies, 2 * everies[-1]]]
        turns = np.angle(np.exp(1j * np.diff([run.angles for run in runs], axis=0)))  # modulo full turns
        polar, azimuth = np.sqrt(np.mean(turns**2, axis=2)).swapaxes(0, 1)
        flat = bool(np.nanmax(azimuth, initial=0.0) < 1e-12)
        found.append(
            {
                "label": scheme.label,
                "dts": [grid / every for every in everies],
                "polar": polar,
                "azimuth": None if flat else azimuth,
                "status": [run.status for run in runs[:-1]],
            }
        )
    return found
