"""Poses at rest, fitted with the motion: where the line hangs before it is moved and after it has come to rest.

A span of rest has the mean angles a of N frames. The static pose theta(p) of the model, as the camera sees it, has to
be theirs:

    1/2 (theta(p) - a)' W (theta(p) - a),      W^-1 = sigma^2/N + N K^-1 F K^-1 N'

It tells lengths, masses, the place of ends, the camera and the markers, free of damping and of time. Where joints have
dry friction the line rests anywhere in a band: with K the stiffness of the pose along the closed directions N, and
torques that are uniform up to the friction, F is their covariance, dry^2/3 of each joint. The band is that of the
parameters where the noise was estimated last. Noise that remembers (AR(1), phi) leaves (1 - phi)/(1 + phi) of the
frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax import statics
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Prior
from fitting.estimate.simulator import Simulator
from fitting.parameters.parameter import apply
from fitting.parameters.seeing import camera_angles
from fitting.traces import planar
from fitting.traces.trace import Trace

#: Fewest frames of a rest; into how many parts it is cut, and how far their means may be apart, in parts of the noise
#: and [rad]: noise that remembers moves them too.
FEWEST, PARTS, MOVES, LEAST = 10, 5, 8.0, 0.03
#: Deviations beyond which a frame pulls no more than one there.
HUBER = 2.0


@dataclass(frozen=True)
class Rest:
    """Mean angles of spans at rest.

    Attributes:
        theta: means (R, n) [rad].
        deviation: of one frame, as the traces claim (R, n) [rad].
        frames: how many (R, n).
        interval: between frames (R,) [s].
        run: of each (R,).
        precision: W (R, n, n).
    """

    theta: np.ndarray
    deviation: np.ndarray
    frames: np.ndarray
    interval: np.ndarray
    run: np.ndarray
    precision: np.ndarray

    def with_noise(self, noise: Noise | None, simulator: Simulator, values: np.ndarray) -> Rest:
        """The same by the noise that a fit told, and the band of friction at these parameter values."""
        size = self.deviation / np.sqrt(self.frames)
        if noise is not None:
            phi = np.exp(-noise.decay[self.run] * self.interval[:, None])
            size = size * noise.factor[self.run] * np.sqrt((1 + phi) / (1 - phi))
        band = _band(simulator.model_at(values))
        return replace(self, precision=np.linalg.inv(np.eye(size.shape[1]) * size[:, None] ** 2 + band))

    def prior(self, simulator: Simulator, values: np.ndarray) -> Prior:
        """What the rest adds to cost, gradient (k,) and curvature (k, k)."""
        pose, slope = static_pose(simulator, values)
        off = (pose - self.theta + np.pi) % (2 * np.pi) - np.pi
        weighted = np.einsum("rij,rj->ri", self.precision, off)
        whole = self.precision.sum(axis=0)
        return Prior(0.5 * float(np.sum(off * weighted)), slope.T @ weighted.sum(axis=0), slope.T @ whole @ slope)


def static_pose(simulator: Simulator, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) of the line at rest as the camera sees them, and their derivatives (n, k)."""
    model, parameters = simulator.model, simulator.compiled
    store = simulator.others
    if "near" not in store:
        found = statics.equilibrium(model)
        if found.status != "ok":
            raise SceneError(f"rest: the scene has no pose at rest: {found.message}; allowed: a line that hangs")
        store["near"] = found.state

        def angles(p: jax.Array) -> jax.Array:
            changed = apply(model, parameters, p)
            s = statics.settle(changed, store["near"])
            theta, _ = planar.from_nodes(changed, s.r, jnp.zeros_like(s.r))
            return camera_angles(changed, parameters, p, theta)

        store["pose"] = jax.jit(lambda p: (angles(p), jax.jacfwd(angles)(p)))
    whole, where = simulator.all_values(values)
    pose, slope = store["pose"](whole)
    return np.asarray(pose), np.asarray(slope)[:, where]


def _band(model: Model) -> np.ndarray | float:
    """Covariance (n, n) of the angles at rest by dry friction in the joints; 0 where there is none."""
    friction = next((e for e in model.effects if isinstance(e, JointFriction) and e.dry is not None), None)
    if friction is None or not np.any(np.asarray(friction.dry) > 0):
        return 0.0
    found = statics.equilibrium(model)
    theta = np.asarray(planar.from_nodes(model, found.state.r, jnp.zeros_like(found.state.r))[0])
    basis = planar.chart(model, theta[None])[0]

    def energy(z: jax.Array) -> jax.Array:
        still = jnp.zeros(len(theta))
        s = planar.to_state(model, planar.close_chain(model, theta + basis @ z, still)[0], still)
        return model.potential_energy(model.instant(s.r, s.v, s.t, model.ends(s.t)))

    stiffness = np.asarray(jax.hessian(energy)(jnp.zeros(basis.shape[1])))
    joints = model.line.links + (1 if model.end_held else 0)
    turns = np.eye(joints, len(theta)) - np.eye(joints, len(theta), -1)  # each joint between two links
    torque = np.broadcast_to(np.asarray(friction.dry), (model.line.links + 1,))[:joints]
    give = basis @ np.linalg.solve(stiffness, basis.T @ turns.T)
    return (give * torque**2 / 3) @ give.T


def rests(traces: Sequence[Trace], sigma: Sequence[np.ndarray], spans: Sequence[tuple[float, float]]) -> Rest | None:
    """The spans [s] of the traces at rest; None without any.

    Raises:
        SceneError: a span in which the line moves, or one of too few frames.
    """
    rows = []
    for low, high in spans:
        for run, trace in enumerate(traces):
            part = trace.between(low, high)
            if not len(part.t):
                continue
            text = f"rest: {low:g}:{high:g} of {trace.name}"
            known = np.isfinite(part.theta).sum(axis=0)
            if known.min() < FEWEST:
                raise SceneError(f"{text} has {known.min()} frames; allowed: at least {FEWEST} of every link")
            means = np.array([_location(c[np.isfinite(c)], s) for c, s in zip(part.theta.T, sigma[run], strict=True)])
            parts = np.array([np.nanmedian(x, axis=0) for x in np.array_split(part.theta, PARTS)])
            apart = np.nan_to_num(np.ptp(parts, axis=0))
            if np.any(apart > np.maximum(MOVES * sigma[run], LEAST)):
                raise SceneError(f"{text} moves by {apart.max():.2g} rad; allowed: a span in which the line rests")
            rows.append((means, sigma[run], known, trace.interval, run))
    if not rows:
        return None
    theta, deviation, frames, interval, run = (np.array(column) for column in zip(*rows, strict=True))
    precision = np.eye(theta.shape[1]) * (frames / deviation**2)[:, None]
    return Rest(theta, deviation, frames, interval, run, precision)


def _location(x: np.ndarray, sigma: float) -> float:
    """Huber's estimate of the mean of samples [rad]: a frame that is far off pulls no more than one that is not."""
    at = float(np.median(x))
    for _ in range(20):
        at += float(np.mean(np.clip(x - at, -HUBER * sigma, HUBER * sigma)))
    return at
