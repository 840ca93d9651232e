"""The errors that a companion states of a run: their values, and the warnings and the line of text about them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dropper_jax.base.read import Values
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.run.samples import Samples

#: Fraction of the maximum tension of all lines below which a line's errors do not count in the verdict.
SMALL_TENSION = 0.1
#: Error of a result above which equal steps are unusable.
UNUSABLE = 0.1
#: Error of a result above which equal steps are warned of.
WARNED = 0.03
#: Stated errors above this multiple of the accuracy are warned of.
MISSED = 3.0
#: Words in every warning of a stated error.
OFF_BY = "may be off by"


@dataclass(frozen=True)
class LineErrors:
    """Mean, standard deviation and maximum in time of the tension of a line's most loaded link, with errors [N]."""

    line: str
    link: int
    mean_n: float
    mean_error_n: float
    deviation_n: float
    deviation_error_n: float
    maximum_n: float
    maximum_error_n: float


@dataclass(frozen=True)
class StatedErrors:
    """Errors of a run.

    Attributes:
        companion: what the companion followed, in words.
        positions: RMS distance of the worst node as a fraction of the travel, until `chaotic_from_s`; None at rest.
        angles_rad: RMS error of the links' angles within a window of a fit (see `run.companion`).
    """

    companion: str
    lines: list[LineErrors]
    positions: float | None
    chaotic_from_s: float | None
    angles_rad: float

    @property
    def makes_unusable(self) -> bool:
        """Whether an error is too large for equal steps; what chaos makes random does not count."""
        if self.chaotic_from_s is not None:
            return (self.positions or 0.0) > UNUSABLE
        return any(size > UNUSABLE for _, _, size in self.relative())

    def relative(self) -> Iterator[tuple[str, str, float]]:
        """Line, quantity and relative error: of mean and deviation over their sum, of the maximum over itself."""
        largest = max((row.maximum_n for row in self.lines), default=0.0)
        for row in self.lines:
            scale = max(abs(row.mean_n) + row.deviation_n, SMALL_TENSION * largest)
            if scale > 0.0:
                yield row.line, "mean tension", row.mean_error_n / scale
                yield row.line, "deviation of the tension", row.deviation_error_n / scale
            if row.maximum_n > SMALL_TENSION * largest:
                yield row.line, "largest tension", row.maximum_error_n / row.maximum_n
        if self.positions is not None:
            yield "", "positions", self.positions


def error_warnings(found: StatedErrors, solution: Samples) -> Iterator[str]:
    """One line for the result of each kind that is most off, if it is off by more than the run is to be."""
    accuracy = solution.scene.run.accuracy
    limit = WARNED
    if accuracy is not None:
        limit = MISSED * accuracy
    worst: dict[str, tuple[str, float]] = {}
    for line, what, size in found.relative():
        is_chance = found.chaotic_from_s is not None and what != "positions"
        if size > limit and not is_chance and size > worst.get(what, ("", 0.0))[1]:
            worst[what] = (line, size)
    for what, (line, size) in worst.items():
        of = f"of {line} " if line else ""
        yield f"{what} {of}{OFF_BY} {100.0 * size:.2g} %. {_advice(solution)}"


def _advice(solution: Samples) -> str:
    """The option that makes the errors smaller."""
    accuracy = solution.scene.run.accuracy
    if accuracy is not None:
        return f"Use --accuracy {0.25 * accuracy:.2g}"
    if INTEGRATORS[solution.scene.run.integrator]().local_error is None:
        return f"Use --dt {0.5 * solution.settings['dt']:.2g}"
    return "Use --accuracy 0.01 in place of --dt"


def errors_in_words(found: Values) -> str:
    """The stated errors of a solution's settings, in one line."""
    texts = []
    if found["positions"] is not None:
        texts.append(f"positions {100.0 * found['positions']:.2g} % of the travel")
    row = max(found["lines"], key=lambda row: row["maximum_n"], default={"maximum_n": 0.0})
    if row["maximum_n"] > 0.0:
        loads = []
        for key in ("mean", "deviation", "maximum"):
            loads.append(f"{key} {row[f'{key}_n']:.4g} +- {row[f'{key}_error_n']:.2g} N")
        texts.append(f"{row['line']}: {', '.join(loads)}")
    if found["chaotic_from_s"] is not None:
        texts.append(f"chaotic from {found['chaotic_from_s']:.3g} s: positions until then, tensions with their chance")
    return "; ".join([*texts, f"from {found['companion']}"])
