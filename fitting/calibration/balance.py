"""Energy of a measured motion and its dissipation by damping, without any simulation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import toeplitz

from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from dropper_jax.model.slots import Potential
from fitting.parameters.of_scene import DAMPING
from fitting.traces import planar
from fitting.traces.trace import Trace, smooth, smoothers


def balance(model: Model, theta: jax.Array, omega: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Energy [J] of a pose with rates, and the power [W] dissipated by the damping."""
    s = planar.to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    taken = jnp.zeros(())
    for effect in model.without_slot(Potential).effects:
        if effect.name not in DAMPING:
            continue
        force = effect.force(k)
        if force is not None:
            taken = taken - jnp.sum(force * k.v)
        if isinstance(effect, JointFriction) and effect.dry is not None:
            rate = jnp.sum(jnp.abs(effect.relative_rates(k)), axis=1)
            taken = taken + jnp.sum(jnp.broadcast_to(effect.dry, (model.line.links + 1,))[: len(rate)] * rate)
    return model.kinetic_energy(k) + model.potential_energy(k), taken


def smooth_stretch(
    trace: Trace, span: tuple[float, float], reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Equidistant times (k,), smoothed angles and rates (k, n) of a stretch of a trace; None if it is too short."""
    part = trace.between(*span)
    # minimum number of samples of a run
    if len(part.t) < 120:
        return None
    step = part.interval
    t = np.arange(part.t[0], part.t[-1] + 0.5 * step, step)
    return t, *smooth(part.at(t), _width(part, reach), step)


def smoothed_noise(trace: Trace, reach: float, phi: float) -> tuple[float, float]:
    """Standard deviation of smoothed unit noise of memory `phi`, in angles and in rates [1/s]."""
    width = _width(trace, reach)
    memory = toeplitz(phi ** np.arange(width))
    weights = (every[width // 2] for every in smoothers(width, trace.interval))
    return tuple(float(np.sqrt(w @ memory @ w)) for w in weights)


def without_noise(
    model: Model, theta: jax.Array, omega: jax.Array, angle: jax.Array, rate: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """`balance` of a measured pose, minus the mean contribution of noise of these sizes (n,) [rad], [rad/s].

    The mean of a function f of noisy numbers is f + 1/2 sum s_j^2 f_jj; both results are at least quadratic in the
    rates. The second differences use the noise's size as their step, so that |rate| of dry joints is included.
    """
    n = theta.shape[0]
    move = jnp.concatenate([jnp.diag(angle), jnp.zeros((n, n))]), jnp.concatenate([jnp.zeros((n, n)), jnp.diag(rate)])
    at = lambda sign: jax.vmap(  # noqa: E731
        lambda a, w: jnp.stack(balance(model, *planar.close_chain(model, theta + sign * a, omega + sign * w)))
    )(*move)
    plain = jnp.stack(balance(model, *planar.close_chain(model, theta, omega)))
    found = plain - 0.5 * jnp.sum(at(1.0) + at(-1.0) - 2 * plain, axis=0)
    return found[0], found[1]


def _width(trace: Trace, reach: float) -> int:
    """Number of frames that the smoother uses."""
    return 2 * max(2, round(reach / trace.interval)) + 1
