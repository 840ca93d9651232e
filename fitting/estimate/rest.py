"""Poses at rest, fitted with the motion: the line before it is moved and after it has come to rest.

A span of rest has the mean angles a of N frames. The static pose theta(p) of the model, as seen by the camera, has to
match them:

    1/2 (theta(p) - a)' W (theta(p) - a),      W^-1 = sigma^2/N + N K^-1 F K^-1 N'

It determines lengths, masses, the positions of ends, the camera and the markers, independent of damping and of time. If
joints have dry friction the line can rest anywhere in a band. With K the stiffness of the pose along the closed
directions N, and torques distributed uniformly up to the friction, F is their covariance, dry^2/3 of each joint. The
band is that of the parameters at the last noise estimate. Correlated noise (AR(1), phi) reduces the number of frames by
a factor (1 - phi)/(1 + phi).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax import statics
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Prior
from fitting.estimate.simulator import Simulator
from fitting.parameters.paths import count_joints
from fitting.traces import planar
from fitting.traces.noise import column_medians
from fitting.traces.trace import Trace

#: Minimum number of frames of a rest; number of parts it is cut into; maximum difference of their means, in multiples
#: of the noise and [rad]: correlated noise moves them too.
FEWEST_REST_FRAMES = 10
REST_PARTS = 5
MOVE_DEVIATIONS = 8.0
LEAST_MOVE = 0.03
#: Standard deviations beyond which the influence of a frame is constant.
HUBER_DEVIATIONS = 2.0


@dataclass(frozen=True)
class Rest:
    """Mean angles of spans at rest.

    Attributes:
        theta: means (R, n) [rad].
        error: standard deviation of the means by the noise that the traces claim (R, n) [rad].
        interval: between frames (R,) [s].
        run: of each (R,).
        precision: W (R, n, n).
    """

    theta: np.ndarray
    error: np.ndarray
    interval: np.ndarray
    run: np.ndarray
    precision: np.ndarray

    def with_noise(self, noise: Noise | None, simulator: Simulator, values: np.ndarray) -> Rest:
        """The rest with the noise estimated by a fit, and the band of friction at these parameter values."""
        size = self.error
        if noise is not None:
            phi = np.exp(-noise.decay[self.run] * self.interval[:, None])
            size = size * noise.factor[self.run] * np.sqrt((1 + phi) / (1 - phi))
        band = _band(simulator.model_at(values))
        return replace(self, precision=np.linalg.inv(np.eye(size.shape[1]) * size[:, None] ** 2 + band))

    def prior(self, simulator: Simulator, values: np.ndarray) -> Prior:
        """Contribution of the rest to cost, gradient (k,) and curvature (k, k)."""
        pose, slope = static_pose(simulator, values)
        off = planar.wrap(pose - self.theta)
        weighted = np.einsum("rij,rj->ri", self.precision, off)
        curvature = slope.T @ self.precision.sum(axis=0) @ slope
        return Prior(0.5 * np.sum(off * weighted), slope.T @ weighted.sum(axis=0), curvature)


def static_pose(simulator: Simulator, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) of the line at rest as seen by the camera, and their derivatives (n, k)."""
    whole, where = simulator.all_values(values)
    pose, slope = simulator.rest_poses.pose(whole)
    return pose, slope[:, where]


def _band(model: Model) -> np.ndarray | float:
    """Covariance (n, n) of the angles at rest by dry friction in the joints; 0 without friction."""
    friction = next((e for e in model.effects_with(JointFriction) if e.dry is not None), None)
    if friction is None or not np.any(np.asarray(friction.dry) > 0):
        return 0.0
    rest = statics.equilibrium(model).state.r
    theta = np.asarray(planar.from_nodes(model, rest, jnp.zeros_like(rest))[0])
    basis = planar.chart(model, theta[None])[0]
    still = jnp.zeros(len(theta))

    def energy(z: Array) -> Array:
        return planar.energy(model, planar.close_chain(model, theta + basis @ z, still)[0], still)

    stiffness = np.asarray(jax.hessian(energy)(jnp.zeros(basis.shape[1])))
    joints = count_joints(model)
    turns = np.eye(joints, len(theta)) - np.eye(joints, len(theta), -1)  # each joint between two links
    torque = np.broadcast_to(np.asarray(friction.dry), (model.line.links + 1,))[:joints]
    give = basis @ np.linalg.solve(stiffness, basis.T @ turns.T)
    return (give * torque**2 / 3) @ give.T


def rests(traces: Sequence[Trace], sigma: Sequence[np.ndarray], spans: Sequence[tuple[float, float]]) -> Rest:
    """The spans [s] of the traces at rest, each with samples of one of them.

    Raises:
        SceneError: a span in which the line moves, or with too few frames.
    """
    rows = []
    for (low, high), (run, trace) in product(spans, enumerate(traces)):
        part = trace.between(low, high)
        if not len(part.t):
            continue
        text = f"rest: {low:g}:{high:g} of {trace.name}"
        known = np.isfinite(part.theta).sum(axis=0)
        if known.min() < FEWEST_REST_FRAMES:
            raise SceneError(f"{text} has {known.min()} frames; allowed: at least {FEWEST_REST_FRAMES} of every link")
        means = [_location(column, size) for column, size in zip(part.theta.T, sigma[run], strict=True)]
        parts = [column_medians(block) for block in np.array_split(part.theta, REST_PARTS)]
        apart = np.nan_to_num(np.ptp(parts, axis=0))
        if np.any(apart > np.maximum(MOVE_DEVIATIONS * sigma[run], LEAST_MOVE)):
            raise SceneError(f"{text} moves by {apart.max():.2g} rad. Use a span in which the line is at rest")
        rows.append((means, sigma[run] / np.sqrt(known), trace.interval, run))
    theta, error, interval, run = map(np.array, zip(*rows, strict=True))
    return Rest(theta, error, interval, run, np.eye(theta.shape[1]) / error[:, None] ** 2)


def _location(x: np.ndarray, sigma: float) -> float:
    """Huber's estimate of the mean of samples [rad]: the influence of an outlier is limited."""
    at = np.nanmedian(x)
    for _ in range(20):
        at += np.nanmean(np.clip(x - at, -HUBER_DEVIATIONS * sigma, HUBER_DEVIATIONS * sigma))
    return at
