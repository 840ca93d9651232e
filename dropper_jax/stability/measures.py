"""Measures of the hard cases: each function returns the number that the claim limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.interpolation import interpolate_rows
from dropper_jax.modelling.build import build
from dropper_jax.modelling.wake_model import depth_quadrature
from dropper_jax.modelling.wakes import scene_wakes
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.stability import derivatives
from dropper_jax.stability.case import Case, Outcome, scene_of, status_of
from dropper_jax.stability.march import CaseRun, run_named
from dropper_jax.stepping.integrate import integrate
from dropper_jax.stepping.stepper import make_stepper

Measure = Callable[[Case, bool], Outcome]


def measure(case: Case, short: bool) -> Outcome:
    """The number that a case limits, and the status of its run."""
    name = case.measure
    if name in OF_CASES:
        return OF_CASES[name](case, short)
    if name in OF_MARCHES:  # runs without the checks of `simulate`
        marched = run_named(case.scene, case.dt, case.span(short), **case.settings)
        return Outcome(OF_MARCHES[name](case, marched), marched.status)
    run = _run(case, short)
    if name in OF_RUNS:
        return Outcome(OF_RUNS[name](case, run), run.status)
    if run.status != case.expected:
        return Outcome(float("inf"), run.status)
    return Outcome(OF_PATHS[name](case, run.t, run.point_path(case.point)), run.status)


def _distance_of_node(case: Case, run: CaseRun) -> float:
    """Maximum distance [m] of the first free node from the exact path."""
    expected = interpolate_rows(case.exact.times, case.exact.values, run.t)
    return np.max(np.linalg.norm(run.r[:, 0] - expected, axis=-1))


def _error_of_speed(case: Case, run: CaseRun) -> float:
    """Maximum relative error of the speed of the first free node."""
    speed = np.linalg.norm(run.rows.v[:, 0], axis=-1)
    return np.max(np.abs(speed / np.interp(run.t, case.exact.times, case.exact.values) - 1))


def _rise_of_energy(case: Case, run: CaseRun) -> float:
    """Maximum rise of the energy of 1 kg from one saved time to the next [J], with the gravity of the scene."""
    gravity = float(run.model.effects[0].gravity)
    kinetic = 0.5 * np.sum(run.velocities[:, 0] ** 2, axis=-1)
    return np.max(np.diff(gravity * run.positions[:, 0, 2] + kinetic), initial=-np.inf)


#: A link with a dry joint has come to rest after this time [s].
STILL_AFTER = 20.0


def _late_movement(case: Case, short: bool) -> Outcome:
    """Movement of the nodes after `STILL_AFTER` [m]."""
    rest = run_named(case.scene, case.dt, STILL_AFTER)
    run = run_named(case.scene, case.dt, case.span(short))
    moved = np.linalg.norm(run.r[run.t >= STILL_AFTER - 1e-9] - rest.r[-1], axis=-1)
    status = rest.status
    if status == "ok":
        status = run.status
    return Outcome(np.max(moved), status)


#: Step that is far too long, over that of the scene.
TOO_LONG = 20.0


def _too_large_step(case: Case, short: bool) -> Outcome:
    """0 if the status reports that the step is too long."""
    scene = scene_of(case.scene).with_values({"run.duration": case.duration})
    found = simulate(scene, dt=TOO_LONG * scene.run.step, companion="coarser")
    return Outcome(float(found.status == "ok"), found.status)


#: Members of a batch, and the one that is not a number.
BATCH = 64
BAD_MEMBER = 17


def _bad_member(case: Case, short: bool) -> Outcome:
    """Members, of the 63 good ones, whose positions differ in any bit from those in a batch without the bad one."""
    model, s = build(scene_of(case.scene))
    rng = np.random.default_rng(0)
    v = jnp.asarray(0.01 * rng.standard_normal((BATCH, *s.v.shape)))
    steps = round(case.span(short) / case.dt)
    run = partial(integrate, make_stepper(model), model, dt=case.dt, steps=steps, save_every=steps)

    @jax.jit
    def last(v: Array) -> Array:
        return jax.vmap(lambda x: run(replace(s, v=x))[0].r)(v)

    others = np.delete(np.arange(BATCH), BAD_MEMBER)
    good = np.asarray(last(v))[others]
    with_bad_member = np.asarray(last(v.at[BAD_MEMBER].set(jnp.nan)))[others]
    differ = np.sum(np.any(good != with_bad_member, axis=(1, 2)))
    return Outcome(float(differ), status_of(with_bad_member))


@lru_cache(maxsize=1)
def _simulated(scene: str, dt: float, duration: float, settings: tuple[tuple[str, Any], ...]) -> Solution:
    """A run; the last one is stored, for cases that share it."""
    return simulate(scene_of(scene), dt=dt, duration=duration, **dict(settings))


def _run(case: Case, short: bool) -> Solution:
    """The run of a case, or its shortened one."""
    scene = case.scene
    if short and case.short_scene:
        scene = case.short_scene
    return _simulated(scene, case.dt, case.span(short), tuple(case.settings.items()))


def _distance(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Maximum distance from the exact path, of heights or in the plane y = 0."""
    exact = case.exact.upto(t[-1])
    plane = exact.values.ndim == 2
    found = positions[:, [0, 2]] if plane else positions[:, 2:]
    if case.from_start:
        found = found - found[0]
    apart = interpolate_rows(t, found, exact.times) - exact.values.reshape(len(exact.times), -1)
    return np.max(np.linalg.norm(apart, axis=1)) / case.size


