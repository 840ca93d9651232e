"""Kinematics of many long-crested components from a grid: a few shapes in space, each with its amplitude in time.

Along the direction s of travel and over z the components are smooth, so within the reach of a line their velocities and
elevations are combinations of a few shapes (singular value decomposition on a grid):

    u(s, z, t) = sum_m B_m(s, z) c_m(t),    c(t) = P (cos(e - w t), sin(e - w t)),    u' = sum_m B_m c_m'

Time is exact; space is interpolated by cubics (4 points each way). The error is measured when the grid is made.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, parameter
from dropper_jax.sea.current import Scalar
from dropper_jax.sea.waves import Motion, Waves


@component
class GridWaves(Waves):
    """The same water, from shapes on a grid; gradients go to the nodes, not to the sea's parameters.

    Other values are computed from the components: gradients of the velocity are not interpolated, and fixed points may
    be outside the grid. Free nodes that leave the grid, such as those of a line that breaks and drifts away, have the
    water at its edge.

    Attributes:
        origin, step: of the grid in s and z, (2,) [m].
        shapes: u and w of each shape on the grid, (ns, nz, 2 m).
        surface: elevation of each shape, (ns, m).
        projection: (m, 2 c) from cosines and sines to the shapes' amplitudes.
        error: maximum error of velocity and of acceleration over their rms, (2,), measured at 400 positions and times.
    """

    origin: Array = parameter("first grid point", unit="m", shape="table", default=None)
    step: Array = parameter("grid step", unit="m", shape="table", default=None)
    shapes: Array = parameter("velocities of the shapes", unit="m/s", shape="table", default=None)
    surface: Array = parameter("elevations of the shapes", unit="m", shape="table", default=None)
    projection: Array = parameter("components to shapes", unit="-", shape="table", default=None)
    error: Array = parameter("relative error", unit="-", shape="table", default=None)

    def _amplitudes(self, t: Array) -> tuple[Array, Array]:
        """c(t) and c'(t), (m,) each."""
        angle = self.phase - self.omega * t
        parts = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        rates = jnp.stack([self.omega * parts[1], -self.omega * parts[0]])
        return tuple(jnp.stack([parts.ravel(), rates.ravel()]) @ self.projection.T)

    def _along(self, x: Array, y: Array) -> Array:
        """s at x, y (n,) [m]."""
        cos, sin = self.course
        return x * cos + y * sin

    def _locate(self, x: Array, axis: int, count: int) -> tuple[Array, Array]:
        """First of the 4 grid points around x (n,) and their weights (n, 4); constant outside the grid."""
        cell = jnp.clip((x - self.origin[axis]) / self.step[axis], 1.0, count - 2.0)
        first = jnp.clip(jnp.floor(cell).astype(jnp.int32) - 1, 0, count - 4)
        return first, _cubic(cell - first)

    def _elevation(self, s: Array, c: Array) -> Array:
        """Elevation (n,) [m] at s (n,) of the shapes with amplitudes c (m,), without the ramp."""
        first, weight = self._locate(s, 0, self.surface.shape[0])
        near = (self.surface @ c)[first[:, None] + jnp.arange(4)]
        return jnp.sum(near * weight, axis=1)

    def elevation(self, x: Array, y: Array, t: Array) -> Array:
        """Surface elevation (n,) [m]."""
        return self.rise(t)[0] * self._elevation(self._along(x, y), self._amplitudes(t)[0])

    def _vectors(self, s: Array, z: Array, c: Array) -> Array:
        """Sums over the shapes with amplitudes c (q, m) at s, z (n,): (q, n, 3)."""
        ns, nz, width = self.shapes.shape
        i, wi = self._locate(s, 0, ns)
        j, wj = self._locate(z, 1, nz)

        def cut_patch(i: Array, j: Array) -> Array:
            return jax.lax.dynamic_slice(self.shapes, (i, j, jnp.zeros_like(i)), (4, 4, width))

        patch = jax.vmap(cut_patch)(i, j)
        weight = wi[:, :, None] * wj[:, None, :]
        local = jnp.einsum("nijm,nij->nm", patch, weight).reshape(-1, 2, width // 2)
        level, rising = jnp.einsum("ndm,qm->dqn", local, c)
        cos, sin = self.course
        return jnp.stack([level * cos, level * sin, rising], axis=-1)

    def motion(self, r: Array, t: Array, depth: Scalar) -> Motion:
        """The water at positions r (n, 3) [m]."""
        s = self._along(r[:, 0], r[:, 1])
        c, change = self._amplitudes(t)
        rise, rate = self.rise(t)
        elevation = rise * self._elevation(s, c)
        z = self.heights(r[:, 2], elevation, depth)
        velocity, acceleration = self._vectors(s, z, jnp.stack([c, change]))
        return Motion(elevation, rise * velocity, rise * acceleration + rate * velocity)


def _cubic(a: Array) -> Array:
    """Weights of the points 0, 1, 2, 3 at a (n,), Lagrange: (n, 4)."""
    b = a - 1.0
    c = a - 2.0
    d = a - 3.0
    return jnp.stack([-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0], axis=-1)


#: Grid step times the maximum wave number: the error of cubics is (0.35)^4 3/128 = 3.5e-4 of this component.
GRID_STEP = 0.35
#: Singular values below this fraction of the maximum are left out.
SMALLEST_SHAPE = 2e-5


def on_grid(waves: Waves, depth: float, low: np.ndarray, high: np.ndarray) -> GridWaves:
    """Shapes and grid for long-crested `waves` between `low` and `high` (2,) [m] in s and z; runs once, on the host."""
    highest_crest = 1.5 * float(waves.significant_height)
    bottom = max(low[1] - highest_crest, -depth)  # stretching moves positions under a crest downwards
    lowest = np.array([low[0], bottom])
    count = np.maximum(np.ceil((high - lowest) * float(jnp.max(waves.wave_number)) / GRID_STEP).astype(int), 4) + 4
    step = (high - lowest) / (count - 4)
    origin = lowest - 1.5 * step
    s, z = (origin[i] + step[i] * np.arange(count[i]) for i in (0, 1))
    fields = _component_fields(waves, depth, s, z)
    left, values, right = np.linalg.svd(np.concatenate([fields.real, -fields.imag], axis=1), full_matrices=False)
    rank = int(np.sum(values > SMALLEST_SHAPE * values[0]))
    points = count[0] * count[1]
    velocities = left[: 2 * points, :rank].reshape(2, *count, rank)
    made = GridWaves(
        **vars(waves),
        origin=jnp.asarray(origin),
        step=jnp.asarray(step),
        shapes=jnp.asarray(np.concatenate(velocities, axis=-1)),
        surface=jnp.asarray(left[2 * points :, :rank]),
        projection=jnp.asarray(values[:rank, None] * right[:rank]),
    )
    return replace(made, error=_measure_error(waves, made, depth, low, high))


def _component_fields(waves: Waves, depth: float, s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """u and w of each component over the grid of s and z, then its elevation over s, (2 ns nz + ns, c).

    Complex: a field F has the real part `Re F cos(e - w t) - Im F sin(e - w t)`. Grid points below the seabed have the
    values of the same formulas there, so that cubics next to the seabed are smooth.
    """
    turn = np.exp(1j * np.outer(s, np.asarray(waves.wave_number, float)))
    speed = np.asarray(waves.speeds, float)
    across, upright = (np.asarray(a, float) for a in waves.profiles(jnp.asarray(z), depth))
    level = turn[:, None] * (speed * across)
    rising = -1j * turn[:, None] * (speed * upright)
    surface = turn * np.asarray(waves.amplitude, float)
    return np.concatenate([level.reshape(-1, speed.size), rising.reshape(-1, speed.size), surface])


def _measure_error(exact: Waves, found: GridWaves, depth: float, low: np.ndarray, high: np.ndarray) -> Array:
    """Maximum error of velocity and of acceleration over their rms, (2,), from 20 times at 20 positions."""
    rng = np.random.default_rng(0)
    s, z = np.moveaxis(rng.uniform(low, high, (20, 20, 2)), -1, 0)
    course = float(exact.direction)
    positions = jnp.asarray(np.stack([s * np.cos(course), s * np.sin(course), z], axis=-1))
    times = jnp.asarray(rng.uniform(0.0, 1000.0, 20))
    right = _motions(replace(exact, ramp=None), positions, times, depth)
    wrong = jnp.abs(_motions(replace(found, ramp=None), positions, times, depth) - right)
    return jnp.max(wrong, axis=(1, 2, 3)) / jnp.sqrt(3 * jnp.mean(right**2, axis=(1, 2, 3)))


@jax.jit
def _motions(waves: Waves, positions: Array, times: Array, depth: float) -> Array:
    """Velocities and accelerations (2, q, n, 3) at positions (q, n, 3) and times (q,)."""
    return jnp.stack(jax.vmap(lambda r, t: waves.motion(r, t, depth))(positions, times)[1:])
