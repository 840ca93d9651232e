"""Warnings about the sea of a scene: waves that break, that repeat or that are short compared with its lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.effects.buoyancy import drag_diameter
from dropper_jax.load.checks_water import BY_MORISON
from dropper_jax.load.surface import line_reach, middle_of_line
from dropper_jax.scene import SceneData, line_slices
from dropper_jax.sea import Current, Sea
from dropper_jax.sea.bound_waves import BoundWaves
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import STOKES_MAX_HEIGHT, STOKES_MAX_LENGTH, highest

#: Fraction of the wave energy used to determine a wavelength; the rest is the tail of a spectrum.
ENERGY_SHARE = 0.95
#: Maximum ratio of significant height to depth of irregular waves, as observed on flat seabeds (about 0.6 of single
#: waves' 0.78).
SHALLOW_HEIGHT = 0.6


def sea_warnings(scene: SceneData, sea: Sea) -> tuple[str, ...]:
    """Warnings about the sea, one line each; `sea` is the result of `make_sea`."""
    spec = scene.sea
    if spec is None:
        return ()
    found = [*_reach(scene, spec.depth), *_check_shelter(scene, spec.current)]
    if sea.waves is not None:
        found += [*_breaking(spec, sea), *_repetition(scene, sea), *_slenderness(scene, sea), *_interpolation(sea)]
    return tuple(found)


def _reach(scene: SceneData, depth: float) -> Iterator[str]:
    """A warning if a line can hang below the seabed because the scene has no seabed effect."""
    middle, radius = line_reach(scene)
    low = middle[2] - radius
    if "seabed" not in scene.effects and low < -depth:
        yield (
            f"sea.depth: the line can reach down to z = {low:.4g} m, but the seabed at {-depth:.4g} m has no contact "
            "force"
        )


def _check_shelter(scene: SceneData, current: Current | None) -> Iterator[str]:
    """A warning for shelter factors if the current comes from another direction, because they do not turn with it."""
    factor = scene.effects.get("morison_drag", {}).get("shelter")
    if factor is None or current is None or not np.ndim(factor):
        return
    each = np.asarray(factor, float)[[line.links.start for line in line_slices(scene)]]
    weakest = int(np.argmin(each))
    kinds = [(line.links, line.total) for line in scene.lines]
    alike = [i for i, kind in enumerate(kinds) if kind == kinds[weakest]]
    strongest = max(alike, key=lambda i: each[i])
    across = (middle_of_line(scene, weakest) - middle_of_line(scene, strongest))[:2]
    size = np.hypot(*across)
    along = across @ [np.cos(current.direction), np.sin(current.direction)]
    # minimum cosine between a current and the direction in which lines shelter each other, about 60 degrees
    if each[strongest] > each[weakest] and size > 0.0 and along <= 0.5 * size:
        yield (
            f"line.shelter: the factors decrease towards {scene.lines[weakest].name!r}, but the current flows at "
            f"{np.degrees(current.direction):.4g} degrees from x; they do not turn with it"
        )


#: Steepest waves before breaking: `H = 0.142 L tanh(kd)` (Miche 1944), 0.89 of the depth in shallow water.
MICHE = 0.142


def _breaking(spec: SeaSpec, sea: Sea) -> Iterator[str]:
    """A warning for waves that are too steep: single ones, or the significant height at the mean energy frequency."""
    if sea.waves.bound:
        yield from _finite(spec.depth, sea.waves)
        return
    amplitude = np.asarray(sea.waves.amplitude, float)
    k = np.asarray(sea.waves.wave_number, float)
    height = 2.0 * amplitude[0]
    number = k[0]
    what = "wave height"
    if amplitude.size > 1:
        energy = _moment(sea, 0)
        height = 4.0 * np.sqrt(0.5 * energy)
        what = "significant wave height"
        mean_frequency = _moment(sea, 1) / max(energy, 1e-300)
        number = k[np.argmin(np.abs(np.asarray(sea.waves.omega) - mean_frequency))]
    share = height / spec.depth
    limit = MICHE * 2 * np.pi / number * np.tanh(number * spec.depth)
    tz = mean_period(sea)
    steepest = steepest_sea(tz, spec.gravity)
    if amplitude.size > 1 and share > SHALLOW_HEIGHT:
        yield f"sea.waves: {what} {height:.4g} m is {share:.2g} of the depth; waves break beyond {SHALLOW_HEIGHT:g}"
    elif height > limit:
        yield f"sea.waves: {what} {height:.4g} m is beyond breaking, 0.142 L tanh(kd) = {limit:.4g} m"
    elif amplitude.size > 1 and height > steepest:
        yield (
            f"sea.waves: {what} {height:.4g} m is above {steepest:.4g} m, the steepest seas of mean period "
            f"{tz:.3g} s (DNV-RP-C205)"
        )


def _moment(sea: Sea, order: int) -> float:
    """Twice the moment m_i [m^2 (rad/s)^i] of the spectrum of the sea's waves."""
    energy = np.asarray(sea.waves.amplitude, float) ** 2
    return np.sum(energy * np.asarray(sea.waves.omega, float) ** order)


