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
from scipy.special import ndtri

from fitting.calibration.balance import balance, smooth_stretch
from fitting.calibration.prepared import Prepared
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.problem import Solution
from fitting.estimate.simulator import Simulator
from fitting.parameters.parameter import apply
from fitting.traces import planar

#: Half width of the smoother of the measured motion, as a fraction of the shortest link's period.
SMOOTH_PART = 0.06
#: Fraction of the lost energy that must be detectable for a part, and normal quantile of its upper limit.
SHARE, LIMIT = 0.1, float(ndtri(0.95))


def unit_work(prepared: Prepared, simulator: Simulator, owner: Sequence[str | None]) -> np.ndarray:
    """Energy dissipated in the measured motions by a unit of every coefficient (k,) [J per unit]; otherwise 0."""
    found = np.zeros(len(owner))
    whole = np.array([p.value for p in simulator.parameters])
    mine = [i for i, part in enumerate(owner) if part is not None]

    @jax.jit
    def power(values: jax.Array, theta: jax.Array, omega: jax.Array) -> jax.Array:
        model = apply(simulator.model, simulator.parameters, values)
        return jax.vmap(lambda a, w: balance(model, *planar.close_chain(model, a, w))[1])(theta, omega)

    for run, trace in enumerate(prepared.traces):
        mine = prepared.windows.run == run
        if not mine.any():
            continue
        span = float(prepared.windows.begin[mine].min()), float(prepared.windows.ends[mine].max())
        motion = smooth_stretch(trace, span, SMOOTH_PART * prepared.period)
        if motion is None:
            continue
        t, theta, omega = motion
        for i in mine:
            values = np.where([part is None for part in owner], whole, 0.0)
            values[i] = 1.0
            found[i] += float(np.mean(power(jnp.asarray(values), theta, omega))) * float(t[-1] - t[0])
    return found


def unseen(law: Solution, owner: Sequence[str | None], per_unit: np.ndarray) -> tuple[str, ...]:
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
    open_parts = []
    for part in dict.fromkeys(owner[i] for i in free):
        if part is None:
            continue
        w = np.where([owner[i] == part for i in free], per_unit[free], 0.0)
        if float(w @ centre) + LIMIT * np.sqrt(w @ covariance @ w) >= SHARE * lost:
            open_parts.append(part)
    return tuple(open_parts)