def _rise(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Maximum height above the start [m]."""
    return np.max(positions[:, 2]) - positions[0, 2]


def _depth_error(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Relative error of the maximum depth below `level`; `size` is the exact one."""
    return abs((case.level - np.min(positions[:, 2])) / case.size - 1.0)


def _return_height_error(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Difference between the height at the start and the height of the first return, over `size`."""
    z = positions[:, 2]
    return abs(z[0] - np.max(z[np.argmin(z) :])) / case.size


def _path(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Relative error of the displacement along `weights` at the end."""
    exact = np.interp(t[-1], case.exact.times, case.exact.values)
    return abs(((positions[-1] - positions[0]) @ np.array(case.weights)) / exact - 1.0)


#: Time in which a weight sinks into the seabed [s].
SINKING_TIME = 1.0


def _motion_after_sinking(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Maximum distance [m] from the position at the time `SINKING_TIME`, after that time."""
    late = positions[t >= SINKING_TIME]
    return np.max(np.linalg.norm(late - late[0], axis=1))


def _angle(case: Case, t: np.ndarray, positions: np.ndarray) -> float:
    """Maximum error of the angle from the vertical [rad], seen from (0, 0, `level`)."""
    exact = case.exact.upto(t[-1])
    angle = np.arctan2(positions[:, 0], case.level - positions[:, 2])
    return np.max(np.abs(np.interp(exact.times, t, angle) - exact.values))


def _gain(case: Case, run: Solution) -> float:
    """Maximum energy gained in a step, over the energy scale of the run."""
    return max(np.max(np.diff(run.balance)), 0.0) / run.energy_scale


def _peak(case: Case, run: Solution) -> float:
    """Relative error of the maximum tension over all steps."""
    return abs(np.max(run.tension_max) / case.size - 1.0)


def _tension(case: Case, run: Solution) -> float:
    """Maximum error of the tension of the first link, over `size`."""
    exact = case.exact
    found = np.interp(exact.times, run.t_tension, run.tension[:, 0])
    return np.max(np.abs(found - exact.values)) / case.size


def _shape(case: Case, run: Solution, nodes: np.ndarray) -> float:
    """Maximum error of a weighted sum over the nodes (k, nodes), over `size`."""
    exact = case.exact.upto(run.t[-1])
    found = np.interp(exact.times, run.t, nodes @ np.array(case.weights))
    return np.max(np.abs(found - exact.values)) / case.size


def _ropes_pass_through(case: Case, run: Solution) -> float:
    """1 if ropes are above each other in two rows of the run and have changed sides in between.

    The weight bounces off sideways, round the end of the lower rope: if it is below this rope later, it has not passed
    through it.
    """
    low, left, right = (run.positions[:, line.nodes] for line in run.lines)
    before = np.zeros(0)
    for first, second, below in zip(left, right, low, strict=True):
        heights = _heights_above(np.concatenate([first, second[1:]]), below)
        if heights.size and before.size:
            fell = np.min(before) > 0.0 > np.max(heights)
            rose = np.min(heights) > 0.0 > np.max(before)
            if fell or rose:
                return 1.0
        before = heights
    return 0.0


def _heights_above(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Heights (crossings,) [m] of a rope (nodes, 3) above another at their crossings as seen from above.

    Links a + s d and c + t e cross if s and t are both between 0 and 1.
    """
    a = high[:-1, None]
    d = np.diff(high, axis=0)[:, None]
    c = low[None, :-1]
    e = np.diff(low, axis=0)[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = _turn(c - a, e) / _turn(d, e)
        t = _turn(c - a, d) / _turn(d, e)
    height = (a[..., 2] + s * d[..., 2]) - (c[..., 2] + t * e[..., 2])
    return height[(s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)]


def _turn(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Vertical component of a cross product."""
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]


def _wake(case: Case, short: bool) -> Outcome:
    """Momentum that the water has lost behind a row, by quadrature over a plane across it, against the row's drag."""
    run = _run(case, short)
    wakes = scene_wakes(run.scene).wakes
    y = np.linspace(-40.0, 40.0, 8001)
    z, weight = depth_quadrature(40, wakes.depth)
    plane = wakes.plane(float(wakes.elements.x.max()) + 5.0)
    deficit = plane.deficit_on_grid(y, z)
    lost = float(np.sum((wakes.speed - deficit) * deficit @ weight) * (y[1] - y[0]))
    error = abs(lost / float(np.sum(wakes.drag)) - 1.0)
    if not (np.all(wakes.inflow > 0.0) and np.all(wakes.inflow <= wakes.speed)):
        error = np.inf
    return Outcome(error, run.status)


#: Measures of the path of the case's point, which other simulators can be measured by as well; infinite if the run does
#: not have the expected status.
OF_PATHS: dict[str, Callable[[Case, np.ndarray, np.ndarray], float]] = {
    "distance": _distance,
    "rise": _rise,
    "lowest": _depth_error,
    "return": _return_height_error,
    "way": _path,
    "late motion": _motion_after_sinking,
    "angle": _angle,
}
OF_MARCHES: dict[str, Callable[[Case, CaseRun], float]] = {
    "relative drift": lambda case, run: run.relative_drift,
    "energy drift": lambda case, run: run.energy_drift,
    "closure": lambda case, run: run.closure,
    "distance of node": _distance_of_node,
    "error of speed": _error_of_speed,
    "rise of energy": _rise_of_energy,
}
OF_RUNS: dict[str, Callable[[Case, Solution], float]] = {
    "balance": lambda case, run: run.energy_drift / run.energy_scale,
    "gain": _gain,
    "peak": _peak,
    "tension": _tension,
    "twist": lambda case, run: _shape(case, run, run.twist),
    "heights": lambda case, run: _shape(case, run, run.positions[:, :, 2]),
    "way of body": lambda case, run: abs(run.body_position[-1, 0, 0] / case.size - 1.0),
    "passes": _ropes_pass_through,
}
OF_CASES: dict[str, Measure] = {
    "stays": _late_movement,
    "too large a step": _too_large_step,
    "bad member": _bad_member,
    "wake": _wake,
    "derivative": derivatives.against_differences,
    "derivative at rest": derivatives.at_rest,
    "derivative is finite": derivatives.finite,
}
