"""Consistency of a scene with water, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.effects.buoyancy import displaced_diameter, drag_diameter
from dropper_jax.effects.seabed import Seabed
from dropper_jax.scene import SceneData, line_slices
from dropper_jax.sea import Current, Sea
from dropper_jax.sea.bound_waves import BoundWaves
from dropper_jax.sea.make import make_sea
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import STOKES_MAX_HEIGHT, STOKES_MAX_LENGTH, highest

#: Effects that take the diameter of the lines.
BY_MORISON = ("morison_drag", "morison_inertia", "thesis_wave_force")
NEEDS_WATER = "needs water, but the scene has no [sea]; needed: [sea] with `depth`"
#: Fraction of the wave energy used to determine a wavelength; the rest is the tail of a spectrum.
ENERGY_SHARE = 0.95
#: Maximum ratio of significant height to depth of irregular waves, as observed on flat seabeds (about 0.6 of single
#: waves' 0.78).
SHALLOW_HEIGHT = 0.6
#: Depth below the seabed at which a point may be due to rounding [m].
BELOW_BED = 1e-9


@raises_first
def check_water(effect: str, scene: SceneData) -> Iterator[Check]:
    """Check that an effect of the water has a sea, a diameter, and fixed points above the seabed."""
    sea = scene.sea
    if sea is None:
        raise SceneError(f"effects.{effect}: {NEEDS_WATER}")
    yield (
        effect in BY_MORISON and displaced_diameter(scene.line, scene) is None,
        f"line.0.diameter: missing; effects.{effect} needs it, > 0 m",
    )
    if scene.effects.get("seabed", {}).get("bed_x") is not None:
        return  # a sloping seabed has a different depth everywhere, see `check_bed`
    lowest = -sea.depth
    for i, point in enumerate(scene.points):
        z = point.position[2]
        yield (
            not point.is_free and z < lowest - BELOW_BED,
            f"point.{i}.position: z = {z:g} m is below the seabed; allowed: >= {lowest:g} m",
        )


@raises_first
def check_growth(scene: SceneData) -> Iterator[Check]:
    """Check that growth has water and the diameter of the bare rope, and that the volume follows from the diameter."""
    for i, line in enumerate(scene.lines):
        season = scene.season is not None and scene.season.on(line.name, line.piece_of)
        if line.growth is None and not season:
            continue
        path = f"line.{i}"
        source = f"{path}.growth"
        if season:
            source = "growth"
        yield (
            line.growth is not None and season,
            f"{path}.growth: given, but [growth] lists {line.name!r} too; allowed: one of them",
        )
        yield scene.sea is None, f"{source}: {NEEDS_WATER}"
        yield line.diameter is None, f"{path}.diameter: missing; {source} needs the diameter of the bare rope, > 0 m"
        yield (
            line.outer_diameter is not None,
            f"{path}.outer_diameter: {source} changes the diameter; allowed: one of them",
        )
        yield (
            line.centre_of_mass is not None,
            f"{source}: needs point masses at the nodes, but the line has compound links. Remove it",
        )
        yield (
            scene.effects.get("buoyancy", {}).get("wet_weight") is not None,
            f"effects.buoyancy.wet_weight: is that of the bare line, but {source} changes it. Remove it",
        )


def sea_warnings(scene: SceneData, sea: Sea) -> tuple[str, ...]:
    """Warnings about the sea, one line each; `sea` is the result of `make_sea`."""
    spec = scene.sea
    if spec is None:
        return ()
    found = [*_reach(scene, spec.depth), *_check_shelter(scene, spec.current)]
    if sea.waves is not None:
        found += [*_breaking(spec, sea), *_repetition(scene, sea), *_slenderness(scene, sea), *_interpolation(sea)]
    return tuple(found)


def line_reach(scene: SceneData) -> tuple[np.ndarray, float]:
    """A ball that the line cannot leave while its points are fixed: its centre (3,) [m] and radius [m]."""
    line = scene.single_line
    if line is None:
        positions = np.array([item.position for item in (*scene.points, *scene.bodies, *scene.vessels)])
        middle = np.mean(positions, axis=0)
        longest = max(line.total for line in scene.lines)
        return middle, (np.max(np.linalg.norm(positions - middle, axis=1)) + longest)
    if scene.point(line.end).is_free:
        return scene.point(line.start).position, line.total
    return _middle(scene, 0), 0.5 * line.total


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
    across = (_middle(scene, weakest) - _middle(scene, strongest))[:2]
    size = np.hypot(*across)
    along = across @ [np.cos(current.direction), np.sin(current.direction)]
    # minimum cosine between a current and the direction in which lines shelter each other, about 60 degrees
    if each[strongest] > each[weakest] and size > 0.0 and along <= 0.5 * size:
        yield (
            f"line.shelter: the factors decrease towards {scene.lines[weakest].name!r}, but the current flows at "
            f"{np.degrees(current.direction):.4g} degrees from x; they do not turn with it"
        )


def _middle(scene: SceneData, index: int) -> np.ndarray:
    """The middle (3,) between the ends of a line [m]."""
    line = scene.lines[index]
    return 0.5 * (scene.point(line.start).position + scene.point(line.end).position)


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
        height = 4.0 * np.sqrt(0.5 * np.sum(amplitude**2))
        what = "significant wave height"
        number = k[int(np.argmin(np.abs(np.asarray(sea.waves.omega) - _mean_frequency(sea))))]
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


def mean_period(sea: Sea) -> float:
    """`Tz = 2 pi sqrt(m0/m2)` [s] of the sea's waves."""
    energy = np.asarray(sea.waves.amplitude, float) ** 2
    omega = np.asarray(sea.waves.omega, float)
    return 2 * np.pi * np.sqrt(np.sum(energy) / max(np.sum(energy * omega**2), 1e-300))


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


