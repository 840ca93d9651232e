"""A design problem: objective and constraints of a design, with their derivatives, over all cases and seeds.

A constraint on a storm is that of the characteristic load: the mean over the seeds of the peaks, each a window's soft
peak times the factor between the whole run's hard peak and it (frozen until windows are chosen anew).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import State
from dropper_jax.scene import whole_lines
from fitting.optimise.goals import Goals
from fitting.optimise.models import STEP, Still, idle, in_assumed, sea_of, still
from fitting.optimise.quantities import Quantity
from fitting.optimise.rest import Rest, rest
from fitting.optimise.settings import Settings
from fitting.optimise.storm import RAMP, Peaks, peaks
from fitting.optimise.storms import Storms, full_storm
from fitting.optimise.variables import Variable, with_design
from fitting.site import Case, Part, Site

Say = Callable[[float, str], None]


@dataclasses.dataclass(frozen=True)
class Window:
    """Where in a case the optimiser looks: its begin [s], the factors (q,) from its soft peaks to the whole run's hard
    ones, and the heights (q,) that size the soft peaks."""

    case: Case
    begin: float
    factor: np.ndarray
    height: np.ndarray


@dataclasses.dataclass(frozen=True)
class Values:
    """Objective and constraints of a design; a constraint is met where it is at most 1.

    Attributes:
        objective, slope: and its derivative by variables and assumptions (p + a,).
        names: of the constraints; `value` (m,), `slopes` (m, p + a).
        solved: whether all runs were.
    """

    objective: float
    slope: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    slopes: np.ndarray
    solved: bool = True

    @property
    def worst(self) -> float:
        return float(np.max(self.value, initial=-np.inf))


class Design:
    """The problem; keeps the last poses at rest, from which the next are sought."""

    def __init__(self, site: Site, variables: Sequence[Variable], goals: Goals, settings: Settings) -> None:
        self.site = replace(site, states=(None,))  # lines that break are for `dropper cases`
        self.broken = [one.name for one in site.states if one is not None]
        self.variables, self.goals, self.settings = tuple(variables), goals, settings
        self.cases = self.site.cases
        self._near: dict[object, State] = {}
        self._quantities: tuple[Quantity, ...] | None = None
        self._strength = [strength_of(part, self.site.scene) for part in self.site.parts]
        self._told: tuple[bytes, tuple[np.ndarray, np.ndarray]] = b"", (np.zeros(0), np.zeros(0))

    @property
    def start(self) -> np.ndarray:
        return np.array([v.value for v in self.variables])

    @property
    def dt(self) -> float:
        return self.site.run.dt or self.site.scene.run.dt

    def still(self, x: np.ndarray, case: Case) -> tuple[Still, Rest]:
        """Calm model and pose at rest of a design in the current and level of a case."""
        found = in_assumed(still(self.site, self.variables, x, case.storm))
        own = rest(found, self._near.get(case.storm.still))
        self._near[case.storm.still] = own.state
        return found, own

    def quantities(self, found: Still) -> tuple[Quantity, ...]:
        if self._quantities is None:
            self._quantities = self.goals.quantities(self.site, found.model)
        return self._quantities

    @property
    def limited(self) -> int:
        """How many of the quantities have a limit: all but the motion that is an objective."""
        return len(self._quantities) - (1 if self.goals.objective.of == "motion" else 0)

    def told(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the scene itself says of a design: material, then the strength of each part over that at the start.

        Returns:
            (1 + parts,) and the derivatives by the variables (1 + parts, p).
        """
        key = np.asarray(x, float).tobytes()
        if key != self._told[0]:
            slope = np.zeros((1 + len(self.site.parts), len(x)))
            for k, variable in enumerate(self.variables):
                step = np.zeros(len(x))
                step[k] = STEP * variable.span
                slope[:, k] = (self._says(x + step) - self._says(x - step)) / (2 * step[k])
            self._told = key, (self._says(x), slope)
        return self._told[1]

    def _says(self, x: np.ndarray) -> np.ndarray:
        scene = with_design(self.site.scene, self.variables, x)
        strength = [
            strength_of(part, scene) / start for part, start in zip(self.site.parts, self._strength, strict=True)
        ]
        return np.array([self.goals.objective.material(scene), *strength])

    def check(self) -> None:
        """Refuse variables that move nothing.

        Raises:
            SceneError: their names.
        """
        found = still(self.site, self.variables, self.start, self.cases[0].storm)
        moves_cost = np.any(self.told(self.start)[1] != 0, axis=0)
        named = [name for name in idle(found, self.variables) if not moves_cost[self._number(name)]]
        if named:
            raise SceneError(f"variable: {', '.join(map(repr, named))} moves nothing; allowed: numbers that do")

    def _number(self, name: str) -> int:
        return [v.name for v in self.variables].index(name)

    def window(self, x: np.ndarray, window: Window, slopes: bool = True, given: tuple | None = None) -> Peaks:
        """Peaks of a window of a design."""
        found, own = given or self.still(x, window.case)
        scene = with_design(self.site.scene, self.variables, x)
        sea = sea_of(self.site, scene, window.case, RAMP, window.begin)
        quantities = self.quantities(found)
        heights = None if window.height is None else window.height
        return peaks(found, own, sea, quantities, self.dt, self.settings.window, slopes, heights)

    def renewed(self, x: np.ndarray, say: Say) -> tuple[tuple[Window, ...], list[Storms]]:
        """Windows around the largest loads of the whole runs of a design, and these runs' hard peaks.

        Raises:
            SceneError: a run that failed.
        """
        scene, windows, full = with_design(self.site.scene, self.variables, x), [], []
        stills: dict[object, tuple[Still, Rest]] = {}
        for i, case in enumerate(self.cases):
            say(i / len(self.cases), f"whole run of {case.storm.name}, seed {case.seed}")
            if case.storm.still not in stills:
                stills[case.storm.still] = self.still(x, case)
            found = stills[case.storm.still]
            quantities = self.quantities(found[0])
            storm = full_storm(self.site, scene, case, quantities, found[1].state)
            if storm.message:
                raise SceneError(f"design: {storm.message}; allowed: a smaller run.dt, or bounds nearer to the start")
            # the window is around the load that is nearest to its limit
            when = storm.when[int(np.argmax(storm.hard[: self.limited]))]
            begin = float(np.clip(when - self.settings.before, 0.0, self._last(self.site.run.duration)))
            window = Window(case, begin, np.ones(len(quantities)), None)
            soft = self.window(x, window, slopes=False, given=found)
            if not soft.solved:
                raise SceneError(
                    f"design: a window of {case.storm.name} has steps that resist; allowed: smaller run.dt"
                )
            windows.append(replace(window, factor=storm.hard / soft.soft, height=soft.hard))
            full.append(storm)
        return tuple(windows), full

    def _last(self, duration: float) -> float:
        return max(duration - self.settings.window, 0.0)

    def values(self, x: np.ndarray, windows: Sequence[Window], say: Say, slopes: bool = True) -> Values:
        """Objective and constraints of a design by its windows."""
        runs: list[Peaks] = []
        stills: dict[object, tuple[Still, Rest]] = {}
        for i, window in enumerate(windows):
            key = window.case.storm.still
            if key not in stills:
                stills[key] = self.still(x, window.case)
            say(i / len(windows), f"window of {window.case.storm.name}, seed {window.case.seed}")
            runs.append(self.window(x, window, slopes, stills[key]))
        size = next(iter(stills.values()))[1].dr.shape[0]
        hard = [run.soft * window.factor for run, window in zip(runs, windows, strict=True)]
        slope = [
            run.slope * window.factor[:, None] if slopes else np.zeros((len(run.soft), size))
            for run, window in zip(runs, windows, strict=True)
        ]
        return self._together(x, hard, slope, stills, all(run.solved for run in runs))

    def measured(self, x: np.ndarray, full: Sequence[Storms]) -> Values:
        """The same by the hard peaks of whole runs, without derivatives of what storms decide."""
        stills: dict[object, tuple[Still, Rest]] = {}
        for case in self.cases:
            if case.storm.still not in stills:
                stills[case.storm.still] = self.still(x, case)
        size = next(iter(stills.values()))[1].dr.shape[0]
        hard = [storm.hard for storm in full]
        return self._together(x, hard, [np.zeros((len(h), size)) for h in hard], stills, True)

    def _together(
        self,
        x: np.ndarray,
        hard: Sequence[np.ndarray],
        slope: Sequence[np.ndarray],
        stills: dict[object, tuple[Still, Rest]],
        solved: bool,
    ) -> Values:
        names: list[str] = []
        value: list[float] = []
        slopes: list[np.ndarray] = []
        (material, *strength), told = self.told(x)
        size = slope[0].shape[1]
        told = np.hstack([told, np.zeros((len(told), size - told.shape[1]))])
        for q, (now, way) in enumerate(zip(strength, told[1:], strict=True)):  # parts come first among the quantities
            slope = [_row(s, q, s[q] / now - h[q] / now**2 * way) for h, s in zip(hard, slope, strict=True)]
            hard = [_row(h, q, h[q] / now) for h in hard]
        numbers = sorted({case.storm.number for case in self.cases})
        for number in numbers:
            own = [i for i, case in enumerate(self.cases) if case.storm.number == number]
            mean = np.mean([hard[i] for i in own], axis=0)
            way = np.mean([slope[i] for i in own], axis=0)
            storm = self.cases[own[0]].storm
            for q in range(self.limited):
                names.append(f"{self._quantities[q].name}: {storm.name}")
                value.append(float(mean[q]))
                slopes.append(way[q])
        for key, (found, own) in stills.items():
            level = float(key[2])
            for depth in self.goals.depths:
                for name, near, by in depth.over(found.model, np.asarray(own.state.r), own.dr, level):
                    label = "" if len(stills) == 1 else f": {key[0] or ''} level {level:+g} m"
                    names.append(f"{name}{label}")
                    value.append(near)
                    slopes.append(by)
        objective, way = (material, told[0]) if self.goals.objective.of == "material" else self._largest(hard, slope)
        return Values(float(objective), way, tuple(names), np.array(value), np.array(slopes), solved)

    def _largest(self, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """The objective where it is of storms: the largest of all cases."""
        of, names = self.goals.objective, [q.name for q in self._quantities]
        q = len(names) - 1 if of.of == "motion" else names.index(of.part)
        worst = int(np.argmax([h[q] for h in hard]))
        return float(hard[worst][q]), slope[worst][q]


def _row(a: np.ndarray, i: int, value: np.ndarray) -> np.ndarray:
    """The array with another entry or row."""
    changed = np.array(a)
    changed[i] = value
    return changed


def strength_of(part: Part, scene: Scene) -> float:
    """Breaking load of a part [N] where it is the scene's, so that it follows the design; 1 where the site gives it."""
    specs = {line.name: line.spec for line in whole_lines(scene)}
    loads = [specs[name].breaking_load for name in part.lines]
    if any(load is None for load in loads) or not part.of_scene:
        return 1.0
    return float(np.mean([np.min(load) for load in loads]))
