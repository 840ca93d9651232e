"""Windows of storms: peaks and their derivatives by the variables, statics included.

A window is a separate run. It starts from equilibrium, and its waves rise over `WINDOW_RAMP` seconds with the phase of
the storm from `begin` on. When it meets the storm's largest waves, its motion no longer depends on the start.

    dJ/dp = J_p + sum over leaves m of J_m dm/dp + J_r dr_0/dp + J_T dT_0/dp
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Check, raises_first
from dropper_jax.base.fields import parameter
from dropper_jax.base.read import DeclaredSection
from dropper_jax.base.read import count as whole_number
from dropper_jax.model import Model
from dropper_jax.residual import Stepper
from dropper_jax.run.model_slopes import shift_model
from dropper_jax.sea import Sea
from dropper_jax.stepping.adjoint import Record, backward_pass, check_recordable, record
from dropper_jax.stepping.stepper import make_stepper
from fitting.farm.optimise.models import Still, in_waves, leaf_numbers
from fitting.farm.optimise.quantities import Quantity
from fitting.farm.optimise.values import Rest

#: Time [s] in which the waves of a window rise; it is not counted.
WINDOW_RAMP = 10.0
#: Maximum number of corrections of a step: windows take no shorter steps, and a step in which ropes go slack may need
#: three times as many as in a run.
WINDOW_ITERATIONS = 72
#: Times that a window with a step that does not converge is repeated with half the step. Of 96 windows in the design of
#: the packaged longline 70 need at least one, 44 two and 7 three of a step of 0.05 s.
WINDOW_HALVINGS = 3

_record = cached_jit(static=("stepper", "steps"), kernel=True)(record)
_backward_pass = cached_jit(static=("stepper", "moving"), kernel=True)(backward_pass)


@dataclass(frozen=True)
class Peaks:
    """Peaks of a window.

    Attributes:
        hard, soft: (q,); NaN if the run failed.
        slope: derivative of the soft ones by the variables (q, p); (q, 0) if it was not asked for.
        solved: whether every step was.
    """

    hard: np.ndarray
    soft: np.ndarray
    slope: np.ndarray
    solved: bool


def storm_stepper(model: Model) -> Stepper:
    """The stepper of windows: energy-momentum, without halved steps.

    Raises:
        SceneError: a scene without a backward pass.
    """
    stepper = make_stepper(model, halvings=0, iterations=WINDOW_ITERATIONS, track_work=False)
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
    for halving in range(WINDOW_HALVINGS + 1):
        h = dt / 2**halving
        steps = int(round(duration / h / len(stills)))
        # windows do not record work: every phase has the same kind of state, and so one program
        runs = []
        s = replace(rest.state, work=jnp.zeros(0, models[0].dtype))
        for model in models:
            runs.append(_record(stepper, model, s, jnp.asarray(h, model.dtype), steps=steps))
            s = runs[-1].last
        if all(float(run.residual) <= stepper.limit(model) for run, model in zip(runs, models, strict=True)):
            numbers = None
            if slopes:
                numbers = leaf_numbers(models[-1], stills[-1])
            return _peaks(stepper, models, runs, numbers, rest, tuple(quantities), h, heights)
    none = np.full(len(quantities), np.nan)
    return Peaks(none, none, np.full((len(quantities), len(rest.dr) if slopes else 0), np.nan), False)


def _peaks(
    stepper: Stepper,
    models: list[Model],
    runs: list[Record],
    numbers: dict[int, np.ndarray] | None,
    rest: Rest,
    quantities: tuple[Quantity, ...],
    h: float,
    heights: np.ndarray | None,
) -> Peaks:
    """Peaks of the runs of a window's phases, with slopes if those of the leaves (`numbers`) are given."""
    model = models[-1]
    steps = len(runs[0].tension)
    # steps that are not counted: the first third of a window in which a line breaks, or those of the ramp
    if len(runs) > 1:
        first = steps
    else:
        first = max(0, min(round(WINDOW_RAMP / h), steps - 1))
    r = jnp.concatenate([run.r for run in runs])[first:]
    tension = jnp.concatenate([run.tension for run in runs])[first:]
    hard = np.asarray(_hard(quantities, model, r, tension))
    sizes = jnp.asarray(hard if heights is None else heights, model.dtype)
    if numbers is None:
        soft = np.asarray(_soft(quantities, model, sizes, r, tension))
        return Peaks(hard, soft, np.zeros((len(hard), 0)), True)
    table = tuple(numbers)
    leaves = [jnp.asarray(numbers[i]) for i in table]
    soft, by_shift, by_r, by_t = _by_signals(quantities, table, model, leaves, sizes, r, tension)
    ahead = ((first, 0), (0, 0), (0, 0))
    by_r = jnp.pad(by_r, (*ahead, (0, 0)))
    by_t = jnp.pad(by_t, ahead)
    slope = np.array(by_shift)
    end = jax.tree.map(lambda a: jnp.zeros((len(hard), *a.shape), a.dtype), runs[-1].last)
    chain = []
    for model, run in zip(reversed(models), reversed(runs), strict=True):
        begin = len(by_t) - len(run.tension)
        by_leaf, end = _backward_pass(
            stepper, model, table, run, jnp.asarray(h, model.dtype), by_r[begin:], by_t[begin:], end
        )
        by_r = by_r[:begin]
        by_t = by_t[:begin]
        chain += zip(by_leaf, numbers.values(), strict=True)
    for ct, d in (*chain, (end.r, rest.dr), (end.tension, rest.dtension)):
        slope += np.asarray(ct).reshape(len(hard), -1) @ d.reshape(len(d), -1).T
    return Peaks(hard, np.asarray(soft), slope, True)


