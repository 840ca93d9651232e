"""Windows of storms: peaks and their derivatives by the variables, statics included.

A window is a separate run. It starts from equilibrium, and its waves rise over `WINDOW_RAMP` seconds with the phase of
the storm from `begin` on. When it meets the storm's highest waves, its motion no longer depends on the start. Its steps
follow an accuracy.

    dJ/dp_k = (J(m + h dm/dp_k, r_0 + h dr_0/dp_k, T_0 + h dT_0/dp_k) - J(m - ..., ...))/2h

All runs of one derivative take the steps of the first, so that their difference is smooth. Exact derivatives are of no
use here, because they grow by up to e^16 per second while ropes are slack. With the law `SlackTangent`, derivatives of
peaks were wrong by up to ten times where ropes snap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.model import Model, State
from dropper_jax.modelling.model_slopes import shift_model
from dropper_jax.residual import Stepper
from dropper_jax.sea import Sea
from dropper_jax.stepping.equal_steps import advance_and_save
from dropper_jax.stepping.integrate import empty_trajectory, scan_steps
from dropper_jax.stepping.progress import Progress, Trajectory, begin
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.march import spare_rows
from fitting.farm.optimise.calm_model import numbered_slopes, with_waves
from fitting.farm.optimise.quantities import LimitedSignal, Steps
from fitting.farm.optimise.run_starts import RunStart
from fitting.farm.optimise.settings import WINDOW_RAMP
from fitting.sensitivity.study_steps import find_step_lengths

#: Part of a window before a line breaks.
INTACT_PART = 1.0 / 3.0


class WindowSettings(NamedTuple):
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


def run_window(
    start: RunStart,
    sea: Sea,
    quantities: tuple[LimitedSignal, ...],
    run: WindowSettings,
    heights: np.ndarray | None = None,
) -> Peaks:
    """Peaks of a window in a sea whose waves rise at its start.

    Args:
        start: with a later model for the second and last third of the window, without one link, the peaks apply to that
            part (see `broken_link`).
        heights: approximate peaks (q,), which define the width of soft ones; default: the hard peaks. They are fixed:
            two calls that are compared must use the same.
    """
    calm = [start.calm]
    if start.after is not None:
        calm.append(start.after)
    models = [with_waves(one.model, sea) for one in calm]
    rest = start.rest
    # windows do not record work: every phase has the same kind of state, and so one program
    state = replace(rest.state, work=jnp.zeros(0, models[0].dtype))
    stepper = make_stepper(models[0], track_work=False)
    own = _run_phases(stepper, models, state, run)
    none = np.full(len(quantities), np.nan)
    if own is None:
        return Peaks(none, none, None)
    lengths, steps = own
    hard = np.asarray(_hard_peaks(quantities, models[-1], steps))
    if heights is None:
        heights = hard
    scale = jnp.asarray(heights, models[0].dtype)
    soft = np.asarray(_soft_peaks(quantities, models[-1], scale, steps))
    slopes = numbered_slopes(models[-1], calm[-1])

    def shifted_peaks(shift: np.ndarray) -> np.ndarray:
        shifted = [shift_model(model, list(slopes), list(slopes.values()), jnp.asarray(shift)) for model in models]
        s = replace(
            state,
            r=state.r + jnp.tensordot(shift, rest.dr, axes=1),
            tension=state.tension + jnp.tensordot(shift, rest.dtension, axes=1),
        )
        there = _run_phases(stepper, shifted, s, run, lengths)
        if there is None:
            return none
        return np.asarray(_soft_peaks(quantities, shifted[-1], scale, there[1]))

    return Peaks(hard, soft, shifted_peaks)


def differentiate_peaks(
    windows: Sequence[Peaks], sizes: np.ndarray, say: Callable[[int, int], None]
) -> list[np.ndarray]:
    """Derivatives of the soft peaks of windows by the variables (q, p), all runs in parallel.

    Args:
        sizes: changes h of the variables (p,); derivatives by those with 0 are 0.
        say: called with the numbers of finished and of all runs.
    """
    moving = np.flatnonzero(sizes)
    shifts = list(product(windows, np.diag(sizes)[moving], (1.0, -1.0)))

    def run_shifted(item: tuple[Peaks, np.ndarray, float]) -> np.ndarray:
        window, shift, sign = item
        if window.shifted is None:
            return np.full(len(window.soft), np.nan)
        return window.shifted(sign * shift)

    ends = iter(run_parallel(run_shifted, shifts, lambda done: say(done, len(shifts))))
    found = []
    for window in windows:
        slope = np.zeros((len(window.soft), len(sizes)))
        for k in moving:
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
        raise SceneError("scene: friction, bodies or effects with a state cannot be designed. Use a scene without them")


def _run_phases(
    stepper: Stepper, models: Sequence[Model], s: State, run: WindowSettings, given: Sequence[Array] = ()
) -> tuple[list[Array], Steps] | None:
    """The phases of a window in a row: lengths of the steps of each [s], and what they count; None if a step fails.

    Args:
        given: lengths of the steps; by default they follow the accuracy.
    """
    parts = [1.0] if len(models) == 1 else [INTACT_PART, 1.0 - INTACT_PART]
    lengths = []
    rows = []
    for phase, model in enumerate(models):
        if given:
            length = given[phase]
        else:
            duration = parts[phase] * run.duration
            intervals = max(1, round(duration / run.interval))
            interval, accuracy = (jnp.asarray(x, model.dtype) for x in (duration / intervals, run.accuracy))
            length, number, failed = find_step_lengths(stepper, model, s, interval, jnp.asarray(intervals), accuracy)
            if failed:
                return None
            length = length[: spare_rows(int(number))]
        progress, found = _advance_along(stepper, model, s, length)
        if progress.first_bad >= 0:
            return None
        lengths.append(length)
        rows.append(found)
        s = progress.state
    return lengths, _counted_steps(lengths, rows)


@cached_jit(static=("stepper",), kernel=True)
def _advance_along(stepper: Stepper, model: Model, s: State, length: Array) -> tuple[Progress, Trajectory]:
    """The run in steps of these lengths (most,) [s], 0 after the last one; a row for each."""

    def take(progress: Progress, i: Array) -> tuple[Progress, Trajectory]:
        before = jnp.where(i > 0, length[i - 1], 0.0)
        return advance_and_save(stepper, model, progress, length[i][None], before=before[None])

    first = begin(stepper, model, s)
    return scan_steps(take, first, jnp.sum(length > 0.0), empty_trajectory(first, len(length)))


def _counted_steps(lengths: list[Array], rows: list[Trajectory]) -> Steps:
    """The steps of the phases in a row; none count in the phase before a line breaks, or while waves rise."""
    last = lengths[-1]
    if len(lengths) > 1:
        time = jnp.concatenate([jnp.zeros_like(lengths[0]), last])
    else:
        time = jnp.where(jnp.cumsum(last) > WINDOW_RAMP, last, 0.0)
    return Steps(jnp.concatenate([row.r for row in rows]), jnp.concatenate([row.tension for row in rows]), time)


@cached_jit(static=("quantities",))
def _hard_peaks(quantities: tuple[LimitedSignal, ...], model: Model, steps: Steps) -> Array:
    """Hard peaks (q,)."""
    counts = steps.time > 0.0
    return jnp.stack([jnp.max(jnp.where(counts, x, -jnp.inf)) for x in highest_signals(quantities, model, steps)])


@cached_jit(static=("quantities",))
def _soft_peaks(quantities: tuple[LimitedSignal, ...], model: Model, heights: Array, steps: Steps) -> Array:
    """Soft peaks (q,), whose widths are those of peaks of these heights (q,)."""
    return jnp.stack([q.soft(model, steps, heights[i]) for i, q in enumerate(quantities)])


def highest_signals(quantities: tuple[LimitedSignal, ...], model: Model, steps: Steps) -> list[Array]:
    """The maximum of each quantity at every time (q lists of k)."""
    return [jnp.max(q.signal(model, steps), axis=1) for q in quantities]
