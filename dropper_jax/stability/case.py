"""Definition of a hard case, and the list of all: `data/hard_cases.json`, which tests/hard_cases/catalogue.py writes
from the scenes, closed forms and SciPy solutions there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from dropper_jax.base.read import Table, Values
from dropper_jax.load.scene import Scene, load_scene


@dataclass(frozen=True)
class Exact:
    """What a case is compared with: a quantity (k,), or positions (k, 2) or (k, 3) [m], at times (k,) [s]."""

    times: np.ndarray
    values: np.ndarray

    def upto(self, end: float) -> Exact:
        """The part that a run to `end` [s] has reached."""
        reached = self.times <= end + 1e-9
        return Exact(self.times[reached], self.values[reached])


@dataclass(frozen=True)
class Case:
    """A hard case: it holds where the measured number is at most the limit and the status is `expected`.

    Attributes:
        name, claim, limit, unit: as printed.
        measure: how it is measured, a name in `stability.measures`.
        scene: a name of `Catalogue.scenes`, or of a packaged scene.
        dt, duration: step and duration [s].
        short: duration of the shortened run [s].
        point: point whose path is measured.
        exact: what it is compared with.
        size: scale of the measured number.
        level: height from which depths and angles are measured [m].
        weights: weights of the nodes, or a direction (3,), that make one quantity of positions.
        from_start: whether displacements are compared, not positions.
        settings: more settings of the run.
        short_scene: another scene of the shortened run.
        baseline: duration [s] for which the thesis' schemes run the same scene; None: they do not.
    """

    name: str
    claim: str
    limit: float
    unit: str
    measure: str
    scene: str
    dt: float
    duration: float
    short: float
    expected: str = "ok"
    point: str = ""
    exact: Exact = Exact(np.zeros(0), np.zeros(0))
    size: float = 1.0
    level: float = 0.0
    weights: Sequence[float] = ()
    from_start: bool = False
    settings: Values = field(default_factory=dict)
    short_scene: str = ""
    baseline: float | None = None

    def span(self, short: bool) -> float:
        """Duration of the run [s]."""
        if short:
            return self.short
        return self.duration


@dataclass(frozen=True)
class Outcome:
    """What was measured, and the status that the run ended with."""

    measured: float
    status: str


def status_of(values: ArrayLike) -> str:
    """`ok` where all values are finite."""
    if np.all(np.isfinite(values)):
        return "ok"
    return "non_finite"


@cache
def _table() -> Table:
    """The file of the catalogue."""
    return json.loads((resources.files("dropper_jax") / "data" / "hard_cases.json").read_text(encoding="utf-8"))


@cache
def all_cases() -> tuple[Case, ...]:
    """The catalogue."""
    return tuple(map(case_of, _table()["cases"]))


def case_of(row: Values) -> Case:
    """A case from a row of the list."""
    given = dict(row)
    if "exact" in row:
        given["exact"] = _exact(**row["exact"])
    return Case(**given)


def _exact(values: list, times: list | None = None, every: float = 0.0) -> Exact:
    """Values at times, or at equal steps [s] from 0 on."""
    if times is None:
        found = every * np.arange(len(values))
    else:
        found = np.array(times)
    return Exact(found, np.array(values))


def scene_of(name: str) -> Scene:
    """A scene of the catalogue, or a packaged one."""
    return load_scene(_table()["scenes"].get(name, name))
