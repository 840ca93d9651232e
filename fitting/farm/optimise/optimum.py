"""Result of a search for a design, and reasons to doubt its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.study.gradient_check import TRUSTED, GradientCheck
from fitting.farm.optimise.along_gradient import along_error, along_text
from fitting.farm.optimise.search_round import MAX_RESIDUAL
from fitting.farm.optimise.values import Dominated
from fitting.farm.optimise.variables import Variable

#: Value above which a constraint is called active.
ACTIVE_FROM = 0.97
#: Meaning of `run.characteristic`, in words.
CHARACTERISTIC = {
    "mean": "mean of the seeds' maxima",
    "most_probable": "most probable largest value of a storm by the seeds' maxima",
}
#: Minimum fraction of the objective's slope that the constraints of an optimum balance.
MIN_BALANCED = 0.9
#: Minimum reach of the last steps, in ranges of the variables, at which derivatives are reliable.
MIN_REACH = 0.01


@dataclass(frozen=True)
class Optimum:
    """Result of the search.

    Attributes:
        variables, before, after: and their values (p,); `after` is the best design whose whole runs meet all
            constraints, or the end of the search if none does (`feasible` False).
        objective: before and after.
        constraints: by name, before and after (whole runs).
        prices: by name of an active constraint, change of the objective for 1 % more of its limit.
        assumptions: by name, change of the objective for 1 % more, with the design adapted.
        characteristic: statistic of the seeds' maxima that the constraints apply to.
        residual: maximum difference, in limits, of constraints by windows (soft peaks times factors) from those of
            whole runs at `after`, before windows and factors were updated there; NaN if the start was the best.
        held: fraction of the objective's slope at `after` that active constraints and bounds balance: 1 at an optimum.
        along: two runs of a window along the gradient of its highest peak, before the search.
        warnings: reasons to doubt the result.
        dominated: derivatives of active constraints by variable that one seed dominates, with their mean and median.
    """

    variables: tuple[Variable, ...]
    before: np.ndarray
    after: np.ndarray
    of: str
    objective: tuple[float, float]
    constraints: dict[str, tuple[float, float]]
    prices: dict[str, float]
    assumptions: dict[str, float]
    feasible: bool
    residual: float
    held: float
    rounds: int
    runs: int
    history: list[Table]
    warnings: tuple[str, ...]
    characteristic: str
    dominated: tuple[Table, ...]
    along: GradientCheck

    @property
    def gain(self) -> float:
        """Relative decrease of the objective; NaN if it is zero at the start."""
        before, after = self.objective
        if before == 0.0:
            return float("nan")
        return 1.0 - after / before

    def to_json(self) -> Table:
        """Plain values."""
        along = self.along
        found = {**asdict(self), "gain": self.gain, "check": along_error(along), "along": along._asdict()}
        return jsonable(found)


def design_warnings(
    residual: float,
    held: float,
    reach: float,
    dominated: Sequence[Dominated],
    along: GradientCheck,
) -> list[str]:
    """Reasons to doubt a design's numbers, one line each; `reach` is that of the last steps."""
    reasons = [
        (
            residual > MAX_RESIDUAL,
            f"windows and whole runs differed by {residual:.1%} of a limit where the design was found (limit "
            f"{MAX_RESIDUAL:.0%}); its constraints are those of whole runs, but the search used others. Use a longer "
            "optimise.window, a smaller optimise.renew or more seeds to reduce the difference",
        ),
        (
            held < MIN_BALANCED,
            f"active constraints and bounds balance {max(held, 0.0):.0%} of the objective's slope (an optimum: at "
            f"least {MIN_BALANCED:.0%}): effects of 1 % changes are unreliable. Use more optimise.rounds",
        ),
        (
            reach < MIN_REACH,  # such as after the snap of a slack rope
            f"derivatives predict changes of up to {reach:.2%} of the variables' ranges only: effects of 1 % changes "
            "are unreliable. Compare designs by their whole runs",
        ),
        (
            bool(dominated),  # such as by a rope that becomes taut at the peak
            f"one seed dominates {len(dominated)} derivative(s) of active constraints: their mean and median differ in "
            "what they predict. Use more run.seeds, and compare designs by their whole runs",
        ),
        (
            along.status != TRUSTED,
            f"{along_text(along)}: not_trusted. Compare designs by their whole runs",
        ),
    ]
    return [reason for applies, reason in reasons if applies]