def mean_period(sea: Sea) -> float:
    """`Tz = 2 pi sqrt(m0/m2)` [s] of the sea's waves."""
    return 2 * np.pi * np.sqrt(_moment(sea, 0) / max(_moment(sea, 2), 1e-300))


def steepest_sea(tz: float, gravity: float) -> float:
    """Significant height [m] of the steepest seas of a mean period [s] in deep water.

    `2 pi Hs/(g Tz^2)` = 1/10 up to Tz = 6 s, 1/15 from 12 s, linear between (DNV-RP-C205, October 2010).
    """
    return np.interp(tz, [6.0, 12.0], [1.0 / 10.0, 1.0 / 15.0]) * gravity * tz**2 / (2 * np.pi)


#: Fraction of the maximum wave height above which a wave of finite height is reported as close to breaking.
NEARLY_BREAKING = 0.9


def _finite(depth: float, waves: BoundWaves) -> Iterator[str]:
    """A warning for a wave of finite height close to breaking (higher ones are rejected), or outside its theory."""
    height = float(waves.height)
    length = float(waves.shortest)
    limit = highest(length, depth)
    if height > NEARLY_BREAKING * limit:
        yield f"sea.waves: wave height {height:.4g} m is {height / limit:.2g} of the maximum, {limit:.4g} m"
    long = length >= STOKES_MAX_LENGTH * depth
    if waves.theory == "stokes5" and (long or height > STOKES_MAX_HEIGHT * limit):
        why = f"it is {height / limit:.2g} of the maximum height"
        if long:
            why = f"its length is {length / depth:.3g} depths"
        yield (
            f"sea.waves.theory: 'stokes5' is inaccurate for this wave, {why} (at most {STOKES_MAX_LENGTH:g} depths and "
            f"{STOKES_MAX_HEIGHT:g} of the maximum height). Use 'stream'"
        )


def repeat_time(omega: np.ndarray) -> float:
    """Time [s] after which evenly spaced frequencies repeat; infinity if they are not evenly spaced."""
    steps = np.diff(np.sort(omega))
    steps = steps[steps > 1e-9 * np.max(omega)]
    share = steps / np.min(steps, initial=np.inf)
    even = steps.size > 1 and np.max(np.abs(share - np.round(share))) < 1e-6
    if not even:
        return np.inf
    return 2 * np.pi / steps.min()


def _interpolation(sea: Sea) -> Iterator[str]:
    error = getattr(sea.waves, "error", None)
    if error is not None:
        text = (
            "sea.interpolation: the error of the grid is at most {:.1g} of the rms velocity and {:.1g} of the rms "
            "acceleration (measured at 400 positions and times)"
        )
        yield text.format(*map(float, error))


def _repetition(scene: SceneData, sea: Sea) -> Iterator[str]:
    after = repeat_time(np.asarray(sea.waves.omega, float))
    if not sea.waves.bound and after < scene.run.duration:
        yield f"sea.waves: the sea repeats after {after:.4g} s, within the run of {scene.run.duration:g} s"


def _shortest(sea: Sea) -> float:
    """Wavelength [m] such that all but a tail of the wave energy has longer waves."""
    k = np.asarray(sea.waves.wave_number, float)
    longest_first = np.argsort(k)
    energy = np.cumsum(np.broadcast_to(np.asarray(sea.waves.amplitude, float), k.shape)[longest_first] ** 2)
    last = -1
    if energy[-1] > 0.0:
        last = int(np.searchsorted(energy, ENERGY_SHARE * energy[-1]))
    return 2 * np.pi / k[longest_first[last]]


def _slenderness(scene: SceneData, sea: Sea) -> Iterator[str]:
    slender = 0.05  # maximum ratio of diameter to wavelength for Morison's equation (thesis (6.11))
    if not set(BY_MORISON) & set(scene.effects):
        return
    diameter = drag_diameter(scene)
    shortest = _shortest(sea)
    path = "line.0"
    if scene.single_line is None:
        thickest = np.argmax(np.broadcast_to(diameter, scene.line.links))
        path = next(f"line.{line.name}" for line in line_slices(scene) if thickest < line.links.stop)
    sizes = {path: np.max(diameter)}
    if scene.buoys:
        buoy = max(reversed(scene.buoys), key=lambda buoy: buoy.diameter)
        sizes[f"buoy.{buoy.name}"] = buoy.diameter
    for path, size in sizes.items():
        if size > slender * shortest:
            yield (
                f"{path}.diameter: {size / shortest:.3g} of {shortest:.3g} m ({ENERGY_SHARE:.0%} of the wave energy is "
                f"longer); Morison's equation needs at most {slender}"
            )
