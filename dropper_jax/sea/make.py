"""From `[sea]` to the arrays of the sea; `waves_on` is pure and differentiable, for gradients in Hs or Tp."""

from __future__ import annotations

import dataclasses
from functools import lru_cache, partial

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.sea.current import Current, Level, Scalar
from dropper_jax.sea.interpolated import GridWaves, bound_waves, on_grid
from dropper_jax.sea.spec import CurrentSpec, LevelSpec, SeaSpec, WaveSpec
from dropper_jax.sea.spectrum import (
    Components,
    action_factor,
    components,
    effective_current,
    fenton,
    frequency,
    on_current,
    wave_number,
)
from dropper_jax.sea.steady import SteadyWave, fitting_theory, highest, stokes5
from dropper_jax.sea.stream_function import NotSolved, stream_function
from dropper_jax.sea.water import Sea
from dropper_jax.sea.waves import Waves


def make_sea(spec: SeaSpec, reach: tuple[np.ndarray, float] | None = None) -> Sea:
    """The sea of a scene.

    Args:
        reach: centre (3,) [m] and radius [m] of the region of the line, which an interpolated sea must cover.

    Raises:
        SceneError: a component that the current stops; an interpolated sea that is not long-crested.
    """
    current = None
    if spec.current is not None:
        current = make_current(spec.current)
    waves = None
    given = spec.waves
    wave = finite_wave(spec, current)
    if given is not None and wave is not None:
        direction = float(given.direction)
        along = _along(spec, current, direction, wave.wave_number)
        waves = bound_waves(wave, float(given.phase), direction, along, spec.ramp)
    elif given is not None:
        waves = dataclasses.replace(waves_of(spec, given, current), stretching=spec.stretching, ramp=spec.ramp)
        _refuse_blocked(waves)
        if spec.interpolation == "grid" and reach is not None:
            waves = _interpolate_waves(spec, waves, *reach)
    level = None
    if spec.level is not None:
        level = make_level(spec.level)
    return Sea(
        depth=spec.depth,
        density=spec.density,
        gravity=spec.gravity,
        waves=waves,
        current=current,
        level=level,
    )


def finite_wave(spec: SeaSpec, current: Current | None = None) -> SteadyWave | None:
    """The solved wave of a sea; None if linear theory is requested or, with `auto`, is valid.

    If `wave_current` is `doppler` the current is the mean velocity of the water along the wave, else it is not
    included.

    Raises:
        SceneError: a wave beyond breaking, or one that cannot be solved.
    """
    given = spec.waves
    if given is None or given.kind != "regular" or given.theory == "linear":
        return None
    if current is None and spec.current is not None:
        current = make_current(spec.current)
    if spec.wave_current == "doppler":
        mean = _along(spec, current, float(given.direction), _linear_number(spec, given))
    else:
        mean = 0.0
    return _solve_wave(
        given.theory,
        float(2.0 * np.max(given.size)),
        *(None if value is None else float(np.max(value)) for value in (given.period, given.length)),
        given.order,
        given.current_criterion,
        mean,
        spec.depth,
        spec.gravity,
    )


def main_period(spec: SeaSpec, waves: WaveSpec) -> float:
    """Period [s] of the regular waves of a sea, for every form of input."""
    wave = finite_wave(spec)
    omega = wave_components(waves, spec.depth, spec.gravity).omega
    if wave is None:
        return float(2.0 * np.pi / omega[0])
    return wave.period


def _linear_number(spec: SeaSpec, given: WaveSpec) -> float:
    if given.length is not None:
        return 2.0 * np.pi / given.length
    omega = jnp.asarray(2.0 * np.pi / float(np.max(given.period)))
    return float(wave_number(omega, jnp.asarray(spec.depth), spec.gravity))


def _along(spec: SeaSpec, current: Current | None, direction: float, k: float) -> float:
    """The current that carries waves of number k [rad/m] along their direction [m/s]; zero without `wave_current`."""
    if current is None or spec.wave_current != "doppler":
        return 0.0
    course = jnp.asarray([direction])
    depth = jnp.asarray(spec.depth)
    return float(effective_current(jnp.asarray([k]), depth, lambda z: current.along(z, course, depth))[0])


