"""Parts of a damping law that the traces could not have shown.

Let w_i be the energy that a unit of coefficient i would dissipate in the measured motion (its power over the whole
trace, without any simulation). A part of a law with coefficients c dissipates w . c, the whole law W, the total loss.
That a part dissipates a fraction `DETECTABLE_SHARE` of W is excluded if

    w . c + z sqrt(w' C w) < DETECTABLE_SHARE W,       C: covariance of c given all other parameters of the law

with z = `LIMIT_DEVIATIONS`, at the optimum without bounds. A part that is neither significant nor excluded remains
undecided: its damping of this motion was too weak to be detected.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import ndtri

from dropper_jax.model import Law, Model
from dropper_jax.model.slots import Force
from fitting.estimate.factors import solve_spd
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.parameters.names import DAMPING
from fitting.parameters.parameter import with_parameter_values
from fitting.traces import planar
from fitting.traces.noise import smooth_stretch
from fitting.windows.prepared import Prepared


def _damping_power(model: Model, theta: Array, omega: Array) -> Array:
    """Power [W] that the damping takes from a motion.

    Args:
        theta, omega: angles (n,) [rad] and rates (n,) [rad/s] of the links.
    """
    s = planar.to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    power = jnp.zeros(())
    for effect in model.effects_with(Force):
        if effect.name in DAMPING:
            power = power - jnp.sum(effect.force(k) * k.v)
    for law in model.effects_with(Law):
        if law.name in DAMPING:
            power = power + law.sliding_power(k)
    return power


#: Fraction of the lost energy that must be detectable for a part.
DETECTABLE_SHARE = 0.1
#: Normal quantile of the upper limit of a part's share, that of one end of a 90 % interval.
LIMIT_DEVIATIONS = ndtri(0.95)
#: Half width of the smoother of the measured motion, as a fraction of the shortest link's period.
SMOOTHER_PERIODS = 0.06


def dissipated_per_unit(prepared: Prepared, simulator: Simulator, owner: Sequence[str | None]) -> np.ndarray:
    """Energy dissipated in the measured motions by a unit of every coefficient (k,) [J per unit].

    Args:
        owner: the part of the law that each parameter belongs to; None, with energy 0, if it belongs to none.
    """
    found = np.zeros(len(owner))
    whole = np.array([p.value for p in simulator.parameters])
    others = np.array([part is None for part in owner])

    @jax.jit
    def power(values: Array, theta: Array, omega: Array) -> Array:
        model = with_parameter_values(simulator.model, simulator.parameters, values)
        return jax.vmap(lambda a, w: _damping_power(model, *planar.close_chain(model, a, w)))(theta, omega)

    for run, trace in enumerate(prepared.traces):
        mine = prepared.windows.run == run
        if not mine.any():
            continue
        span = prepared.windows.begin[mine].min(), prepared.windows.ends[mine].max()
        motion = smooth_stretch(trace, span, SMOOTHER_PERIODS * prepared.period)
        if motion is None:
            continue
        t, theta, omega = motion
        for i in np.flatnonzero(~others):
            values = np.where(others, whole, np.arange(len(owner)) == i)
            found[i] += np.mean(power(jnp.asarray(values), theta, omega)) * t[-1] - t[0]
    return found


def undetected_parts(law: Solution, owner: Sequence[str | None], per_unit: np.ndarray) -> tuple[str, ...]:
    """Parts of a law for which the traces do not exclude that they dissipate `DETECTABLE_SHARE` of the energy.

    Args:
        owner: the part of the law that each parameter belongs to; None if it belongs to none.
        per_unit: energy dissipated by a unit of each coefficient (k,) [J per unit].
    """
    free = np.flatnonzero(~law.problem.held_mask)
    if not len(free) or not per_unit.any():
        return ()
    prior = law.problem.prior(law.values).curvature
    memory = law.problem.memory
    information = ((law.information - prior) / memory + prior)[np.ix_(free, free)]
    covariance = solve_spd(information, np.eye(len(free)))
    centre = law.values[free] - covariance @ law.gradient[free] / memory
    lost = per_unit @ law.values
    owners = np.array(owner, object)[free]
    found = []
    for part in filter(None, dict.fromkeys(owners)):
        work = np.where(owners == part, per_unit[free], 0.0)
        highest = work @ centre + LIMIT_DEVIATIONS * np.sqrt(work @ covariance @ work)
        if highest >= DETECTABLE_SHARE * lost:
            found.append(part)
    return tuple(found)
