"""Full storms of a design: hard peaks over the whole run with the scene's own law, and their times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import State, state
from dropper_jax.run.build import build_model, stepper_of
from dropper_jax.run.chunks import compile_run, first_carry, run_chunks
from fitting.farm.optimise.models import in_waves, sea_of, still_scene
from fitting.farm.optimise.quantities import Quantity
from fitting.farm.optimise.storm import highest_signals
from fitting.farm.optimise.values import near_rest
from fitting.farm.site import Case, Site


@dataclass(frozen=True)
class Storms:
    """Hard peaks of one case (q,) and their times (q,) [s]; NaN if the run failed, with `message`."""

    hard: np.ndarray
    when: np.ndarray
    message: str = ""


def full_storm(site: Site, scene: Scene, case: Case, quantities: Sequence[Quantity], near: State | None) -> Storms:
    """The whole run of a case of a design; steps that do not converge are halved.

    The time before `skip`, or before a line breaks, is not counted.
    """
    none = np.full(len(quantities), np.nan)
    own = still_scene(site, scene, case.storm, calm=False)
    model = build_model(own)
    if near is not None:
        near = state(model, near.r, tension=near.tension)
    start = near_rest(model, near)
    model = in_waves(model, sea_of(site, scene, case, site.run.ramp or max(site.run.skip, 1.0)))
    run = replace(own.run, save_every=1)
    stepper = stepper_of(model, run, track_work=False)
    pieces = compile_run(stepper, model, first_carry(stepper, model, start, run), run)
    outcome = run_chunks(pieces, run.saves, silent)
    found = outcome.trajectory
    if int(found.first_bad[-1]) >= 0:
        return Storms(none, none, f"step {int(found.first_bad[-1]) + 1} of {case.storm.name}, seed {case.seed}, failed")
    first = int(np.floor(site.run_of(case.storm).skip / run.step))
    hard = []
    when = []
    for part in np.array_split(np.arange(first, len(found.r)), max(1, (len(found.r) - first) // 1000)):
        peaks = highest_signals(tuple(quantities), model, jnp.asarray(found.r[part]), jnp.asarray(found.tension[part]))
        hard.append([float(jnp.max(x)) for x in peaks])
        when.append([(part[0] + int(jnp.argmax(x)) + 1) * run.step for x in peaks])
    best = np.argmax(hard, axis=0)
    return Storms(np.max(hard, axis=0), np.array(when)[best, np.arange(len(best))])