@lru_cache(maxsize=32)
def _solve_wave(
    theory: str,
    height: float,
    period: float | None,
    length: float | None,
    order: int | None,
    criterion: str,
    current: float,
    depth: float,
    gravity: float,
) -> SteadyWave | None:
    size = {"period": period, "length": length, "current": current, "criterion": criterion}
    try:
        wave = stream_function(height, depth, gravity, **size, order=order)
        limit = wave.highest
    except NotSolved as error:
        limit = highest(error.length, depth)
        if error.few and height < limit:
            raise SceneError(
                f"sea.waves.height: {height:.4g} m is too steep for a wave of {error.length / depth:.3g} depths, whose "
                f"harmonics are not sufficient; allowed: up to about {error.reached:.4g} m"
            ) from None
        raise _beyond(height, limit, f"; the maximum solved height is {error.reached:.4g} m") from None
    if height > limit:
        raise _beyond(height, limit)
    if theory == "auto":
        theory = fitting_theory(height, wave.length, depth)
    if theory in ("stream", "linear"):
        if theory == "stream":
            return wave
        return None
    try:
        return stokes5(height, depth, gravity, **size)
    except ValueError as error:
        raise SceneError(f"sea.waves.theory: 'stokes5': {error}; allowed: 'stream'") from None


def make_level(spec: LevelSpec) -> Level:
    """The level of `[sea.level]`."""
    return Level(**_arrays(spec))


def make_current(spec: CurrentSpec) -> Current:
    """The current of `[sea.current]`."""
    return Current(**_arrays(spec))


def _arrays(spec: LevelSpec | CurrentSpec) -> Table:
    values = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    found = {}
    for key, value in values.items():
        found[key] = value if value is None or isinstance(value, str) else jnp.asarray(np.asarray(value, float), float)
    return found


def _beyond(height: float, limit: float, rest: str = "") -> SceneError:
    return SceneError(
        f"sea.waves.height: {height:.4g} m is at or above breaking; allowed: below {limit:.4g} m, the highest "
        f"wave of this length (Williams 1981){rest}"
    )


def _interpolate_waves(spec: SeaSpec, waves: Waves, middle: np.ndarray, radius: float) -> GridWaves:
    if waves.direction.ndim or spec.stretching == "none":
        if waves.direction.ndim:
            what = "one direction"
        else:
            what = "sea.stretching constant or wheeler"
        raise SceneError(f"sea.interpolation: 'grid' does not support this sea; allowed: none, or a sea with {what}")
    direction = float(waves.direction)
    along = float(middle[:2] @ [np.cos(direction), np.sin(direction)])
    radius = 1.2 * radius  # reach of an interpolated sea over that of the line: margin for stretch and moving ends
    low = np.array([along - radius, middle[2] - radius])
    return on_grid(waves, spec.depth, low, np.array([along + radius, 0.0]))


def wave_components(spec: WaveSpec, depth: Scalar, gravity: Scalar) -> Components:
    """Amplitudes, frequencies, phases and directions of `[sea.waves]`."""
    if spec.hs is not None and spec.tp is not None:
        drawn = components(
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
        if spec.spreading is not None:
            return drawn
        return drawn._replace(direction=jnp.asarray(spec.direction))
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
    """Linear waves in the water of a sea, on its current if that changes them."""
    return waves_on(
        wave_components(given, spec.depth, spec.gravity),
        spec.depth,
        spec.gravity,
        current=current if spec.wave_current != "none" else None,
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
    amplitude = drawn.amplitude
    intrinsic = None
    if current is None:
        k = (fenton if approximate else wave_number)(drawn.omega, depth, gravity)
    else:
        course = jnp.broadcast_to(drawn.direction, drawn.omega.shape)
        profile = partial(current.along, direction=course, depth=depth)
        k, intrinsic, effective = on_current(drawn.omega, depth, gravity, profile)
        if conserve_action:
            amplitude = amplitude * action_factor(drawn.omega, k, effective, depth, gravity)
    return Waves(
        amplitude=amplitude,
        omega=drawn.omega,
        wave_number=k,
        phase=drawn.phase,
        direction=jnp.asarray(drawn.direction),
        intrinsic=intrinsic,
        ramp=ramp,
        stretching=stretching,
    )


def _refuse_blocked(waves: Waves) -> None:
    stopped = np.flatnonzero(~np.isfinite(np.asarray(waves.wave_number)))
    if stopped.size:
        period = 2 * np.pi / float(waves.omega[stopped[0]])
        raise SceneError(
            f"sea.wave_current: the current stops {stopped.size} of {waves.size} wave components, the first of period "
            f"{period:.4g} s. Use a weaker opposing current or longer waves"
        )
