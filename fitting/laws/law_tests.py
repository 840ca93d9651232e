"""Results of the score tests of a damping law (`law_score_tests`), and what they mean in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from dropper_jax.base.json_values import Json
from fitting.parameters.names import free_option
from fitting.parameters.targets import RECORDING

#: Probability of a candidate's t, over the whole family, below which the law counts as wrong.
SIGNIFICANCE = 0.01
#: Fraction of a reported value from which its change by a candidate matters.
NOTICED_SHARE = 0.05


@dataclass(frozen=True)
class LawTest:
    """A candidate's test.

    Attributes:
        name: in words.
        free: paths that free it.
        change: its size to first order.
        error: standard error of that.
        t: their ratio.
        p: probability of such a t if the law is right, over all candidates.
        moves: by free parameter, its change to first order if the candidate is freed, with those shown before it.
        gain: in log evidence.
        matters: whether a reported value changes by more than its errors and 5 %.
        alike: names of other significant forces that the traces cannot distinguish from it.
    """

    name: str
    free: tuple[str, ...]
    change: float
    error: float
    t: float
    p: float
    moves: dict[str, float]
    gain: float
    matters: bool
    alike: tuple[str, ...] = ()

    def to_json(self) -> Json:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True)
class LawTests:
    """All tests of a fit: candidates that are shown, each with those before it free, then the others.

    Attributes:
        tests: of candidates that the traces distinguish from the free parameters, forces first.
        included, reducing: by free parameter, forces that may be a part of its value, or make it too low, as the motion
            does not distinguish them.
    """

    tests: tuple[LawTest, ...] = ()
    included: dict[str, tuple[str, ...]] = field(default_factory=dict)
    reducing: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def remark(self, name: str) -> str:
        """What a value may include, or be too low by; empty if it is that of one force."""
        remarks = []
        if name in self.included:
            remarks.append(f"may include {' and '.join(self.included[name])}")
        if name in self.reducing:
            remarks.append(f"may be too low because of {' and '.join(self.reducing[name])}")
        return ", ".join(remarks)

    @property
    def significant(self) -> list[LawTest]:
        """Candidates that the traces show, whether they matter or not."""
        return [test for test in self.tests if test.p < SIGNIFICANCE]

    @property
    def wrong(self) -> LawTest | None:
        """The candidate that explains most, if the law is wrong."""
        return next((test for test in self.significant if test.matters), None)


def holm(probabilities: Sequence[float]) -> list[float]:
    """Probabilities corrected for the number of tests (Holm 1979), in the order of the tests."""
    order = np.argsort(probabilities)
    steps = np.array(probabilities)[order] * np.arange(len(order), 0, -1)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected.tolist()


def freeing_option(test: LawTest, names: Sequence[str]) -> str:
    """A significant candidate in words, and what to do: free it in addition to the parameters of these names."""
    words = f"{' or '.join([test.name, *test.alike])}, which the scene lacks (t = {test.t:.1f}, p = {test.p:.1g})"
    if not test.free:
        return f"{words}; no force of the list explains it. Fit parts of the trace (--until) to see the change"
    use = f"{words}. Use {free_option(names, test.free)}"
    if any(name.startswith(f"{RECORDING}.") for name in names):  # --auto-free needs separate runs
        return use
    return f"{use}, or --auto-free"


def law_warnings(laws: LawTests) -> list[str]:
    """Lines on values that may include other forces, and on a significant candidate that changes no value by much."""
    lines = []
    for name in dict.fromkeys([*laws.included, *laws.reducing]):
        lines.append(f"{name} {laws.remark(name)}: this motion does not distinguish them")
    if laws.significant and laws.wrong is None:
        small = laws.significant[0]
        lines.append(
            f"the trace shows {small.name} (t = {small.t:.1f}, p = {small.p:.1g}), which changes no value by more than "
            f"its errors and {NOTICED_SHARE:.0%}"
        )
    return lines
