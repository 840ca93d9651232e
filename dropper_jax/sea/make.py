"""From `[sea]` to the arrays of the sea; `waves_on` is pure and differentiable, for gradients in Hs or Tp."""

from __future__ import annotations

import dataclasses
from functools import lru_cache, partial

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.sea.bound_waves import RESTING_DRIFT, bound_waves
from dropper_jax.sea.current import Current, Level, Scalar
from dropper_jax.sea.current_spec import CurrentSpec, LevelSpec
from dropper_jax.sea.dispersion import (
    action_factor,
    effective_current,
    fenton,
    frequency,
    on_current,
    wave_number,
)
from dropper_jax.sea.grid_waves import GridWaves, on_grid
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.spectrum import Components, components
from dropper_jax.sea.steady import GivenWave, SteadyWave, fitting_theory, highest
from dropper_jax.sea.stokes5 import stokes5
from dropper_jax.sea.stream_function import Inaccurate, NotSolved, stream_function
from dropper_jax.sea.water import Sea
from dropper_jax.sea.wave_spec import WaveSpec
from dropper_jax.sea.waves import Waves


def make_sea(spec: SeaSpec, reach: tuple[np.ndarray, float] | None = None) -> Sea:
    """The sea of a scene.

    Args:
        reach: centre (3,) [m] and radius [m] of the region of the line, which an interpolated sea must cover.

    Raises:
        SceneError: a component that the current stops; an interpolated sea of several directions or with a level.
    """
    current = make_current(spec.current) if spec.current else None
    level = Level(**_arrays(spec.level)) if spec.level else None
    return Sea(spec.depth, spec.density, spec.gravity, _make_waves(spec, current, reach), current, level)


def _make_waves(spec: SeaSpec, current: Current | None, reach: tuple[np.ndarray, float] | None) -> Waves | None:
    given = spec.waves
    if given is None:
        return None
    wave = finite_wave(spec, current)
    if wave is not None:
        along = _along(spec, given, current, wave.wave_number)
        return bound_waves(wave, float(given.phase), float(given.direction), along, spec.ramp)
    waves = dataclasses.replace(waves_of(spec, given, current), stretching=spec.stretching, ramp=spec.ramp)
    _refuse_blocked(waves, given.length)
    if spec.interpolation == "grid" and reach is not None and np.any(waves.amplitude):
        return _interpolate_waves(spec, waves, *reach)
    return waves


#: Rounds in which the current that acts on a wave of finite height and its length are found; each leaves about 1 % of
#: the error, and a current that is uniform over depth needs one.
CURRENT_ROUNDS = 12


def finite_wave(spec: SeaSpec, current: Current | None = None) -> SteadyWave | None:
    """The solved wave of a sea; None if linear theory is requested or, with `auto`, is valid.

    If `wave_current` is `doppler` the current that acts on this wave is the mean velocity of the water along it, else
    it is not included.

    Raises:
        SceneError: a wave beyond breaking, or one that cannot be solved.
    """
    given = spec.waves
    if given is None or given.kind != "regular" or given.theory == "linear":
        return None
    if current is None and spec.current is not None:
        current = make_current(spec.current)
    period = given.period
    if period is not None:
        period = float(np.max(period))
    height = float(2.0 * np.max(given.size))
    mean = 0.0
    if spec.wave_current != "none":
        omega = wave_components(given, spec.depth, spec.gravity).omega
        mean = _along(spec, given, current, wave_number(omega, jnp.asarray(spec.depth), spec.gravity))
    wave = None
    for _ in range(CURRENT_ROUNDS):
        condition = GivenWave(height, spec.depth, spec.gravity, period, given.length, mean, given.current_criterion)
        wave = _solve_wave(given.theory, condition, given.order)
        if wave is None:
            break
        before = mean
        mean = _along(spec, given, current, wave.wave_number)
        if abs(mean - before) < RESTING_DRIFT:
            break
    return wave


def main_period(spec: SeaSpec, waves: WaveSpec) -> float:
    """Period [s] of the regular waves of a sea, for every form of input."""
    wave = finite_wave(spec)
    if wave is not None:
        return wave.period
    current = make_current(spec.current) if spec.current else None
    return float(2.0 * np.pi / waves_of(spec, waves, current).omega[0])


