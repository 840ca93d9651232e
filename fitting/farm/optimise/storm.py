"""Windows of storms: peaks and their derivatives by the variables, statics included.

A window is a separate run. It starts from equilibrium, and its waves rise over `WINDOW_RAMP` seconds with the phase of
the storm from `begin` on. When it meets the storm's largest waves, its motion no longer depends on the start. Its steps
follow an accuracy.

    dJ/dp_k = (J(m + h dm/dp_k, r_0 + h dr_0/dp_k, T_0 + h dT_0/dp_k) - J(m - ..., ...))/2h

All runs of one derivative take the steps of the first, so that their difference is smooth. Exact derivatives are of no
use here, because they grow by up to e^16 per second while ropes are slack. With the law `SlackTangent`, derivatives of
peaks were wrong by up to ten times where ropes snap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.fields import parameter
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.base.read import DeclaredSection
from dropper_jax.base.read import count as whole_number
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.model_slopes import shift_model
from dropper_jax.sea import Sea
from dropper_jax.stepping.integrate import (
    Progress,
    Trajectory,
    advance_and_save,
    begin,
    empty_trajectory,
    scan_steps,
)
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.march import spare_rows
from fitting.farm.optimise.models import Still, in_waves, leaf_numbers
from fitting.farm.optimise.quantities import Quantity
from fitting.farm.optimise.values import Rest
from fitting.sensitivity.own_steps import find_own_lengths

#: Time [s] in which the waves of a window rise; it is not counted.
WINDOW_RAMP = 10.0
#: Part of a window before a line breaks.
INTACT_PART = 1.0 / 3.0


class WindowRun(NamedTuple):
    """How windows run: duration and longest step [s], accuracy of the steps."""

    duration: float
    interval: float
    accuracy: float


@dataclass(frozen=True)
class Peaks:
    """Peaks of a window.

    Attributes:
        hard, soft: (q,); NaN if the run failed.
        shifted: soft peaks (q,) with the variables shifted (p,), along the same steps; None if the run failed.
    """

    hard: np.ndarray
    soft: np.ndarray
    shifted: Callable[[np.ndarray], np.ndarray] | None

    @property
    def solved(self) -> bool:
        """Whether every step was."""
        return self.shifted is not None


def peaks(
    still: Still,
    rest: Rest,
    sea: Sea,
    quantities: Sequence[Quantity],
    run: WindowRun,
    heights: np.ndarray | None = None,
    after: Still | None = None,
) -> Peaks:
    """Peaks of a window in a sea whose waves rise at its start.

    Args:
        after: the model of the second and last third of the window, without one link, to which the peaks then apply
            (see `broken`); default: `still`.
        heights: approximate peaks (q,), which define the width of soft ones; default: the hard peaks. They are fixed:
            two calls that are compared must use the same.
    """
    quantities = tuple(quantities)
    stills = [still] if after is None else [still, after]
    models = [in_waves(one.model, sea) for one in stills]
    # windows do not record work: every phase has the same kind of state, and so one program
    start = replace(rest.state, work=jnp.zeros(0, models[0].dtype))
    stepper = make_stepper(models[0], track_work=False)
    own = _own_run(stepper, models, start, run)
    none = np.full(len(quantities), np.nan)
    if own is None:
        return Peaks(none, none, None)
    hard = np.asarray(_hard(quantities, models[-1], *own.signals))
    scale = jnp.asarray(hard if heights is None else heights, models[0].dtype)
    soft = np.asarray(_soft(quantities, models[-1], scale, *own.signals))
    numbers = leaf_numbers(models[-1], stills[-1])
    lengths = own.lengths

    def shifted_peaks(shift: np.ndarray) -> np.ndarray:
        shifted = [shift_model(model, list(numbers), list(numbers.values()), jnp.asarray(shift)) for model in models]
        s = replace(
            start,
            r=start.r + jnp.tensordot(shift, rest.dr, axes=1),
            tension=start.tension + jnp.tensordot(shift, rest.dtension, axes=1),
        )
        there = _run_along(stepper, shifted, s, lengths)
        if there is None:
            return none
        return np.asarray(_soft(quantities, shifted[-1], scale, *there.signals))

    return Peaks(hard, soft, shifted_peaks)


def slopes(windows: Sequence[Peaks], sizes: np.ndarray, say: Callable[[int, int], None]) -> list[np.ndarray]:
    """Derivatives of the soft peaks of windows by the variables (q, p), all runs in parallel.

    Args:
        sizes: changes h of the variables (p,); derivatives by those with 0 are 0.
        say: called with the numbers of finished and of all runs.
    """
    shifts = []
    for window in windows:
        for k in np.flatnonzero(sizes):
            shift = np.zeros(len(sizes))
            shift[k] = sizes[k]
            shifts += [(window, shift), (window, -shift)]

    def run_shifted(item: tuple[Peaks, np.ndarray]) -> np.ndarray:
        window, shift = item
        return np.full(len(window.soft), np.nan) if window.shifted is None else window.shifted(shift)

    ends = iter(run_parallel(run_shifted, shifts, lambda done: say(done, len(shifts))))
    found = []
    for window in windows:
        slope = np.zeros((len(window.soft), len(sizes)))
        for k in np.flatnonzero(sizes):
            slope[:, k] = (next(ends) - next(ends)) / (2.0 * sizes[k])
        found.append(slope)
    return found


def check_windows(model: Model) -> None:
    """Reject models whose windows are not those of nodes and ropes alone.

    Raises:
        SceneError: a single line, links that break, friction, bodies, effects with a state.
    """
    if model.geometry.is_path:
        raise SceneError("scene: a single line cannot be designed; allowed: systems of lines that join at points")
    if model.line.failures is not None:
        raise SceneError("scene: links that break cannot be designed. Use cases.states, or a scene without them")
    if model.initial_internal_state() or model.laws or model.constraints:
        what = "friction, bodies or effects with a state"
        raise SceneError(f"scene: {what} cannot be designed. Use a scene without them")


class _Run(NamedTuple):
    """A run of a window: steps of each phase [s]; positions, tensions, and the time that each step counts in peaks."""

    lengths: list[jax.Array]
    signals: tuple[jax.Array, jax.Array, jax.Array]


def _own_run(stepper: Stepper, models: Sequence[Model], s: State, run: WindowRun) -> _Run | None:
    """The run in steps that follow the accuracy; None if a step fails."""
    parts = [1.0] if len(models) == 1 else [INTACT_PART, 1.0 - INTACT_PART]

    def own_lengths(phase: int, s: State) -> jax.Array | None:
        model = models[phase]
        duration = parts[phase] * run.duration
        intervals = max(1, round(duration / run.interval))
        interval, accuracy = (jnp.asarray(x, model.dtype) for x in (duration / intervals, run.accuracy))
        length, number, failed = find_own_lengths(stepper, model, s, interval, jnp.asarray(intervals), accuracy)
        return None if failed else length[: spare_rows(int(number))]

    return _run_phases(stepper, models, s, own_lengths)


def _run_along(stepper: Stepper, models: Sequence[Model], s: State, lengths: list[jax.Array]) -> _Run | None:
    """The run in known steps; None if one fails."""
    return _run_phases(stepper, models, s, lambda phase, _: lengths[phase])


def _run_phases(
    stepper: Stepper, models: Sequence[Model], s: State, lengths_of: Callable[[int, State], jax.Array | None]
) -> _Run | None:
    """The phases of a window in a row, each in the steps that `lengths_of` has for its number and start; None if it has
    none, or a step fails."""
    lengths = []
    rows = []
    for phase, model in enumerate(models):
        length = lengths_of(phase, s)
        if length is None:
            return None
        progress, found = _advance_along(stepper, model, s, length)
        if progress.first_bad >= 0:
            return None
        lengths.append(length)
        rows.append(found)
        s = progress.state
    return _Run(lengths, _signals(lengths, rows))


@cached_jit(static=("stepper",), kernel=True)
def _advance_along(stepper: Stepper, model: Model, s: State, length: jax.Array) -> tuple[Progress, Trajectory]:
    """The run in steps of these lengths (most,) [s], 0 after the last one; a row for each."""

    def take(progress: Progress, i: jax.Array) -> tuple[Progress, Trajectory]:
        before = jnp.where(i > 0, length[i - 1], 0.0)
        return advance_and_save(stepper, model, progress, length[i][None], 1, before=before[None])

    first = begin(stepper, model, s)
    return scan_steps(take, first, jnp.sum(length > 0.0), empty_trajectory(first, len(length)))


def _signals(lengths: list[jax.Array], rows: list[Trajectory]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Positions (k, nodes, 3), tensions (k, n) and counted time (k,) of the phases in a row: none in the phase before a
    line breaks, or while waves rise."""
    last = lengths[-1]
    if len(lengths) > 1:
        time = jnp.concatenate([jnp.zeros_like(lengths[0]), last])
    else:
        time = jnp.where(jnp.cumsum(last) > WINDOW_RAMP, last, 0.0)
    r = jnp.concatenate([row.r for row in rows])
    tension = jnp.concatenate([row.tension for row in rows])
    return r, tension, time


@cached_jit(static=("quantities",))
def _hard(
    quantities: tuple[Quantity, ...], model: Model, r: jax.Array, tension: jax.Array, time: jax.Array
) -> jax.Array:
    """Hard peaks (q,)."""
    highest = highest_signals(quantities, model, r, tension, time)
    return jnp.stack([jnp.max(jnp.where(time > 0.0, x, -jnp.inf)) for x in highest])


@cached_jit(static=("quantities",))
def _soft(
    quantities: tuple[Quantity, ...],
    model: Model,
    heights: jax.Array,
    r: jax.Array,
    tension: jax.Array,
    time: jax.Array,
) -> jax.Array:
    return jnp.stack([q.soft(model, r, tension, time, heights[i]) for i, q in enumerate(quantities)])


def highest_signals(
    quantities: tuple[Quantity, ...], model: Model, r: jax.Array, tension: jax.Array, time: jax.Array
) -> list[jax.Array]:
    """The largest value of each quantity at every time (q lists of k)."""
    return [jnp.max(q.signal(model, r, tension, time), axis=1) for q in quantities]


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
