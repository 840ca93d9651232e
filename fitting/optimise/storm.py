"""Windows of storms: peaks and their derivatives by the variables, statics included.

A window is a separate run. It starts from equilibrium, and its waves rise over `RAMP` seconds with the phase of the
storm from `begin` on. When it meets the storm's largest waves, its motion no longer depends on the start.

    dJ/dp = J_p + sum over leaves m of J_m dm/dp + J_r dr_0/dp + J_T dT_0/dp
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model
from dropper_jax.sea import Sea
from dropper_jax.stepping.adjoint import Record, backward_pass, check_recordable, record
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.stepper import Stepper
from fitting.optimise.models import Still, in_waves, leaf_numbers
from fitting.optimise.quantities import Quantity
from fitting.optimise.rest import Rest

#: Time [s] in which the waves of a window rise; it is not counted.
RAMP = 10.0
#: Number of times that an unsolved window is repeated with half the step.
HALVINGS = 1

_record = cached_jit(static=("stepper", "steps"))(record)
_backward_pass = cached_jit(static=("stepper", "moving"))(backward_pass)


@dataclasses.dataclass(frozen=True)
class Peaks:
    """Peaks of a window.

    Attributes:
        hard, soft: (q,); NaN if the run failed.
        slope: derivative of the soft ones by the variables (q, p).
        when: time of each hard peak after the window's start (q,) [s].
        solved: whether every step was.
    """

    hard: np.ndarray
    soft: np.ndarray
    slope: np.ndarray | None
    when: np.ndarray
    solved: bool


@dataclasses.dataclass(frozen=True)
class Phase:
    """Consecutive steps of a window on one model, with the data for the backward pass."""

    model: Model
    still: Still
    run: Record


def storm_stepper(model: Model) -> Stepper:
    """The stepper of windows: energy-momentum, without fallbacks for steps that do not converge.

    Raises:
        SceneError: a scene without a backward pass.
    """
    stepper = make_stepper(model, extra=0, halvings=0, track_work=False)
    check_recordable(stepper, model)
    return stepper


def peaks(
    still: Still,
    rest: Rest,
    sea: Sea,
    quantities: Sequence[Quantity],
    dt: float,
    duration: float,
    slopes: bool = True,
    heights: np.ndarray | None = None,
    after: Still | None = None,
) -> Peaks:
    """Peaks of a window of `duration` [s] in a sea whose waves rise at its start.

    Args:
        after: the model of the second and last third of the window, without one link, to which the peaks then apply
            (see `broken`); default: `still`.
        heights: approximate peaks (q,), which define the width of soft ones; default: the hard peaks. They are fixed:
            two calls that are compared must use the same.
    """
    stills = [still] if after is None else [still, after, after]
    models = [in_waves(one.model, sea) for one in stills]
    stepper = storm_stepper(models[0])
    for halving in range(HALVINGS + 1):
        h = dt / 2**halving
        steps = int(round(duration / h / len(stills)))
        # windows do not record work: every phase has the same kind of state, and so one program
        phases, s, solved = [], dataclasses.replace(rest.state, work=jnp.zeros(0, models[0].dtype)), True
        for one, model in zip(stills, models, strict=True):
            run = _record(stepper, model, s, jnp.asarray(h, model.dtype), steps=steps)
            phases.append(Phase(model, one, run))
            s, solved = run.last, solved and float(run.residual) <= stepper.limit(model)
        if solved:
            return _peaks(stepper, phases, rest, tuple(quantities), h, slopes, heights)
    none = np.full(len(quantities), np.nan)
    return Peaks(none, none, np.full((len(quantities), rest.dr.shape[0]), np.nan) if slopes else None, none, False)


def _peaks(
    stepper: Stepper,
    phases: list[Phase],
    rest: Rest,
    quantities: tuple[Quantity, ...],
    h: float,
    slopes: bool,
    heights: np.ndarray | None,
) -> Peaks:
    model, still = phases[-1].model, phases[-1].still
    counted = phases if len(phases) == 1 else phases[1:]
    r, tension = (jnp.concatenate([getattr(p.run, key) for p in counted]) for key in ("r", "tension"))
    before = sum(len(p.run.tension) for p in phases) - len(tension)
    count = max(0, min(int(round(RAMP / h)), len(tension) - 1)) if len(phases) == 1 else 0  # steps in the ramp
    hard, when = (np.asarray(a) for a in _hard(quantities, model, r[count:], tension[count:]))
    when = (when + before + count + 1) * h
    heights = jnp.asarray(hard if heights is None else heights, model.dtype)
    if not slopes:
        soft = np.asarray(_soft(quantities, model, heights, r[count:], tension[count:]))
        return Peaks(hard, soft, None, when, True)
    numbers = leaf_numbers(model, still)
    table = tuple(numbers)
    soft, by_shift, by_r, by_t = _by_signals(
        *(quantities, table, model, [jnp.asarray(numbers[i]) for i in table], heights),
        *(r[count:], tension[count:]),
    )
    ahead = ((before + count, 0), (0, 0), (0, 0))
    by_r, by_t = jnp.pad(by_r, (*ahead, (0, 0))), jnp.pad(by_t, ahead)
    slope, end = np.array(by_shift), None
    for phase in reversed(phases):
        first = len(by_t) - len(phase.run.tension)
        if end is None:
            zero = jax.tree.map(lambda a: jnp.zeros((len(hard), *a.shape), a.dtype), phase.run.last)
        by_leaf, end = _backward_pass(
            *(stepper, phase.model, table, phase.run, jnp.asarray(h, model.dtype), by_r[first:], by_t[first:]),
            zero if end is None else end,
        )
        by_r, by_t = by_r[:first], by_t[:first]
        for i, ct in zip(table, by_leaf, strict=True):
            q = ct.shape[0]
            slope += np.asarray(ct).reshape(q, -1) @ numbers[i].reshape(numbers[i].shape[0], -1).T
    for ct, d in ((end.r, rest.dr), (end.tension, rest.dtension)):
        slope += np.asarray(ct).reshape(len(hard), -1) @ d.reshape(d.shape[0], -1).T
    return Peaks(hard, np.asarray(soft), slope, when, True)


@cached_jit(static=("quantities",))
def _hard(
    quantities: tuple[Quantity, ...], model: Model, r: jax.Array, tension: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Hard peaks (q,), and the indices of their times (q,)."""
    highest = [jnp.max(q.signal(model, r, tension), axis=1) for q in quantities]
    return jnp.stack([jnp.max(x) for x in highest]), jnp.stack([jnp.argmax(x) for x in highest])


