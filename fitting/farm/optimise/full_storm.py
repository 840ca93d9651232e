"""Full storms of a design: hard peaks over all steps of the whole run with the scene's own law, and their times.

They take the steps of load cases, an accuracy or equal ones; windows always follow an accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option
from dropper_jax.base.progress import silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.build import build_model, stepper_of
from dropper_jax.run.chunks import compile_run, first_carry, run_chunks
from fitting.farm.optimise.calm_model import calm_scene, sea_of, with_waves
from fitting.farm.optimise.equilibria import find_equilibrium
from fitting.farm.optimise.quantities import LimitedSignal, Steps
from fitting.farm.optimise.window_peaks import highest_signals
from fitting.farm.site import Case, Site


@dataclass(frozen=True)
class StormPeaks:
    """Hard peaks of one case (q,) and their times (q,) [s]; NaN if the run failed, with `message`."""

    hard: np.ndarray
    when: np.ndarray
    message: str = ""


@component
class StepPeaks:
    """The maximum of each quantity at a step (q,), whose extremes over all steps a run keeps."""

    quantities: tuple[LimitedSignal, ...] = option("of the storm")

    def __call__(self, model: Model, before: State, after: State) -> tuple[Array, Array]:
        peaks = highest_signals(self.quantities, model, Steps(after.r[None], after.tension[None], jnp.ones(1)))
        return jnp.concatenate(peaks), after.t


def run_full_storm(
    site: Site, scene: Scene, case: Case, quantities: tuple[LimitedSignal, ...], near: State
) -> StormPeaks:
    """The whole run of a case of a design.

    The time before `skip`, or before a line breaks, is not counted.
    """
    own = calm_scene(site, scene, case.storm)
    model = build_model(own)
    start = find_equilibrium(model, state(model, near.r, tension=near.tension))
    model = with_waves(model, sea_of(site, scene, case, site.ramp))
    run = own.run
    stepper = stepper_of(model, run, track_work=False)
    pieces = compile_run(stepper, model, first_carry(stepper, model, start, run), run, StepPeaks(quantities))
    found = run_chunks(pieces, run.rows, silent).trajectory
    if found.extremes is None:
        raise ValueError("a run that is watched has extremes")
    if found.first_bad[-1] >= 0:
        none = np.full(len(quantities), np.nan)
        return StormPeaks(none, none, f"a step of {case.storm.name}, seed {case.seed}, failed")
    first = int(np.floor(site.run_of(case.storm).skip / run.interval))
    largest = found.extremes.largest[first:]
    peak = (np.argmax(largest, axis=0), np.arange(largest.shape[1]))
    hard = np.array(largest.max(axis=0), float)
    when = np.array(found.extremes.largest_at[first:][peak], float)
    steps = Steps(found.r[first:], found.tension[first:], jnp.ones(len(found.r) - first))
    for i, quantity in enumerate(quantities):
        if not quantity.is_instant:
            (rows,) = highest_signals((quantity,), model, steps)
            hard[i] = np.max(rows)
            when[i] = (first + np.argmax(rows) + 1) * run.interval
    return StormPeaks(hard, when)
