"""Resolution of the steps: axial motion of the stiffest link, rotation of links, and links that become taut."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.numerics import unit_vectors
from dropper_jax.load.periods import periods
from dropper_jax.modelling.growth import overgrown
from dropper_jax.run.samples import Samples
from dropper_jax.scene.slices import link_differences

#: Steps per period with which the midpoint rule has the frequency to 0.1 %: `(2 pi/n)^2/12`.
STEPS_PER_PERIOD = 60


def step_facts(solution: Samples) -> dict[str, float | int | None]:
    """Resolution of the steps: axial motion of the stiffest link, rotation of links, and links that become taut.

    Returns:
        axial_period_s: `2 pi/omega` of the stiffest link, `omega^2 = 4 EA/(L m)`, None if no link stretches.
        steps_per_axial_period, axial_step_s: steps per period, None of steps that follow an accuracy, and the step that
            gives `STEPS_PER_PERIOD` of them.
        largest_turn_rad: maximum rotation of a link between two saved times. slack_to_taut_steps,
            compression_to_tension_steps: number of steps, summed over the links, in which an elastic link changes from
            slack to taut, and a rigid one from compression to tension. None unless every step is saved.
    """
    used = solution.settings
    keys = ("axial_period_s", "steps_per_axial_period", "axial_step_s", "largest_turn_rad")
    facts = dict.fromkeys((*keys, "slack_to_taut_steps", "compression_to_tension_steps"))
    period = periods(overgrown(solution.scene)).get("axial")  # mussels are mass of their links
    if period is not None:
        facts["axial_period_s"] = period
        facts["axial_step_s"] = period / STEPS_PER_PERIOD
        if "dt" in used and "refused_steps" not in used:  # with an accuracy dt is the interval between saved times
            facts["steps_per_axial_period"] = period / used["dt"]
    if used.get("save_every") != 1 or "refused_steps" in used or len(solution.t) < 3:
        return facts
    links = unit_vectors(link_differences(solution.scene, solution.positions))
    turn = float(np.max(np.linalg.norm(np.diff(links, axis=0), axis=2)))
    facts["largest_turn_rad"] = float(2.0 * np.arcsin(min(0.5 * turn, 1.0)))
    taut = solution.tension[1:] > 0.0
    changes = np.sum(taut[1:] & ~taut[:-1], axis=0)
    rigid = np.concatenate([np.full(line.links, line.rigid) for line in solution.scene.lines])
    facts["slack_to_taut_steps"] = int(np.sum(changes[~rigid]))
    facts["compression_to_tension_steps"] = int(np.sum(changes[rigid]))
    return facts