def _along(spec: SeaSpec, given: WaveSpec, current: Current | None, k: Scalar) -> float:
    """The current that carries waves of number k [rad/m] along their direction [m/s]; zero without `wave_current`."""
    if current is None or spec.wave_current == "none":
        return 0.0
    depth = jnp.asarray(spec.depth)
    profile = partial(current.along, direction=jnp.atleast_1d(given.direction), depth=depth)
    return float(effective_current(jnp.atleast_1d(k), depth, profile)[0])


@lru_cache(maxsize=32)
def _solve_wave(theory: str, given: GivenWave, order: int | None) -> SteadyWave | None:
    """The wave by the stream function or by Stokes' theory; None if `auto` finds that linear theory is valid."""
    height = given.height
    depth = given.depth
    try:
        wave = stream_function(given, order)
        limit = wave.highest
    except Inaccurate as error:
        raise SceneError(
            f"sea.waves.height: {height:.4g} m is too steep for a wave of {error.length / depth:.3g} depths: {error}; "
            "allowed: a lower wave"
        ) from None
    except NotSolved as error:
        limit = highest(error.length, depth)
        if height < limit:
            reason = "too close to breaking to be solved"
            if error.few:
                reason = (
                    f"too steep for a wave of {error.length / depth:.3g} depths, whose harmonics are not sufficient"
                )
            raise SceneError(
                f"sea.waves.height: {height:.4g} m is {reason}; allowed: up to about {error.reached:.4g} m"
            ) from None
        raise _breaking_error(height, limit, f"; the maximum solved height is {error.reached:.4g} m") from None
    if height > limit:
        raise _breaking_error(height, limit)
    if theory == "auto":
        theory = fitting_theory(height, wave.length, depth)
    if theory == "stream":
        return wave
    if theory == "linear":
        return None
    try:
        return stokes5(given)
    except ValueError as error:
        raise SceneError(f"sea.waves.theory: 'stokes5': {error}; allowed: 'stream'") from None


def make_current(spec: CurrentSpec) -> Current:
    """The current of `[sea.current]`."""
    return Current(**_arrays(spec))


def _arrays(spec: LevelSpec | CurrentSpec) -> Table:
    """The values of a table of the scene, its numbers as arrays."""
    found = {}
    for field in dataclasses.fields(spec):
        value = getattr(spec, field.name)
        if value is not None and not isinstance(value, str):
            value = jnp.asarray(np.asarray(value, float), float)
        found[field.name] = value
    return found


def _breaking_error(height: float, limit: float, rest: str = "") -> SceneError:
    return SceneError(
        f"sea.waves.height: {height:.4g} m is at or above breaking; allowed: below {limit:.4g} m, the highest "
        f"wave of this length (Williams 1981){rest}"
    )


#: Reach of an interpolated sea over that of the line, for stretch and moving ends.
GRID_MARGIN = 1.2


def _interpolate_waves(spec: SeaSpec, waves: Waves, middle: np.ndarray, radius: float) -> GridWaves:
    """The waves on a grid around the line, whose region has this centre (3,) [m] and radius [m]."""
    refusal = "sea.interpolation: 'grid' does not support this sea; allowed: none, or a sea with"
    if waves.direction.ndim:
        raise SceneError(f"{refusal} one direction")
    if spec.stretching == "none":
        raise SceneError(f"{refusal} sea.stretching constant or wheeler")
    if spec.level is not None:  # its depth changes the shapes: 3 m over 15 m, by a third of the rms velocity
        raise SceneError(f"{refusal} no sea.level")
    direction = float(waves.direction)
    along = float(middle[:2] @ [np.cos(direction), np.sin(direction)])
    radius = GRID_MARGIN * radius
    low = np.array([along - radius, min(middle[2] - radius, 0.0)])
    return on_grid(waves, spec.depth, low, np.array([along + radius, 0.0]))


