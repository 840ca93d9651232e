"""Parts of a damping law that the traces could not have shown.

Let w_i be the energy that a unit of coefficient i would dissipate in the measured motion (its power over the whole
trace, without any simulation). A part of a law with coefficients c dissipates w . c. A fraction `SHARE` of the total
loss is excluded if

    w . c + z sqrt(w' C w) < SHARE W,       C: covariance of c given all other parameters of the law

at the optimum without bounds. A part that is neither significant nor excluded remains undecided: its damping of this
motion was too weak to be detected.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import ndtri

from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from dropper_jax.model.slots import Force
from fitting.calibration.preparation import Prepared
from fitting.estimate.factors import solve_spd
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator
from fitting.parameters.names import DAMPING
from fitting.parameters.parameter import apply
from fitting.traces import planar
from fitting.traces.noise import smooth_stretch


def dissipation(model: Model, theta: Array, omega: Array) -> Array:
    """Power [W] dissipated by the damping in a pose with rates."""
    s = planar.to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    taken = jnp.zeros(())
    for effect in model.having(Force):
        if effect.name in DAMPING:
            taken = taken - jnp.sum(effect.force(k) * k.v)
        if isinstance(effect, JointFriction) and effect.dry is not None:
            rate = jnp.sum(jnp.abs(effect.relative_rates(k)), axis=1)
            taken = taken + jnp.sum(jnp.broadcast_to(effect.dry, (model.line.links + 1,))[: len(rate)] * rate)
    return taken


#: Fraction of the lost energy that must be detectable for a part, and normal quantile of its upper limit.
SHARE = 0.1
LIMIT = float(ndtri(0.95))


#: Half width of the smoother of the measured motion, as a fraction of the shortest link's period.
SMOOTHER = 0.06


def unit_work(prepared: Prepared, simulator: Simulator, owner: Sequence[str | None]) -> np.ndarray:
    """Energy dissipated in the measured motions by a unit of every coefficient (k,) [J per unit]; otherwise 0."""
    found = np.zeros(len(owner))
    whole = np.array([p.value for p in simulator.parameters])
    others = np.array([part is None for part in owner])

    @jax.jit
    def power(values: Array, theta: Array, omega: Array) -> Array:
        model = apply(simulator.model, simulator.parameters, values)
        return jax.vmap(lambda a, w: dissipation(model, *planar.close_chain(model, a, w)))(theta, omega)

    for run, trace in enumerate(prepared.traces):
        mine = prepared.windows.run == run
        if not mine.any():
            continue
        span = float(prepared.windows.begin[mine].min()), float(prepared.windows.ends[mine].max())
        motion = smooth_stretch(trace, span, SMOOTHER * prepared.period)
        if motion is None:
            continue
        t, theta, omega = motion
        for i in np.flatnonzero(~others):
            values = np.where(others, whole, np.arange(len(owner)) == i)
            found[i] += float(np.mean(power(jnp.asarray(values), theta, omega))) * float(t[-1] - t[0])
    return found


def undetected_parts(law: Solution, owner: Sequence[str | None], per_unit: np.ndarray) -> tuple[str, ...]:
    """Parts of a law for which the traces do not exclude that they dissipate `SHARE` of the energy."""
    free = np.flatnonzero(~law.problem.held_mask)
    if not len(free) or not per_unit.any():
        return ()
    prior = law.problem.prior(law.values).curvature
    memory = law.problem.memory
    information = ((law.information - prior) / memory + prior)[np.ix_(free, free)]
    covariance = solve_spd(information, np.eye(len(free)))
    centre = law.values[free] - covariance @ law.gradient[free] / memory
    lost = float(per_unit @ law.values)
    owners = [owner[i] for i in free]
    found = []
    for part in dict.fromkeys(owners):
        work = np.where([other == part for other in owners], per_unit[free], 0.0)
        highest = float(work @ centre) + LIMIT * np.sqrt(work @ covariance @ work)
        if part is not None and highest >= SHARE * lost:
            found.append(part)
    return tuple(found)
