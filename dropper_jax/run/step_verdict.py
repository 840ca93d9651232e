"""Verdict on the step of several runs that differ in values: that of `dropper run` on their extreme members."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.load.scene import Scene
from dropper_jax.run.samples import DRIFT, TOO_LONG
from dropper_jax.run.simulate import simulate

#: What a step does to some of the runs, by status.
REASONS = {TOO_LONG: "the step is too long for some runs", DRIFT: "the step makes the energy of some runs drift"}


class StepVerdict(NamedTuple):
    """Status, `ok`, `step_too_long` or `energy_drift`, and the warnings of members, each with the member's name."""

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
    status = "ok"
    warnings = []
    for name, scene in members.items():
        say(1.0, f"checking the step: {name}")  # after the runs themselves
        try:
            solution = simulate(scene, companion="coarser", **settings)
        except SceneError:
            continue
        unusable = solution.status in (TOO_LONG, DRIFT)
        if unusable and status != TOO_LONG:
            status = solution.status
        for text in solution.warnings:
            if unusable or "may be off by" in text or text.startswith("energy balance error"):
                warnings.append(f"{name}: {text}")
    return StepVerdict(status, tuple(warnings))
