"""Motions and tensions of a scene in irregular waves, in the frequency domain (see `states`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from dropper_jax.base.errors import SceneError, require_positive
from dropper_jax.base.markdown import first_names
from dropper_jax.base.records import names_of
from dropper_jax.frequency.linear_waves import check_no_bodies, still_model
from dropper_jax.frequency.states import DRAG_TOLERANCE, solve_states
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model
from dropper_jax.model.slots import Displacement
from dropper_jax.modelling.build import SceneLike, build_model
from dropper_jax.modelling.scene_model import static_pose
from dropper_jax.run.simulate import simulate
from dropper_jax.scene import WholeLine, whole_lines
from dropper_jax.sea.make import make_current, waves_of
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.wave_spec import WaveSpec
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.descent import with_springs
from dropper_jax.statics.equilibrium import Equilibrium
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.static_pose import equilibrium

#: Largest error of the basis that stays below that of the linearisation.
BASIS_ERROR = 0.02
#: Standard deviations below which a mean tension is taken as one that does not stay positive.
TAUT_DEVIATIONS = 3.0


@dataclass(frozen=True)
class FrequencyResponse:
    """Response of a scene in sea states, at the ends of its lines and its free points.

    Attributes:
        status: per state `ok`, `not_linear` if a line goes slack (its numbers are kept), or `not_converged` if the
            linearised drag was still changing.
        sea_states: significant height [m] and peak period [s] (states, 2).
        omega: frequencies of the waves (states, c) [rad/s].
        ends: line and point of each end of a line.
        points: names of the free points.
        lines: names of the lines.
        static_tension: (ends,) [N], in the pose without waves.
        mean_tension: with the mean drag of the waves (states, ends) [N].
        tension_deviation: standard deviation (states, ends) [N].
        tension_period: zero-upcrossing period (states, ends) [s], `2 pi sqrt(m_0/m_2)`.
        maximum_tension: most probable maximum (states, ends) [N] in `duration`, see `frequency_response`.
        motion_deviation: standard deviations of the free points (states, points, 3) [m].
        tension: complex amplitudes (states, c, ends) [N]; the tension is the sum of Re(amplitude exp(i w t)).
        motion: complex amplitudes of the free points (states, c, points, 3) [m].
        slack: whether a link of the line has a mean tension below three standard deviations (states, lines): its
            response is not linear.
        basis_error: maximum difference of a tension's standard deviation from that of the full equations, relative to
            the largest one, in the states that made the basis.
        duration: of the most probable maximum [s].
    """

    status: tuple[str, ...]
    sea_states: np.ndarray
    omega: np.ndarray
    ends: tuple[tuple[str, str], ...]
    points: tuple[str, ...]
    lines: tuple[str, ...]
    static_tension: np.ndarray
    mean_tension: np.ndarray
    tension_deviation: np.ndarray
    tension_period: np.ndarray
    maximum_tension: np.ndarray
    motion_deviation: np.ndarray
    tension: np.ndarray
    motion: np.ndarray
    slack: np.ndarray
    basis_error: float
    duration: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that do not stay taut in some state, and an inaccurate basis."""
        loose = [name for name, low in zip(self.lines, np.any(self.slack, axis=0), strict=True) if low]
        found = []
        if loose:
            found.append(f"lines that go slack: {first_names(loose, 5)}: not linear here, run in time")
        if self.basis_error > BASIS_ERROR:
            found.append(
                f"the shared basis has an error of {100 * self.basis_error:.2g} %: use fewer sea states at once"
            )
        return tuple(found)

    def spectra(self, state: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequencies (k,) [rad/s], spectra of end tensions (k, ends) [N^2 s/rad] and of motions (k, points, 3) [m^2
        s/rad] of a sea state; components of equal frequency are added."""
        omega, of = np.unique(self.omega[state], return_inverse=True)
        width = np.gradient(omega) if omega.size > 1 else np.full(1, np.inf)
        found = []
        for amplitude in (self.tension[state], self.motion[state]):
            energy = np.zeros((omega.size, *amplitude.shape[1:]))
            np.add.at(energy, of, 0.5 * np.abs(amplitude) ** 2)
            found.append((energy.T / width).T)
        return omega, *found


def frequency_response(
    scene: SceneLike,
    sea_states: ArrayLike | None = None,
    *,
    direction: float | None = None,
    frequencies: int = 40,
    duration: float = 10800.0,
) -> FrequencyResponse:
    """Tensions and motions in irregular waves about the static pose, with linearised drag, for many sea states at once.

    The most probable maximum of a tension in N = duration/T_z upcrossings is `T_mean + sigma sqrt(2 ln N)`: maxima of a
    narrow-banded normal process (Rayleigh).

    Args:
        scene: packaged name, TOML file, plain values or a `Scene`.
        sea_states: significant heights [m] and peak periods [s] (states, 2); None: the waves of the scene, unchanged.
        direction: of these states' waves [rad], from x towards y; None: that of the scene, or 0.
        frequencies: number of frequencies of these states, evenly spaced from 0.5 to 4 peak frequencies.
        duration: of the most probable maximum [s], three hours.

    Raises:
        SceneError: no sea or waves, regular waves, no equilibrium, rigid bodies, an end that moves by itself, a wave
            that a current stops, a direction that is not finite, less than one frequency, a duration that is not
            positive.
    """
    _check_request(direction, frequencies, duration)
    scene = load_scene(scene)
    sea = _sea_of(scene)
    model = build_model(scene, "float64")
    _check_linear(model, sea_states is not None)
    states, waves = _waves(sea, sea_states, direction, frequencies)
    model, pose = _stretching_pose(scene, model)
    links = _end_links(scene)
    points = [point for point in scene.points if point.is_free]
    nodes = [model.geometry.node_of_point(i) for i, point in enumerate(scene.points) if point.is_free]
    solved, error = solve_states(still_model(model, pose.state), pose.state, waves, links, np.array(nodes, int))
    static = np.asarray(pose.tension)
    mean = static + np.asarray(solved.shift)
    omega = np.asarray(waves.omega)
    deviation_of_all = np.asarray(solved.deviation)
    deviation = deviation_of_all[:, links]
    rate = _root_mean_square(omega[:, :, None] * solved.tension)
    period = 2.0 * np.pi * deviation / np.maximum(rate, 1e-300)
    lines = whole_lines(scene)
    slack = _lines_that_go_slack(lines, mean, deviation_of_all)
    linear = np.where(np.any(slack, axis=1), "not_linear", "ok")
    return FrequencyResponse(
        status=tuple(np.where(solved.change <= DRAG_TOLERANCE, linear, "not_converged").tolist()),
        sea_states=states,
        omega=omega,
        ends=_ends_of(lines),
        points=tuple(names_of(points)),
        lines=tuple(names_of(lines)),
        static_tension=static[links],
        mean_tension=mean[:, links],
        tension_deviation=deviation,
        tension_period=period,
        maximum_tension=_most_probable_maximum(mean[:, links], deviation, period, duration),
        motion_deviation=_root_mean_square(solved.motion),
        tension=solved.tension,
        motion=solved.motion,
        slack=slack,
        basis_error=error,
        duration=duration,
    )


def _check_request(direction: float | None, frequencies: int, duration: float) -> None:
    if frequencies < 1:
        raise SceneError(f"frequencies: {frequencies} is out of range; allowed: 1 or more")
    if direction is not None and not np.isfinite(direction):
        raise SceneError(f"direction: {direction:g} is not finite; allowed: a finite angle")
    require_positive("duration", duration, " s")


def _lines_that_go_slack(lines: Sequence[WholeLine], mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Whether lines go slack (states, lines), from means and standard deviations (states, n) [N] of all tensions."""
    low = mean < TAUT_DEVIATIONS * deviation
    return np.stack([np.any(low[:, line.links], axis=1) for line in lines], axis=1)


def _most_probable_maximum(mean: np.ndarray, deviation: np.ndarray, period: np.ndarray, duration: float) -> np.ndarray:
    """`T_mean + sigma sqrt(2 ln N)` with N = duration/T_z, at least 1."""
    upcrossings = np.maximum(duration / np.maximum(period, 1e-300), 1.0)
    return mean + np.sqrt(2.0 * np.log(upcrossings)) * deviation


def _check_linear(model: Model, has_sea_states: bool) -> None:
    """Reject what the frequency domain does not describe."""
    check_no_bodies(model)
    for effect in model.effects_with(Displacement):
        if not effect.needs_sea:
            raise SceneError(f"effects.{effect.name}: its motion does not come from the sea. Use a run in time")
    if has_sea_states and model.effect("vessel_motion") is not None:
        raise SceneError(
            "vessel: has factors at the frequencies of the scene's own waves only. Use it without sea states"
        )


def _stretching_pose(scene: Scene, model: Model) -> tuple[Model, Equilibrium]:
    """The equilibrium, with springs for rigid links that stretch by 0.01 % under the maximum tension; and its model."""
    pose = static_pose(scene, model)
    if pose.status == "ok" and not model.line.axial.elastic:
        model = with_springs(model, jnp.max(jnp.asarray(pose.tension)))
        pose = equilibrium(model, release_loads(model, scene.start), near=pose.state)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    return model, pose


def _ends_of(lines: Sequence[WholeLine]) -> tuple[tuple[str, str], ...]:
    """Line and point of each end of a line, in the order of `_end_links`."""
    ends = []
    for line in lines:
        first, *_, last = line.stops.values()
        ends += [(line.name, first), (line.name, last)]
    return tuple(ends)


def _root_mean_square(amplitudes: np.ndarray) -> np.ndarray:
    """Of sums of components with complex amplitudes (states, c, ...)."""
    return np.sqrt(0.5 * np.sum(np.abs(amplitudes) ** 2, axis=1))


#: Time [s] before the evaluated part of a run, and its minimum in peak periods: the transients of the start decay.
SETTLING_TIME = 100.0
SETTLING_PERIODS = 10.0
#: Ramp of the waves [s] of a scene without its own.
DEFAULT_RAMP = 15.0


def run_in_time(
    scene: SceneLike,
    sea_state: tuple[float, float],
    *,
    direction: float | None = None,
    frequencies: int = 40,
) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations (ends,) [N] of the tensions of `frequency_response` in a run with the same waves.

    One period of the differences of the evenly spaced components is evaluated: its variance has no sampling error. A
    trend is removed.

    Args:
        sea_state: significant height [m] and peak period [s].
        direction, frequencies: see `frequency_response`.

    Raises:
        SceneError: see `frequency_response`.
        SimulationError: the run does not reach its end.
    """
    from scipy.signal import detrend  # noqa: PLC0415 - half a second that only a run needs

    scene = load_scene(scene)
    sea = _sea_of(scene)
    hs, tp = sea_state
    start = max(SETTLING_TIME, SETTLING_PERIODS * tp)
    waves = replace(_spectrum(sea, direction, frequencies), hs=hs, tp=tp)
    ramp = sea.ramp
    if ramp is None:
        ramp = DEFAULT_RAMP
    scene = replace(scene, sea=replace(sea, waves=waves, ramp=ramp))
    duration = start + frequencies / 3.5 * tp  # the components are between 0.5 and 4 peak frequencies
    solution = simulate(scene.with_equal_steps(), duration=duration, save_every=4, throw=True)
    tension = solution.tension[solution.t_tension > start][:, _end_links(scene)]
    return np.mean(tension, axis=0), np.std(detrend(tension, axis=0), axis=0)


def _sea_of(scene: Scene) -> SeaSpec:
    if scene.sea is None:
        raise SceneError("sea: missing; needed: the depth of the water, and waves")
    return scene.sea


def _end_links(scene: Scene) -> np.ndarray:
    """The first and last link of each line."""
    ends = [(line.links.start, line.links.stop - 1) for line in whole_lines(scene)]
    return np.ravel(ends)


def _waves(
    spec: SeaSpec, sea_states: ArrayLike | None, direction: float | None, frequencies: int
) -> tuple[np.ndarray, Waves]:
    """Height and period of each state, and its waves, with a leading axis of the states."""
    current = None
    if spec.current is not None:
        current = make_current(spec.current)
    if sea_states is None:
        own = None
        if spec.waves is not None:
            own = waves_of(spec, spec.waves, current)
        if own is None or own.size < 2:
            raise SceneError("sea.waves: is not an irregular linear sea. Use sea states, or kind 'spectrum'")
        return np.array([[own.significant_height, own.peak_period]]), jax.tree.map(lambda x: x[None], own)
    states = np.atleast_2d(np.asarray(sea_states, float))
    if states.shape[1] != 2 or not np.all(np.isfinite(states) & (states > 0.0)):
        raise SceneError("sea_states: need rows of a significant height [m] and a peak period [s]; allowed: above 0")
    base = _spectrum(spec, direction, frequencies)
    waves = jax.jit(jax.vmap(lambda x: waves_of(spec, replace(base, hs=x[0], tp=x[1]), current)))(jnp.asarray(states))
    if not np.all(np.isfinite(waves.wave_number)):
        raise SceneError("sea.wave_current: the current stops waves of these states. Use longer waves")
    return states, waves


def _spectrum(spec: SeaSpec, direction: float | None, frequencies: int) -> WaveSpec:
    """The waves of sea states, without their height and period."""
    base = spec.waves or WaveSpec(kind="spectrum")
    if direction is None:
        direction = 0.0 if spec.waves is None else float(np.mean(spec.waves.direction))
    return replace(base, kind="spectrum", frequencies="even", count=frequencies, direction=direction)
