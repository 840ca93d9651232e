"""What is known about a rig: `[fit]` of a scene, which a fit to measured traces reads and a simulation ignores.

Free parameters, sensors, and prior knowledge of the rig's values:

    [fit]
    free = ["line.0.inertia", "b_l"]
    model_error = 1e-3          # angles [rad] by which the rig deviates from any model, such as play of its bearings

    [[fit.sensor]]
    channel = "angle"
    resolution = 0.36
    unit = "deg"

    [[fit.prior]]
    of = "line.0.length"        # one standard deviation around the scene's value, independent for each link
    sigma = 0.5
    unit = "mm"

    [[fit.prior]]
    of = "line.0.mass"          # one scale error, common to all of them
    sigma = 0.3
    unit = "%"
    common = true
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from dropper_jax.base.errors import Check, SceneError, nearest
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import DeclaredSection, Plain, Table, as_table, items, part, read_list, refuse

#: Units of `sensor` and `prior`: the SI unit of the quantity, and the unit's size in it; `%` is relative to the scene's
#: value.
FIT_UNITS: dict[str, tuple[str, float]] = {
    "%": ("%", 0.01),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.radians(1.0)),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "m/s^2": ("m/s^2", 1.0),
    "gn": ("m/s^2", 9.80665),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.radians(1.0)),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "px": ("px", 1.0),
    "m/s": ("m/s", 1.0),
    "kg/s": ("kg/s", 1.0),
    "kg/m": ("kg/m", 1.0),
    "kg m^2": ("kg m^2", 1.0),
    "N m": ("N m", 1.0),
    "N m s/rad": ("N m s/rad", 1.0),
}
#: Quantities that a sensor may measure, and their units.
CHANNELS = {
    "angle": "rad",
    "position": "m",
    "pixel": "px",
    "tension": "N",
    "depth": "m",
    "accelerometer": "m/s^2",
    "gyro": "rad/s",
}


def to_si(value: float, unit: str) -> tuple[float, str]:
    """A value in SI (a fraction for `%`) and its unit there."""
    base, factor = FIT_UNITS[unit]
    return value * factor, base


@dataclass(frozen=True)
class SensorSpec(DeclaredSection):
    """`[[fit.sensor]]`: the sensor of a channel; its rounding is the minimum noise that a fit assumes."""

    channel: str = option("measured channel", choices=tuple(CHANNELS))
    resolution: float = parameter("smallest difference that it resolves", unit="-", above=0.0)
    unit: str = option("unit of the resolution", choices=tuple(FIT_UNITS), default="rad")

    def checks(self) -> Iterator[Check]:
        fitting = [name for name, (base, _) in FIT_UNITS.items() if base == CHANNELS[self.channel]]
        yield self.unit not in fitting, f"unit: {self.unit!r} does not measure this; {nearest(self.unit, fitting)}"

    @property
    def in_si_units(self) -> float:
        """The resolution in SI."""
        return to_si(self.resolution, self.unit)[0]


@dataclass(frozen=True)
class PriorSpec(DeclaredSection):
    """`[[fit.prior]]`: how well a number of the scene is known before any trace."""

    of: str = option("path of one or several numbers", type=str)
    sigma: float = parameter("standard deviation around the scene's value", unit="-", above=0.0)
    unit: str = option("unit of sigma", choices=tuple(FIT_UNITS))
    common: bool = option("whether all of them have the same relative error", type=bool, default=False)

    def checks(self) -> Iterator[Check]:
        yield (
            self.common and self.unit != "%",
            f"unit: {self.unit!r} is not a relative unit; allowed: % for a prior that is common to several numbers",
        )

    @property
    def in_si_units(self) -> tuple[float, str]:
        """Sigma in SI (a fraction for `%`), and the unit there."""
        return to_si(self.sigma, self.unit)


def _read_free(value: Plain, path: str) -> tuple[str, ...]:
    """Paths of parameters, each once."""
    free = read_list(value, path, None, "a list of paths of parameters")
    for i, name in enumerate(free):
        if not isinstance(name, str) or not name.strip():
            raise refuse(f"{path}.{i}", name, "is not a text", "a path of a parameter, such as b_l")
        if name in free[:i]:
            raise SceneError(f"{path}.{i}: {name!r} is given twice; allowed: each parameter once")
    return tuple(free)


@dataclass(frozen=True)
class FitSpec(DeclaredSection):
    """`[fit]`: free parameters, sensors and priors, checked except for the paths, which only a fit can check."""

    free: tuple[str, ...] = part(_read_free, default=())
    sensors: tuple[SensorSpec, ...] = part(items(SensorSpec), key="sensor", default=())
    priors: tuple[PriorSpec, ...] = part(items(PriorSpec), key="prior", default=())
    model_error: float = parameter(
        "angle by which the rig deviates from any model; it increases the noise of every sample",
        unit="rad",
        low=0.0,
        high=1.0,
        default=0.0,
    )

    def checks(self) -> Iterator[Check]:
        given = [(prior.of, prior.common) for prior in self.priors]
        for i, prior in enumerate(given):
            yield prior in given[:i], f"prior.{i}.of: {prior[0]!r} is given twice; allowed: each prior once"

    def table(self) -> Table:
        return {key: value for key, value in as_table(self).items() if value}

    def resolution(self, channel: str) -> float:
        """Smallest difference [SI] that the channel's sensor resolves; 0 if the rig does not specify it."""
        return max((sensor.in_si_units for sensor in self.sensors if sensor.channel == channel), default=0.0)