def _mean_frequency(sea: Sea) -> float:
    energy = np.asarray(sea.waves.amplitude, float) ** 2
    return float(np.sum(energy * np.asarray(sea.waves.omega)) / max(np.sum(energy), 1e-300))


def repeat_time(omega: np.ndarray) -> float:
    """Time [s] after which evenly spaced frequencies repeat; infinity if they are not evenly spaced."""
    steps = np.diff(np.sort(omega))
    steps = steps[steps > 1e-9 * np.max(omega)]
    share = steps / np.min(steps, initial=np.inf)
    even = steps.size > 1 and np.max(np.abs(share - np.round(share))) < 1e-6
    if not even:
        return float("inf")
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


@dataclass(frozen=True)
class Surface:
    """The surface of a scene's water: that of its level and of its waves, or of the level alone."""

    scene: SceneData
    waves: bool = True

    @cached_property
    def _sea(self) -> Sea | None:
        """The water; None where its surface is at z = 0."""
        spec = self.scene.sea
        if spec is None or (spec.level is None and (spec.waves is None or not self.waves)):
            return None
        if not self.waves:
            spec = replace(spec, waves=None)
        return make_sea(spec, line_reach(self.scene))

    @cached_property
    def lowest(self) -> float:
        """A height [m] to which the surface never falls."""
        spec = self.scene.sea
        if spec is None:
            return 0.0
        level = 0.0
        if spec.level is not None:
            level = spec.level.lowest
        if spec.waves is None or not self.waves:
            return level
        # troughs stay above -hs, those of components above the sum of amplitudes; twice, for an opposing current
        size = spec.waves.hs
        if size is None:
            size = np.sum(np.abs(spec.waves.size))
        return level - 2.0 * float(size)

    def over(self, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Height (k, m) [m] over positions (k, m, 3) [m] at times (k,) [s]."""
        if self._sea is None:
            return np.zeros(positions.shape[:2])
        return np.asarray(_elevations(self._sea, positions, times))


@cached_jit()
def _elevations(sea: Sea, positions: ArrayLike, times: ArrayLike) -> Array:
    # one instant after another: a sea of hundreds of components over all nodes and times at once would exceed the
    # memory
    return jax.lax.map(lambda one: sea.elevation(*one), (positions, times))


def surface_over(scene: SceneData, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Height (k, m) [m] of the surface over positions (k, m, 3) [m] at times (k,) [s], that of level and waves."""
    return Surface(scene).over(positions, times)


def bed_height(scene: SceneData, positions: np.ndarray) -> np.ndarray | None:
    """Height z [m] of the seabed, as given, at positions (..., 3) [m]; None for a scene without [effects.seabed]."""
    if "seabed" not in scene.effects:
        return None
    values = scene.effects["seabed"]
    if values["bed_x"] is None:
        depth = values["depth"]
        if depth is None:
            depth = scene.needed_sea.depth
        return np.full(positions.shape[:-1], -float(depth))
    height = Seabed.build(values, scene).bed_height(positions.reshape(-1, 3), rounded=0.0)
    return np.asarray(height).reshape(positions.shape[:-1])
