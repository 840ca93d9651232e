"""From `[sea]` to the arrays of the sea; `waves_on` is pure and differentiable, for gradients in Hs or Tp."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.sea.current import Current
from dropper_jax.sea.dispersion import action_factor, fenton, on_current, wave_number
from dropper_jax.sea.interpolated import GridWaves, on_grid
from dropper_jax.sea.spec import CurrentSpec, SeaSpec, WaveSpec
from dropper_jax.sea.spectrum import Components, components
from dropper_jax.sea.water import Sea
from dropper_jax.sea.waves import Waves

#: Reach of an interpolated sea over that of the line: room for stretch and moving ends.
MARGIN = 1.2


def make_sea(spec: SeaSpec, reach: tuple[np.ndarray, float] | None = None) -> Sea:
    """The sea of a scene.

    Args:
        reach: middle (3,) [m] and radius [m] of where the line can be: what an interpolated sea must cover.

    Raises:
        SceneError: a component that the current stops; an interpolated sea that is not long-crested.
    """
    current = None if spec.current is None else make_current(spec.current)
    waves = None
    if spec.waves is not None:
        waves = waves_on(
            wave_components(spec.waves, spec.depth, spec.gravity),
            spec.depth,
            spec.gravity,
            current=current if spec.wave_current != "none" else None,
            conserve_action=spec.wave_current == "action",
            approximate=spec.dispersion == "fenton",
            stretching=spec.stretching,
            ramp=spec.ramp,
        )
        _refuse_blocked(waves)
        if spec.interpolation == "grid":
            waves = _interpolated(spec, waves, *reach)
    return Sea(depth=spec.depth, density=spec.density, gravity=spec.gravity, waves=waves, current=current)


def _interpolated(spec: SeaSpec, waves: Waves, middle: np.ndarray, radius: float) -> GridWaves:
    if waves.direction.ndim or spec.stretching == "none":
        what = "one direction" if waves.direction.ndim else "sea.stretching constant or wheeler"
        raise SceneError(f"sea.interpolation: 'grid' cannot serve this sea; allowed: none, or a sea with {what}")
    course = np.array([np.cos(spec.waves.direction), np.sin(spec.waves.direction)])
    along, radius = float(middle[:2] @ course), MARGIN * radius
    low, high = np.array([along - radius, middle[2] - radius]), np.array([along + radius, 0.0])
    return on_grid(waves, spec.depth, low, high)


def wave_components(spec: WaveSpec, depth: jax.Array | float, gravity: jax.Array | float) -> Components:
    """Amplitudes, frequencies, phases and directions of `[sea.waves]`."""
    if spec.kind == "spectrum":
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
        return drawn if spec.spreading is not None else drawn._replace(direction=jnp.asarray(spec.direction))
    period = np.atleast_1d(spec.period).astype(float)
    every = np.ones(period.size)
    return Components(
        jnp.asarray(np.atleast_1d(spec.amplitude) * every),
        jnp.asarray(2 * np.pi / period),
        jnp.asarray(np.atleast_1d(spec.phase) * every),
        jnp.asarray(spec.direction),
    )


def waves_on(
    drawn: Components,
    depth: jax.Array | float,
    gravity: jax.Array | float = 9.81,
    *,
    current: Current | None = None,
    conserve_action: bool = False,
    approximate: bool = False,
    stretching: str = "wheeler",
    ramp: float | None = None,
) -> Waves:
    """Waves of the given components, with their wave numbers; pure, differentiable in every array.

    Args:
        current: shifts the frequencies (Doppler) where given; NaN wave numbers are components that it stops.
        conserve_action: amplitudes are those in still water and change on the current.
        approximate: Fenton's wave numbers instead of exact ones.
    """
    depth, gravity = jnp.asarray(depth), jnp.asarray(gravity)
    amplitude, intrinsic = drawn.amplitude, None
    if current is None:
        k = (fenton if approximate else wave_number)(drawn.omega, depth, gravity)
    else:
        course = jnp.broadcast_to(drawn.direction, drawn.omega.shape)

        def profile(z: jax.Array) -> jax.Array:
            return current.along(z, course, depth)

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


def make_current(spec: CurrentSpec) -> Current:
    """The current of `[sea.current]`."""
    arrays: dict[str, Any] = {
        name: None if getattr(spec, name) is None else jnp.asarray(getattr(spec, name), float)
        for name in ("speed", "direction", "exponent", "reference", "heights", "velocities", "time", "factor")
    }
    return Current(kind=spec.kind, **arrays)


def _refuse_blocked(waves: Waves) -> None:
    stopped = np.flatnonzero(~np.isfinite(np.asarray(waves.wave_number)))
    if stopped.size:
        period = 2 * np.pi / float(waves.omega[stopped[0]])
        raise SceneError(
            f"sea.wave_current: the current stops {stopped.size} of {waves.size} wave components, the first of period "
            f"{period:.4g} s; allowed: a weaker opposing current or longer waves"
        )
