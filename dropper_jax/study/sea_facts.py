"""Properties of the sea of a scene: waves by the valid theories, breaking, current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.read import Table
from dropper_jax.load.checks_water import SHALLOW_HEIGHT, mean_period, steepest_sea
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build_model
from dropper_jax.run.line_weights import fixed_point_loads
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.scene import line_slices, utilisations
from dropper_jax.sea import Sea
from dropper_jax.sea.make import finite_wave, make_current, make_sea
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import SteadyWave, fitting_theory, highest, second_harmonic
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.static_pose import equilibrium, release_loads


def sea_facts(scene: Scene) -> Table:
    """Facts about the water of a scene: {depth_m, waves, current}; the last two may be None.

    Raises:
        ValueError: the scene has no sea.
    """
    spec = scene.sea
    if spec is None:
        raise ValueError(f"scene {scene.name!r} has no [sea]. Use a scene with water")
    return {"depth_m": spec.depth, "waves": _waves(spec), "current": _current(spec)}


def _waves(spec: SeaSpec) -> Table | None:
    if spec.waves is None:
        return None
    wave = finite_wave(spec)
    if wave is not None:
        return _steady(wave)
    sea = make_sea(replace(spec, interpolation="none"))
    if sea.waves.size == 1:
        return _linear(sea.waves, spec.depth)
    return _irregular(sea, spec)


def _regular(theory: str, height: float, length: float, period: float, depth: float, **more: float) -> Table:
    limit = highest(length, depth)
    return {
        "kind": "regular",
        "theory": theory,
        "height_m": height,
        "period_s": period,
        "length_m": length,
        "celerity_m_per_s": length / period,
        "depth_over_length": depth / length,
        "steepness": height / length,
        "ursell": height * length**2 / depth**3,
        "second_harmonic": second_harmonic(height, length, depth),
        "highest_m": limit,
        "share_of_highest": height / limit,
        "fitting_theory": fitting_theory(height, length, depth),
        **more,
    }


def _steady(wave: SteadyWave) -> Table:
    return _regular(
        wave.theory,
        wave.height,
        wave.length,
        wave.period,
        wave.depth,
        celerity_m_per_s=wave.celerity,
        crest_m=wave.crest,
        trough_m=wave.crest - wave.height,
        mean_eulerian_m_per_s=wave.eulerian,
        mean_transport_m_per_s=wave.transport,
        crest_speed_m_per_s=float(wave.velocity(np.zeros(1), np.array([wave.crest]))[0, 0]),
        harmonics=wave.order,
        error=wave.error,
    )


def _linear(waves: Waves, depth: float) -> Table:
    a, k, omega = (float(x[0]) for x in (waves.amplitude, waves.wave_number, waves.omega))
    return _regular("linear", 2.0 * a, 2.0 * np.pi / k, 2.0 * np.pi / omega, depth, crest_m=a, trough_m=-a)


def _irregular(sea: Sea, spec: SeaSpec) -> Table:
    """Hs, mean period `Tz = 2 pi sqrt(m0/m2)`, and the limits of depth and of steepness."""
    hs = float(sea.waves.significant_height)
    tz = mean_period(sea)
    limits = {"depth": SHALLOW_HEIGHT * spec.depth, "steepness": steepest_sea(tz, spec.gravity)}
    limit, breaking = min(limits.items(), key=itemgetter(1))
    return {
        "kind": "irregular",
        "theory": "linear",
        "components": int(sea.waves.size),
        "significant_height_m": hs,
        "mean_period_s": tz,
        "peak_period_s": float(2.0 * np.pi / sea.waves.omega[int(np.argmax(np.asarray(sea.waves.amplitude)))]),
        "hs_over_depth": hs / spec.depth,
        "steepness": 2.0 * np.pi * hs / (spec.gravity * tz**2),
        "breaking_hs_m": breaking,
        "breaking_by": limit,
        "share_of_breaking": hs / breaking,
    }


def _current(spec: SeaSpec) -> Table | None:
    if spec.current is None:
        return None
    heights = np.array([0.0, -0.5 * spec.depth, -0.95 * spec.depth])
    x, y, *_ = np.asarray(make_current(spec.current).profile(jnp.asarray(heights), jnp.asarray(spec.depth))).T
    values = {"speed_m_per_s": np.hypot(x, y), "direction_rad": np.arctan2(y, x)}
    return {"kind": spec.current.kind, "heights_m": heights, **values}


def cycle_times(sea: Sea, count: int) -> np.ndarray:
    """Times (count,) [s] over the longest constituent of current and level, or over their tables.

    Raises:
        SceneError: neither changes with time.
    """
    parts = [p for p in (sea.current, sea.level) if p is not None]
    periods = [np.max(p.period) for p in parts if p.period is not None]
    times = [p.time for p in parts if p.time is not None]
    if periods:
        return np.linspace(0.0, max(periods), count)
    if times:
        return np.linspace(np.min(np.concatenate(times)), np.max(np.concatenate(times)), count)
    raise SceneError(STEADY)


STEADY = "--tide: neither sea.current nor sea.level changes with time. Use a scene in which one does"


def tidal_cycle(scene: Scene, count: int = 13) -> Table:
    """Independent equilibria at times of a cycle: the line is assumed to follow the tide without delay.

    Returns:
        {rows, slack, slack_status}: per time {t_s, level_m, speed_m_per_s, status, displacement_m, line_moved_m,
        held_load_n, anchor_utilisation (of points with an `[[anchor]]`: load over capacity)}; `slack` are the positions
        (nodes, 3) [m] without a current at the mean level, `displacement_m` and `line_moved_m` the maximum horizontal
        displacements from there of all nodes and of the nodes of each line.
    """
    model = build_model(scene)
    sea = model.sea
    if sea is None:
        raise SceneError(STEADY)
    loads = release_loads(model, scene.start)
    times = cycle_times(sea, count)
    slack = equilibrium(replace(model, sea=replace(sea, current=None, level=None)), loads)
    rows = []
    for t in times:
        pose = equilibrium(model, loads, float(t))
        held = fixed_point_loads(scene, pose.positions, pose.tension, float(t))
        used = utilisations(scene.anchors, {name: (np.hypot(*load[:2]), load[2]) for name, load in held.items()})
        way = np.hypot(*(pose.positions - slack.positions)[:, :2].T)
        level = 0.0 if sea.level is None else sea.level.at(jnp.asarray(t))
        rows.append(
            {
                "t_s": float(t),
                "level_m": float(level),
                "speed_m_per_s": _speed(sea, t),
                "status": pose.status,
                "displacement_m": way.max(),
                "line_moved_m": {line.name: way[line.nodes].max() for line in line_slices(scene)},
                "held_load_n": held,
                "anchor_utilisation": used,
            }
        )
    return {"rows": rows, "slack": slack.positions, "slack_status": slack.status}


def _speed(sea: Sea, t: float) -> float:
    """Speed of the current at the surface [m/s], negative after the current has turned."""
    if sea.current is None:
        return 0.0
    surface = jnp.linalg.norm(sea.current.profile(jnp.zeros(1), sea.depth))
    return float(sea.current.scale(jnp.asarray(t))) * float(surface)


#: Fraction of a run, at its end, for the evaluation of the response.
TAKEN = 1.0 / 3.0
#: Increase of the wave height for the additional curve.
HIGHER_WAVES = 1.1


def responses(
    scene: Scene, periods: Sequence[float] | np.ndarray, more: bool = True, progress: Progress = silent
) -> list[Table]:
    """Response of a scene's first link in regular waves of these periods [s], over whole periods at the end of runs.

    Args:
        more: also with waves that are 10 % higher.

    Returns:
        {period_s, status, mean_rad, amplitude_rad, phase_rad, wet, amplitude_10_percent_more} per period: mean and
        first harmonic of the angle from the vertical in the plane of the waves, its phase relative to the elevation at
        the fixed point (0 in phase, -pi/2 a quarter period behind), mean wet fraction of the far end, and the amplitude
        at 1.1 times the height.

    Raises:
        SceneError: no regular waves of a period, or runs shorter than three periods.
    """
    waves = None if scene.sea is None else scene.sea.waves
    if waves is None or waves.kind != "regular" or waves.period is None:
        raise SceneError("sea.waves: a response needs regular waves with a period; allowed: kind 'regular', `period`")
    least = max(periods) / TAKEN
    if scene.run.duration < least:
        raise SceneError(
            f"run.duration: {scene.run.duration:g} s is too short for these periods; allowed: >= {least:g} s"
        )
    key = "height" if waves.amplitude is None else "amplitude"
    higher = {f"sea.waves.{key}": HIGHER_WAVES * np.max(getattr(waves, key))}
    found = []
    for i, period in enumerate(map(float, periods)):
        progress(i / len(periods), f"period {period:g} s")
        values = {"sea.waves.period": period}
        row = {"period_s": period, **_response(simulate(scene.with_values(values)), period)}
        if more:
            other = _response(simulate(scene.with_values({**values, **higher})), period)
            row["amplitude_10_percent_more"] = other["amplitude_rad"] / row["amplitude_rad"] - 1.0
        found.append(row)
    progress(1.0, "")
    return found


def _response(solution: Solution, period: float) -> Table:
    """Mean, first harmonic and wet fraction of a run in waves of a period [s], over whole periods at its end."""
    model = build_model(solution.scene, "float64")
    sea = model.sea
    if sea is None or model.line.diameter is None:
        raise SceneError("line.0.diameter: missing; a response needs it, > 0 m")
    span = np.floor(TAKEN * solution.t[-1] / period) * period
    last = solution.t > solution.t[-1] - span
    t = solution.t[last]
    nodes = solution.positions[last]
    course = float(sea.waves.direction)
    link = nodes[:, 1] - nodes[:, 0]
    angle = np.arctan2(link[:, :2] @ [np.cos(course), np.sin(course)], -link[:, 2])
    held = jnp.asarray(nodes[:1, 0] * [1.0, 1.0, 0.0])
    eta = np.asarray(jax.jit(jax.vmap(lambda s: sea.elevation(held, s)[0]))(jnp.asarray(t)))
    wave = np.exp(-2j * np.pi * t / period)
    swing = 2 * np.mean((angle - angle.mean()) * wave)
    surface = 2 * np.mean(eta * wave)
    size = float(model.line.diameter[0]) + np.abs(link[:, 2])
    s = np.clip(0.5 + (eta - nodes[:, 1, 2]) / size, 0.0, 1.0)
    return {
        "status": solution.status,
        "mean_rad": angle.mean(),
        "amplitude_rad": abs(swing),
        "phase_rad": np.angle(swing / surface),
        "wet": np.mean(s * s * (3.0 - 2.0 * s)),
    }
