"""Linear (Airy) waves in finite depth: elevation, velocity, acceleration and dynamic pressure at given positions.

With `p = k (x cos m + y sin m) - w t + e` and s the intrinsic frequency (w without a current), per component

    eta = a cos p,    u = a s C cos p (cos m, sin m),    u_z = a s S sin p,    u' = d/dt at a fixed position
    C = cosh k(z + d)/sinh kd,    S = sinh k(z + d)/sinh kd,    pressure = rho (s^2/k) a C cos p

(thesis (6.4)-(6.9), where (C.30) lacks the minus sign of u'_z and (C.25)-(C.30) lack phase and sum; paper (7)-(13)).
Exponentials are evaluated only of -kd and of k z, so that kd = 95 does not overflow in float32.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.sea.sincos import sincos

#: Extrapolation of kinematics above the mean surface, where linear theory is not defined.
STRETCHING = ("none", "constant", "wheeler")


class Motion(NamedTuple):
    """Water at some positions: elevation (n,) [m], velocity and local acceleration (n, 3) [m/s], [m/s^2]."""

    elevation: jax.Array
    velocity: jax.Array
    acceleration: jax.Array


@component
class Waves:
    """A sum of wave components (c,). Wave numbers and intrinsic frequencies are solved once, when the sea is made."""

    amplitude: jax.Array = parameter("amplitude", unit="m", shape="table", low=0.0)
    omega: jax.Array = parameter("absolute angular frequency", unit="rad/s", shape="table")
    wave_number: jax.Array = parameter("wave number", unit="rad/m", shape="table")
    phase: jax.Array = parameter("phase", unit="rad", shape="table")
    direction: jax.Array = parameter("direction of travel from +x towards +y: one, or one per component", unit="rad")
    intrinsic: jax.Array | None = parameter("intrinsic frequency on a current", unit="rad/s", optional=True)
    ramp: jax.Array | None = parameter("time to reach the full height", unit="s", low=0.0, optional=True)
    stretching: str = option("kinematics above the mean surface", choices=STRETCHING, default="wheeler")

    @property
    def size(self) -> int:
        return self.amplitude.shape[-1]

    @property
    def bound(self) -> bool:
        """Whether the components are harmonics of one wave."""
        return False

    @property
    def speeds(self) -> jax.Array:
        """Factor of the profiles of a component for its velocity (c,) [m/s]: `a s`."""
        return self.amplitude * (self.omega if self.intrinsic is None else self.intrinsic)

    @property
    def shortest(self) -> jax.Array:
        """Length of the shortest waves [m]."""
        return 2.0 * jnp.pi / jnp.max(self.wave_number)

    def rise(self, t: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Ramp factor `sin^2(pi t/(2 ramp))` and its rate [1/s]."""
        if self.ramp is None:
            return jnp.ones((), self.amplitude.dtype), jnp.zeros((), self.amplitude.dtype)
        angle = jnp.pi * jnp.clip(t / self.ramp, 0.0, 1.0)
        return 0.5 * (1.0 - jnp.cos(angle)), 0.5 * jnp.pi / self.ramp * jnp.sin(angle)

    def phases(self, x: jax.Array, y: jax.Array, t: jax.Array) -> jax.Array:
        """p of each component (n, c) [rad] at x, y (n,) [m]."""
        rest = self.phase - self.omega * t
        cos = jnp.cos(self.direction)
        sin = jnp.sin(self.direction)
        if self.direction.ndim == 0:
            return (x * cos + y * sin)[:, None] * self.wave_number + rest
        return x[:, None] * (self.wave_number * cos) + y[:, None] * (self.wave_number * sin) + rest

    def elevation(self, x: jax.Array, y: jax.Array, t: jax.Array) -> jax.Array:
        """Surface elevation (n,) [m]."""
        return self.rise(t)[0] * jnp.sum(self.amplitude * sincos(self.phases(x, y, t))[1], axis=-1)

    def heights(self, z: jax.Array, elevation: jax.Array, depth: jax.Array) -> jax.Array:
        """Height at which the kinematics of z are evaluated (n,) [m]: z, z limited to the mean surface, or Wheeler's
        z'.

        Wheeler (1970): `z' = d (z - eta)/(d + eta)`. Velocity and local acceleration are mapped separately, so one is
        not the time derivative of the other. Heights are limited to the range from seabed to surface.
        """
        if self.stretching == "wheeler":
            z = depth * (z - elevation) / (depth + elevation)
        if self.stretching != "none":
            z = jnp.minimum(z, 0.0)
        return jnp.maximum(z, -depth)

    def profiles(self, z: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
        """C and S of each component at heights z (n,): (n, c) each."""
        k = self.wave_number
        up = jnp.exp(k * z[:, None])
        down = jnp.exp(-k * (z[:, None] + 2.0 * depth))
        scale = -1.0 / jnp.expm1(-2.0 * k * depth)
        return (up + down) * scale, (up - down) * scale

    def motion(self, r: jax.Array, t: jax.Array, depth: jax.Array) -> Motion:
        """The water at positions r (n, 3) [m], all components in one pass."""
        sin, cos = sincos(self.phases(r[:, 0], r[:, 1], t))
        rise, rate = self.rise(t)
        elevation = rise * jnp.sum(self.amplitude * cos, axis=-1)
        velocity, acceleration = self._orbit(self.heights(r[:, 2], elevation, depth), cos, sin, depth)
        return Motion(elevation, rise * velocity, rise * acceleration + rate * velocity)

    def _orbit(self, z: jax.Array, cos: jax.Array, sin: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Velocity and local acceleration (n, 3) at heights z, without the ramp."""
        across, upright = self.profiles(z, depth)
        speed = self.speeds
        along = self.omega * speed
        return self._vector(across * cos, speed, upright * sin), self._vector(across * sin, along, -upright * cos)

    def _vector(self, level: jax.Array, size: jax.Array, rising: jax.Array) -> jax.Array:
        """Sum over the components of level and vertical parts (n, c) times size (c,), as (n, 3)."""
        vertical = jnp.sum(rising * size, axis=-1)
        cos = jnp.cos(self.direction)
        sin = jnp.sin(self.direction)
        if self.direction.ndim == 0:
            total = jnp.sum(level * size, axis=-1)
            return jnp.stack([total * cos, total * sin, vertical], axis=-1)
        return jnp.stack(
            [jnp.sum(level * (size * cos), axis=-1), jnp.sum(level * (size * sin), axis=-1), vertical], axis=-1
        )

    def airy_velocity(self, r: jax.Array, t: jax.Array, depth: jax.Array) -> jax.Array:
        """Velocity (n, 3) [m/s] at positions r with mapped heights, for gradients."""
        sin, cos = sincos(self.phases(r[:, 0], r[:, 1], t))
        return self.rise(t)[0] * self._orbit(r[:, 2], cos, sin, depth)[0]

    def excursion(
        self, position: jax.Array, t: jax.Array, depth: jax.Array, heave: jax.Array, surge: jax.Array
    ) -> jax.Array:
        """Displacement (3,) [m] of a particle at the mean surface, its parts times `heave` and `surge`."""
        phases = self.phases(position[:1], position[1:2], t)[0]
        across = self.speeds / (self.omega * jnp.tanh(self.wave_number * depth)) * surge * -jnp.sin(phases)
        cos = jnp.cos(self.direction)
        sin = jnp.sin(self.direction)
        up = self.amplitude * heave * jnp.cos(phases)
        return self.rise(t)[0] * jnp.stack([jnp.sum(across * cos), jnp.sum(across * sin), jnp.sum(up)])

    def pressure(self, r: jax.Array, t: jax.Array, depth: jax.Array, density: jax.Array) -> jax.Array:
        """Dynamic pressure (n,) [Pa]; zero mean, without the hydrostatic part."""
        phases = self.phases(r[:, 0], r[:, 1], t)
        elevation = self.elevation(r[:, 0], r[:, 1], t)
        across, _ = self.profiles(self.heights(r[:, 2], elevation, depth), depth)
        s = self.omega if self.intrinsic is None else self.intrinsic
        size = density * self.amplitude * s**2 / self.wave_number
        return self.rise(t)[0] * jnp.sum(across * jnp.cos(phases) * size, axis=-1)

    @property
    def significant_height(self) -> jax.Array:
        """`Hs = 4 sqrt(m0)` [m]."""
        return 4.0 * jnp.sqrt(0.5 * jnp.sum(self.amplitude**2))


# Readers of component tables, measured elevations and directional spectra, as values of `[sea.waves]`

#: Values of components that a table has in addition to periods or frequencies, and their units.
UNITS = {"amplitude": "m", "phase": "rad", "direction": "rad"}
COLUMNS = "period_s or frequency_hz, amplitude_m, phase_rad and, optionally, direction_rad"


def read_components(file: str | Path, path: str = "file") -> dict[str, Any]:
    """Components from a CSV with a header; periods are preferred to frequencies, since they are rounded less.

    Raises:
        SceneError: missing file, wrong columns, a cell that is not a number, or a period that is not positive.
    """
    names, rows = _read_csv(file, path)
    known = {"period_s", "frequency_hz", *(f"{name}_{unit}" for name, unit in UNITS.items())}
    if set(names) - known or "amplitude_m" not in names or not {"period_s", "frequency_hz"} & set(names):
        raise SceneError(f"{path}: {str(file)!r} has the columns {', '.join(names)}; allowed: {COLUMNS}")
    column = dict(zip(names, rows.T, strict=True))
    key = "period_s" if "period_s" in column else "frequency_hz"
    if np.any(column[key] <= 0):
        worst = int(np.argmin(column[key]))
        raise SceneError(f"{path}: {key} of component {worst + 1} is {column[key][worst]:g}; allowed: > 0")
    column = {"phase_rad": np.zeros(len(rows)), **column}
    values = {name: column[f"{name}_{unit}"] for name, unit in UNITS.items() if f"{name}_{unit}" in column}
    return {**values, "period": column["period_s"] if key == "period_s" else 1.0 / column["frequency_hz"]}


def read_elevation(file: str | Path, path: str = "file") -> dict[str, Any]:
    """Fourier series of an elevation measured at x = y = 0, evenly sampled, columns t_s and elevation_m.

    The mean is left out. The series repeats after its length; between the samples it is band-limited.
    """
    names, rows = _read_csv(file, path)
    if names != ["t_s", "elevation_m"]:
        raise SceneError(f"{path}: {str(file)!r} has the columns {', '.join(names)}; allowed: t_s, elevation_m")
    t, eta = rows.T
    step = np.diff(t)
    if len(t) < 4 or np.any(step <= 0) or np.ptp(step) > 1e-3 * np.mean(step):
        raise SceneError(f"{path}: {str(file)!r} is not evenly sampled over at least 4 times; allowed: a constant step")
    return elevation_components(t, eta)


def elevation_components(t: np.ndarray, eta: np.ndarray) -> dict[str, Any]:
    """Amplitudes, periods and phases (`a cos(p - w t)`) of an evenly sampled elevation (k,) [m] at times (k,) [s]."""
    count = len(t)
    step = (t[-1] - t[0]) / (count - 1)
    line = np.fft.rfft(eta)[1:]
    frequency = np.fft.rfftfreq(count, step)[1:]
    amplitude = 2.0 * np.abs(line) / count
    if count % 2 == 0:
        amplitude[-1] *= 0.5
    phase = -np.angle(line) + 2 * np.pi * frequency * t[0]
    kept = amplitude > 1e-9 * amplitude.max()
    return {"amplitude": amplitude[kept], "period": 1.0 / frequency[kept], "phase": np.mod(phase[kept], 2 * np.pi)}


def from_wavespectra(dataset: Any, seed: int = 0) -> dict[str, Any]:
    """`[sea.waves]` of a wavespectra-style dataset: `efth` [m^2/Hz/degree] over `freq` [Hz] and `dir` [degree].

    `dir` is where waves come from, clockwise from north (their convention); here +x is east and +y north. One component
    per bin, phases from the seed. Only the dataset itself needs xarray (extra `io`). Select one time and site first.
    """
    missing = [name for name in ("efth", "freq", "dir") if name not in dataset]
    if missing:
        raise SceneError(f"dataset: has no {missing[0]!r}; allowed: a wavespectra dataset with efth, freq and dir")
    density = dataset["efth"].squeeze().transpose("freq", "dir")
    if density.ndim != 2:
        raise SceneError(f"dataset.efth: has the dimensions {density.dims}; allowed: freq and dir, of one time")
    frequency = np.asarray(dataset["freq"], float)
    coming = np.asarray(dataset["dir"], float)
    energy = np.asarray(density, float) * np.gradient(frequency)[:, None] * (360.0 / len(coming))
    kept = energy > 1e-9 * energy.max()
    return {
        "kind": "components",
        "amplitude": np.sqrt(2.0 * energy[kept]),
        "period": np.broadcast_to(1.0 / frequency[:, None], energy.shape)[kept],
        "direction": np.broadcast_to(np.deg2rad(270.0 - coming), energy.shape)[kept],
        "phase": np.random.default_rng(seed).uniform(0.0, 2 * np.pi, int(kept.sum())),
    }


def _read_csv(file: str | Path, path: str) -> tuple[list[str], np.ndarray]:
    try:
        with open(file, newline="", encoding="utf-8") as opened:
            lines = [row for row in csv.reader(line for line in opened if not line.startswith("#")) if row]
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise SceneError(f"{path}: cannot read {str(file)!r}: {getattr(error, 'strerror', None) or error}") from None
    if len(lines) < 2:
        raise SceneError(f"{path}: {str(file)!r} has no rows; allowed: a header and one row per component or time")
    names = [name.strip() for name in lines[0]]
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            rows.append([float(cell) for cell in line])
        except ValueError:
            raise SceneError(f"{path}: {str(file)!r} line {number}: {','.join(line)!r} is not all numbers") from None
        if len(line) != len(names) or not np.all(np.isfinite(rows[-1])):
            raise SceneError(f"{path}: {str(file)!r} line {number}: needs {len(names)} finite numbers, as the header")
    return names, np.array(rows)
