"""Whether a pose at rest is stable, and the way from one that is not to one that is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dropper_jax.model import Model, State, state
from dropper_jax.statics.rest_problem import force_scale
from dropper_jax.statics.tangent import stiffness_of_motions

#: Free nodes up to which stability is looked at, how negative a stiffness (over the weight of a link per its length)
#: may be for rounding, and the first displacement from an unstable pose, in lengths of a link.
FEW, ROUNDING, NUDGE = 200, 1e-6, 0.1
#: Difference of a stiffness from its transpose, over its largest entry, beyond which it has no energy.
TURNING = 1e-8


def stable(model: Model, s: State) -> bool:
    """Whether no displacement that keeps rigid links' lengths lowers the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (least real part where drag makes it
    unsymmetric: every slow motion returns), against the mean weight of a link per length. A line whose links are all
    in tension under dead loads is stable, and systems of more than `FEW` nodes are not looked at.
    """
    if model.constant_force and np.all(np.asarray(s.tension) > 0.0) or model.free_nodes > FEW:
        return True
    scale = float(force_scale(model, np)) / np.mean(np.asarray(model.line.length))
    return softest(model, s)[0] > -ROUNDING * scale


def softest(model: Model, s: State) -> tuple[float, np.ndarray]:
    """The least stiffness [N/m] of a pose and the displacement (free nodes, 3), largest 1, that meets it."""
    k, motions = stiffness_of_motions(model, s)
    if not k.size:
        return np.inf, np.zeros(s.r.shape)
    values, vectors = np.linalg.eigh(0.5 * (k + k.T))
    if values[0] < 0.0 and np.max(np.abs(k - k.T)) > TURNING * np.max(np.abs(k)):
        # drag turns with the links: what it adds on one way it may take on the way back
        values, vectors = np.linalg.eig(k)
        values, vectors = values.real, vectors.real
    least = int(np.argmin(values))
    way = (motions @ vectors[:, least]).reshape(s.r.shape)
    return float(values[least]), way / np.max(np.abs(way))


def escape(
    model: Model, s: State, residual: float, tolerance: float, find: Callable[[State, float], tuple[State, float]]
) -> tuple[State, float]:
    """From an unstable pose to a stable one next to it, if there is one; else the pose as it is, with its residual.

    A rod may stand upright, a rope laid out along a current drift aside at the least push.

    Args:
        find: the pose, and its residual, that is reached from a start to either side of the softest displacement; it
            is given that one's stiffness [N/m].
    """
    if stable(model, s):
        return s, residual
    stiffness, side = softest(model, s)
    nudge = NUDGE * float(np.mean(np.asarray(model.line.length))) * side
    for start in (s.r + nudge, s.r - nudge):
        found, size = find(state(model, start, tension=s.tension, t=s.t), stiffness)
        if size <= tolerance and stable(model, found):
            return found, size
    return s, residual
