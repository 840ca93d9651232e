"""A possible cause of systematic error, as score tests and fits find it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dropper_jax.base.json_values import Json
from fitting.parameters.parameter import Parameter

#: Gain in log likelihood below which a candidate is not suggested.
LEAST_GAIN = 6.0
#: Separator of the names of indistinguishable candidates in reports.
NAME_SEPARATOR = " or "
#: Probability, over all candidates, below which a candidate is reported.
REPORTED_PROBABILITY = 0.01


@dataclass(frozen=True)
class Candidate:
    """A possible cause of systematic error; has no changes if the traces cannot distinguish it from free parameters.

    Attributes:
        name: in words.
        free: names that free it.
        changes: by parameter, the change that the traces suggest.
        errors: standard errors of the changes.
        gain: in log likelihood.
        p: probability of such a gain if nothing is wrong, over all candidates.
        worth: gain minus the gain that its numbers bring by chance (Schwarz 1978); reports list candidates by it.
        alike: candidates that the traces cannot distinguish from it.
        moves: by parameter, the first-order change of the free parameters and of its own when it is freed.
        doubt: by each candidate that is indistinguishable from it, how far that one would move every parameter instead;
            parameters of this candidate return to their start values.
    """

    name: str
    free: tuple[str, ...] = ()
    changes: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    gain: float = 0.0
    p: float = 0.0
    worth: float = 0.0
    alike: tuple[str, ...] = ()
    moves: Mapping[str, float] = field(default_factory=dict)
    doubt: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def worth_naming(self) -> bool:
        """Whether the candidate is worth reporting."""
        return self.gain > LEAST_GAIN and self.p < REPORTED_PROBABILITY

    @property
    def identifiable(self) -> bool:
        """Whether the traces distinguish it from the free parameters."""
        return bool(self.changes)

    def to_json(self) -> Json:
        """Plain values."""
        keys = ("name", "free", "changes", "errors", "gain", "p", "worth", "alike")
        return {**{key: getattr(self, key) for key in keys}, "named": self.worth_naming, "told": self.identifiable}

    def __str__(self) -> str:
        if not self.changes and not self.gain:
            return self.name
        if not self.changes:
            return f"{self.name}: gains {self.gain:.0f} in log likelihood"
        largest = max(self.changes, key=lambda name: abs(self.changes[name] / self.errors[name]))
        change = f"{largest} by {self.changes[largest]:+.3g} +- {self.errors[largest]:.2g}"
        gain = f"--free ...,{','.join(self.free)} would gain {self.gain:.0f} in log likelihood ({change})"
        return f"{NAME_SEPARATOR.join([self.name, *self.alike])}: {gain}"


def omitted_parameter_bias(names: Sequence[Candidate], parameters: Sequence[Parameter]) -> tuple[np.ndarray, ...]:
    """By how much candidates indistinguishable from those freed would move the parameters, each (k,).

    A candidate that was freed later in its own right is no longer in doubt.
    """
    freed = {candidate.name.split(NAME_SEPARATOR)[0] for candidate in names}
    found = []
    for candidate in names:
        for name, move in candidate.doubt.items():
            if name not in freed:
                found.append(np.array([move.get(p.name, 0.0) for p in parameters]))
    return tuple(found)