def wave_components(spec: WaveSpec, depth: Scalar, gravity: Scalar) -> Components:
    """Amplitudes, frequencies, phases and directions of `[sea.waves]`; of a given length the frequency in still
    water."""
    if spec.hs is not None and spec.tp is not None:
        return components(
            spec.hs,
            spec.tp,
            spec.direction,
            depth=depth,
            gravity=gravity,
            spectrum=spec.spectrum,
            gamma=spec.gamma,
            count=spec.count,
            frequencies=spec.frequencies,
            spreading=spec.spreading,
            directions=spec.directions,
            seed=spec.seed,
        )
    if spec.length is None:
        period = np.atleast_1d(spec.period).astype(float)
    else:
        period = np.array([2 * np.pi / float(frequency(jnp.asarray(2 * np.pi / spec.length), depth, gravity))])
    every = np.ones(period.size)
    return Components(
        jnp.asarray(np.atleast_1d(spec.size) * every, float),
        jnp.asarray(2 * np.pi / period, float),
        jnp.asarray(np.atleast_1d(spec.phase) * every),
        jnp.asarray(spec.direction, float),
    )


def waves_of(spec: SeaSpec, given: WaveSpec, current: Current | None) -> Waves:
    """Linear waves in the water of a sea, on its current if that changes them; a given length is that on the
    current."""
    if spec.wave_current == "none":
        current = None
    drawn = wave_components(given, spec.depth, spec.gravity)
    if given.length is not None:
        number = 2.0 * np.pi / given.length
        drawn = drawn._replace(omega=drawn.omega + number * _along(spec, given, current, number))
    return waves_on(
        drawn,
        spec.depth,
        spec.gravity,
        current=current,
        conserve_action=spec.wave_current == "action",
        approximate=spec.dispersion == "fenton",
    )


def waves_on(
    drawn: Components,
    depth: Scalar,
    gravity: Scalar = GRAVITY,
    *,
    current: Current | None = None,
    conserve_action: bool = False,
    approximate: bool = False,
    stretching: str = "wheeler",
    ramp: float | None = None,
) -> Waves:
    """Waves of the given components, with their wave numbers; pure, differentiable in every array.

    Args:
        current: shifts the frequencies (Doppler) if given; components stopped by it have NaN wave numbers.
        conserve_action: amplitudes are those in still water and change on the current.
        approximate: Fenton's wave numbers instead of exact ones.
    """
    depth = jnp.asarray(depth)
    gravity = jnp.asarray(gravity)
    direction = jnp.asarray(drawn.direction)
    amplitude = drawn.amplitude
    intrinsic = None
    if current is None and approximate:
        k = fenton(drawn.omega, depth, gravity)
    elif current is None:
        k = wave_number(drawn.omega, depth, gravity)
    else:
        course = jnp.broadcast_to(direction, drawn.omega.shape)
        profile = partial(current.along, direction=course, depth=depth)
        k, intrinsic, effective = on_current(drawn.omega, depth, gravity, profile)
        if conserve_action:
            amplitude = amplitude * action_factor(drawn.omega, k, effective, depth, gravity)
    return Waves(
        amplitude=amplitude,
        omega=drawn.omega,
        wave_number=k,
        phase=drawn.phase,
        direction=direction,
        intrinsic=intrinsic,
        ramp=ramp,
        stretching=stretching,
    )


#: Relative error of a given length that a wave on a current may have.
SAME_LENGTH = 1e-6


def _refuse_blocked(waves: Waves, length: float | None) -> None:
    """Reject waves of which the current stops a component, also those that could only have their `length` [m] if they
    were carried back."""
    if length is not None and waves.intrinsic is not None:
        found = 2.0 * np.pi / float(waves.wave_number[0])
        if not abs(found / length - 1.0) < SAME_LENGTH:
            raise SceneError(
                f"sea.wave_current: the current stops waves of {length:.4g} m. Use a weaker opposing current or longer "
                "waves"
            )
    stopped = np.flatnonzero(~np.isfinite(np.asarray(waves.wave_number)))
    if stopped.size:
        period = 2 * np.pi / float(waves.omega[stopped[0]])
        raise SceneError(
            f"sea.wave_current: the current stops {stopped.size} of {waves.size} wave components, the first of period "
            f"{period:.4g} s. Use a weaker opposing current or longer waves"
        )
