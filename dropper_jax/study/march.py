"""Runs on one time grid whose step is a plain argument: every step size shares one compiled program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.analysis.angles import link_angles
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.adaptive import adaptive_start, advance_adaptively
from dropper_jax.stepping.integrate import Progress, begin, empty_rows, next_progress, scan_steps
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

    @property
    def label(self) -> str:
        """Name for tables and legends."""
        parts = [self.integrator]
        if self.gamma is not None:
            parts.append(f"{self.gamma:g}")
        if self.solver != "auto":
            parts.append(self.solver)
        if self.dtype != "float64":
            parts.append(self.dtype)
        return " ".join(parts)

    def stepper(self, model: Model, **settings: object) -> Stepper:
        """Raises `SceneError` if the scheme cannot run the model."""
        return make_stepper(model, self.integrator, self.solver, gamma=self.gamma, **settings)


def parse(text: str) -> Scheme:
    """A scheme from `NAME`, or `NAME:GAMMA` such as `theta:0.51`."""
    name, _, weight = text.strip().partition(":")
    if name not in INTEGRATORS:
        raise SceneError(f"--integrators: {name!r} is unknown; allowed: {', '.join(INTEGRATORS)}, with :GAMMA")
    if not weight:
        return Scheme(name, SCHEME_WEIGHTS.get(name, (None,))[0])
    try:
        return Scheme(name, float(weight))
    except ValueError:
        raise SceneError(f"--integrators: {text!r}: {weight!r} is not a number; allowed: NAME or NAME:GAMMA") from None


def default_schemes(model: Model, quick: bool = False) -> list[Scheme]:
    """Every integrator; the main ones also with every solver and in single precision, unless `quick`.

    In waves one of each kind: a step costs 50 times as much there, and the others are known from calm scenes.
    """
    found = []
    if model.sea is not None and model.sea.waves is not None:
        return [Scheme(name, SCHEME_WEIGHTS.get(name, (None,))[0]) for name in IN_WAVES]
    for name in INTEGRATORS:
        plain = [Scheme(name, gamma) for gamma in SCHEME_WEIGHTS.get(name, (None,))]
        found += plain
        if quick:
            continue
        found += [replace(plain[0], solver=solver) for solver in SOLVERS.get(name, ())]
        if name in SINGLE:
            found.append(replace(plain[0], dtype="float32"))
    return found


def runnable(schemes: list[Scheme], model: Model) -> tuple[list[Scheme], list[dict[str, str]]]:
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
Rows = jax.Array | np.ndarray


def link_vectors(model: Model, r: Rows, t: np.ndarray) -> np.ndarray:
    """Link vectors (k, n, 3) [m] of free nodes r (k, nodes, 3) at times t (k,), in the precision of r."""
    return np.asarray(_links(model, jnp.asarray(r), jnp.asarray(t, model.dtype))).astype(r.dtype)


@cached_jit()
def _links(model: Model, r: jax.Array, t: jax.Array) -> jax.Array:
    return jax.vmap(lambda nodes, time: model.links(nodes, model.ends(time)))(r, t)


def angles_between(d: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Angle [rad] between link vectors (..., 3) and those of a reference.

    In a plane it is the difference of the polar angles; in space it has no singular direction, unlike an azimuth.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        u = d / np.linalg.norm(d, axis=-1, keepdims=True)
        w = reference / np.linalg.norm(reference, axis=-1, keepdims=True)
        chord = np.linalg.norm(u - w, axis=-1)
        return 2 * np.arcsin(np.minimum(0.5 * chord, 1.0))


def rms(x: Rows) -> float:
    """Root of the mean square; infinite if any entry is not finite."""
    with np.errstate(over="ignore"):
        if np.all(np.isfinite(x)):
            return float(np.sqrt(np.mean(np.square(x))))
        return float("inf")


def rms_angle(d: np.ndarray, reference: np.ndarray) -> float:
    """RMS over times and links of the angle between links [rad]."""
    return rms(angles_between(d, reference))


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

    r: jax.Array
    v: jax.Array
    tension: jax.Array
    work: jax.Array
    residual: jax.Array
    bad: jax.Array
    retried: jax.Array
    path: jax.Array


class _SoFar(NamedTuple):
    """Of a run: its last step, tensions of the first step since the saved row, and `Marched`'s values up to now."""

    progress: Progress
    first: jax.Array
    worst: jax.Array
    retried: jax.Array
    path: jax.Array


