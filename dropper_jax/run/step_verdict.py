"""Verdict on the steps of many runs of one kind, such as those of a sweep, from a few of them run with companions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.run.quality_checks import BALANCE_ERROR
from dropper_jax.run.samples import DRIFT, TOO_LONG
from dropper_jax.run.simulate import simulate
from dropper_jax.run.stated_errors import OFF_BY

#: What a step does to some of the runs, by status.
REASONS = {TOO_LONG: "the step is too long for some runs", DRIFT: "the step makes the energy of some runs drift"}


class StepVerdict(NamedTuple):
    """The verdict on the steps of all runs.

    Attributes:
        status: `ok`, or the worst one of the members' runs, `step_too_long` before `energy_drift`.
        warnings: those of the members about their steps, each after the member's name.
    """

    status: str = "ok"
    warnings: tuple[str, ...] = ()

    @property
    def failure(self) -> tuple[str, str] | None:
        """Status and line of the error of a command; None if the step is usable."""
        if self.status == "ok":
            return None
        return self.status, f"{self.status}: {REASONS[self.status]}; their warnings name the step to take"


def check_steps(members: Mapping[str, Scene], say: Progress = silent, **settings: Any) -> StepVerdict:
    """Run members by name, each with a companion that states its errors.

    Members that fail are left out: the runs of all members report them.

    Args:
        settings: of the runs, as for `simulate`.
    """
    statuses = []
    warnings = []
    for name, scene in members.items():
        say(1.0, f"checking the step: {name}")  # after the runs themselves
        try:
            solution = simulate(scene, companion="coarser", **settings)
        except SceneError:
            continue
        is_unusable = solution.status in REASONS
        if is_unusable:
            statuses.append(solution.status)
        for text in solution.warnings:
            if is_unusable or OFF_BY in text or text.startswith(BALANCE_ERROR):
                warnings.append(f"{name}: {text}")
    for worst in REASONS:
        if worst in statuses:
            return StepVerdict(worst, tuple(warnings))
    return StepVerdict("ok", tuple(warnings))