@cached_jit(static=("quantities",))
def _soft(
    quantities: tuple[Quantity, ...], model: Model, heights: jax.Array, r: jax.Array, tension: jax.Array
) -> jax.Array:
    return jnp.stack([q.soft(model, r, tension, heights[i]) for i, q in enumerate(quantities)])


@cached_jit(static=("quantities", "moving"))
def _by_signals(
    quantities: tuple[Quantity, ...],
    moving: tuple[int, ...],
    model: Model,
    slopes: list[jax.Array],
    heights: jax.Array,
    r: jax.Array,
    tension: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Soft peaks (q,), and their derivatives by the variables at fixed motion (q, p), by positions (k, q, nodes, 3) and
    by tensions (k, q, n)."""
    count = slopes[0].shape[0]

    def value(i: int, shift: jax.Array, r: jax.Array, tension: jax.Array) -> jax.Array:
        leaves, tree = jax.tree.flatten(model)
        for leaf, slope in zip(moving, slopes, strict=True):
            leaves[leaf] = leaves[leaf] + jnp.tensordot(shift, slope, axes=1)
        return quantities[i].soft(jax.tree.unflatten(tree, leaves), r, tension, heights[i])

    zero = jnp.zeros(count, r.dtype)
    found = [jax.value_and_grad(value, argnums=(1, 2, 3))(i, zero, r, tension) for i in range(len(quantities))]
    soft, gradients = zip(*found, strict=True)
    by_shift, by_r, by_t = zip(*gradients, strict=True)
    return jnp.stack(soft), jnp.stack(by_shift), jnp.stack(by_r, axis=1), jnp.stack(by_t, axis=1)