@cached_jit(static=("stepper", "capacity"), kernel=True)
def march(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: jax.Array | float,
    every: jax.Array | int,
    saves: jax.Array | int,
    capacity: int,
) -> Marched:
    """`saves` times `every` steps of `dt` from s, in the first of `capacity` rows.

    dt, `every` and `saves` are traced, so other step sizes and durations do not compile again.
    """
    dt = jnp.asarray(dt, model.dtype)

    def one(i: jax.Array, so_far: _SoFar) -> _SoFar:
        after, taken = next_progress(stepper, model, so_far.progress, dt)
        path = so_far.path + jnp.sum((after.state.r - so_far.progress.state.r) ** 2) / dt
        first = jnp.where(i == 0, after.state.tension, so_far.first)
        return _SoFar(after, first, jnp.maximum(so_far.worst, taken.row), so_far.retried + taken.retried, path)

    def row(so_far: _SoFar) -> Marched:
        progress, first, worst, retried, path = so_far
        s = progress.state
        return Marched(s.r, s.v, jnp.stack([s.tension, first]), s.work, worst, progress.first_bad, retried, path)

    def save(so_far: _SoFar, _: jax.Array) -> tuple[_SoFar, Marched]:
        so_far = jax.lax.fori_loop(0, every, one, so_far)
        return so_far, row(so_far)

    zero = jnp.zeros((), model.dtype)
    start = _SoFar(begin(stepper, model, s), jnp.zeros_like(s.tension), zero, jnp.zeros((), jnp.int32), zero)
    return scan_steps(save, start, saves, empty_rows(jax.eval_shape(row, start), capacity))[1]


class MarchResult(NamedTuple):
    """Result of `march_with_accuracy`: states at the grid's times, accepted and rejected steps."""

    run: Marched
    taken: jax.Array
    refused: jax.Array


@cached_jit(static=("stepper", "saves"), kernel=True)
def march_with_accuracy(
    stepper: Stepper, model: Model, s: State, grid: jax.Array | float, accuracy: jax.Array | float, saves: int
) -> MarchResult:
    """`march` in steps that follow an accuracy, on a grid [s]; `path` by the trapezoidal rule, tensions are means."""
    grid = jnp.asarray(grid, model.dtype)
    start = adaptive_start(stepper, model, begin(stepper, model, s))
    end, (found, within) = advance_adaptively(stepper, model, start, grid, jnp.asarray(accuracy, model.dtype), saves)
    both = jnp.stack([found.tension, jnp.roll(found.tension, 1, axis=0)], axis=1)
    speed = jnp.sum(jnp.square(found.v), axis=(1, 2))
    # a loop, not `cumsum`, which would prevent one kernel
    passed = jax.lax.scan(lambda total, x: (total + x, total + x), jnp.zeros((), model.dtype), speed)[1]
    path = grid * (passed - 0.5 * speed)
    run = Marched(found.r, found.v, both, found.work, found.residual, found.first_bad, found.retried, path)
    return MarchResult(run, jnp.sum(within.steps), end.refused)


def spare_rows(saves: int) -> int:
    """Rows of a program that serves many durations: `saves` if that is small, else 640, or a larger power of two."""
    if saves <= 32:
        return saves
    if saves <= 640:
        return 640
    return 1 << (saves - 1).bit_length()


def grid_run(stepper: Stepper, model: Model, s: State, grid: float, every: int, saves: int) -> Marched:
    """`march` with the step `grid / every` [s], as numpy arrays (saves, ...), by a program with spare rows."""
    run = march(stepper, model, s, grid / every, every, saves, spare_rows(saves))
    return jax.tree.map(lambda x: np.asarray(x)[:saves], run)


def status_of(run: Marched, stepper: Stepper) -> str:
    """`ok` or the named failure of a run, with the status names of `simulate`."""
    bad = np.asarray(run.bad)
    if bad[-1] < 0 and np.all(np.isfinite(run.r[-1])):
        return "ok"
    if not np.isfinite(run.residual[-1]) or bad[-1] < 0:
        return "non_finite"
    if stepper.halvings:
        return "retry_exhausted"
    return "not_converged"


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
    for scheme in schemes:
        try:
            stepper = scheme.stepper(model)
        except SceneError:
            continue
        everies = sorted({max(1, round(grid / dt)) for dt in dts})
        motions = []
        states = []
        for every in [*everies, 2 * everies[-1]]:
            run = grid_run(stepper, model, s, grid, every, saves)
            states.append(status_of(run, stepper))
            motions.append(_angles(model, run.r, grid) if states[-1] == "ok" else None)
        found.append(_differences(scheme.label, [grid / e for e in everies], motions, states))
    return found


def _angles(model: Model, r: Rows, grid: float) -> np.ndarray:
    """Polar and azimuth (2, k, n) [rad]."""
    links = link_vectors(model, r, grid * np.arange(1, len(r) + 1))
    nodes = np.concatenate([np.zeros((len(r), 1, 3)), np.cumsum(links, axis=1)], axis=1)
    return np.stack(link_angles(nodes))


def _differences(label: str, dts: list[float], motions: list[np.ndarray | None], states: list[str]) -> Table:
    count = next((m.shape[-1] for m in motions if m is not None), 0)
    nothing = np.full((2, count), np.nan)
    pairs = pairwise(motions)
    rows = np.array([nothing if a is None or b is None else _rms_turn(a - b) for a, b in pairs])
    polar = rows[:, 0]
    azimuth = rows[:, 1]
    flat = bool(np.nanmax(azimuth, initial=0.0) < 1e-12)
    return {"label": label, "dts": dts, "polar": polar, "azimuth": None if flat else azimuth, "status": states[:-1]}


def _rms_turn(difference: np.ndarray) -> np.ndarray:
    """RMS over time (2, n) of angle differences, modulo full turns."""
    turn = np.angle(np.exp(1j * difference))
    return np.sqrt(np.mean(turn**2, axis=1))