@cached_jit(static=("quantities",))
def _hard(quantities: tuple[Quantity, ...], model: Model, r: jax.Array, tension: jax.Array) -> jax.Array:
    """Hard peaks (q,)."""
    return jnp.stack([jnp.max(x) for x in highest_signals(quantities, model, r, tension)])


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

    def value(i: int, shift: jax.Array, r: jax.Array, tension: jax.Array) -> jax.Array:
        return quantities[i].soft(shift_model(model, moving, slopes, shift), r, tension, heights[i])

    zero = jnp.zeros(len(slopes[0]), r.dtype)
    found = [jax.value_and_grad(value, argnums=(1, 2, 3))(i, zero, r, tension) for i in range(len(quantities))]
    soft, gradients = zip(*found, strict=True)
    by_shift, by_r, by_t = zip(*gradients, strict=True)
    return jnp.stack(soft), jnp.stack(by_shift), jnp.stack(by_r, axis=1), jnp.stack(by_t, axis=1)


def highest_signals(
    quantities: tuple[Quantity, ...], model: Model, r: jax.Array, tension: jax.Array
) -> list[jax.Array]:
    """The largest value of each quantity at every time (q lists of k)."""
    return [jnp.max(q.signal(model, r, tension), axis=1) for q in quantities]


@dataclass(frozen=True)
class Settings(DeclaredSection):
    """Values of `[optimise]`, settings of the search for a design.

    window = 60.0           [s] of each storm with derivatives; `before` = 45.0 of it before the peak load
    renew = 3               steps after which windows and factors are updated from whole runs
    rounds = 8              maximum number of such rounds; the search ends if a round gains less than `enough` = 0.003
    reach = 0.15            fraction of its range that a variable may move in the first step
    margin = 0.01           distance of constraints from their limits
    """

    window: float = parameter("length of a window", unit="s", low=0.0, open_low=True, default=60.0)
    before: float = parameter("part of it before the peak load", unit="s", low=0.0, default=45.0)
    renew: int = whole_number("steps until windows are updated", default=3)
    rounds: int = whole_number("most rounds", default=8)
    enough: float = parameter("minimum relative gain of a round", unit="-", low=0.0, default=0.003)
    reach: float = parameter("first reach of a step", unit="-", low=0.0, open_low=True, high=1.0, default=0.15)
    margin: float = parameter("below the limits", unit="-", low=0.0, high=0.5, default=0.01)

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        yield (
            not WINDOW_RAMP < self.before <= self.window,
            f"{path}.before: {self.before:g} s; allowed: more than the {WINDOW_RAMP:g} s in which waves rise, up to "
            f"the window of {self.window:g} s",
        )
