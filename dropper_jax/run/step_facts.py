"""Resolution of the steps: axial motion of the stiffest link, rotation of links, and links that become taut."""

from __future__ import annotations

import numpy as np

from dropper_jax.load.periods import periods
from dropper_jax.run.samples import Samples


def step_facts(solution: Samples) -> dict[str, float | int | None]:
    """Resolution of the steps: axial motion of the stiffest link, rotation of links, and links that become taut.

    Returns:
        axial_period_s: `2 pi/omega` of the stiffest link, `omega^2 = 4 EA/(L m)`, None if no link stretches.
        steps_per_axial_period, axial_step_s: steps per period, and the step that gives 60 steps per period.
        largest_turn_rad: maximum rotation of a link between two saved times. slack_to_taut_steps,
            compression_to_tension_steps: number of steps, summed over the links, in which an elastic link changes from
            slack to taut, and a rigid one from compression to tension. None unless every step is saved.
    """
    used = solution.settings
    period = periods(solution.scene).get("axial")
    # steps per period with which the midpoint rule has the frequency to 0.1 %: `(2 pi/n)^2/12`
    facts: dict[str, float | int | None] = {
        "axial_period_s": period,
        "steps_per_axial_period": None if period is None or "dt" not in used else period / used["dt"],
        "axial_step_s": None if period is None else period / 60,
        "largest_turn_rad": None,
        "slack_to_taut_steps": None,
        "compression_to_tension_steps": None,
    }
    if used.get("save_every") != 1 or "refused_steps" in used or len(solution.t) < 3:
        return facts
    turns = [0.0]
    taut = solution.tension[1:] > 0.0
    with np.errstate(invalid="ignore"):  # a run that failed may end with infinite positions
        for where in solution.lines:
            links = np.diff(solution.positions[:, where.nodes], axis=1)
            links = links / np.maximum(np.linalg.norm(links, axis=2, keepdims=True), 1e-300)
            turns.append(float(np.max(np.linalg.norm(links[1:] - links[:-1], axis=2))))
    facts["largest_turn_rad"] = float(2.0 * np.arcsin(min(0.5 * max(turns), 1.0)))
    changes = np.sum(taut[1:] & ~taut[:-1], axis=0)
    rigid = np.concatenate([np.full(line.links, line.rigid) for line in solution.scene.lines])
    facts["slack_to_taut_steps"] = int(np.sum(changes[~rigid]))
    facts["compression_to_tension_steps"] = int(np.sum(changes[rigid]))
    return facts
