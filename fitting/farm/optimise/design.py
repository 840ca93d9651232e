"""A design problem: objective and constraints of a design, with their derivatives, over all cases and seeds.

A constraint on a storm applies to the characteristic load: the mean over the seeds of the peaks, or the most probable
maximum (`over_seeds`). Each peak is a window's soft peak times its ratio to the whole run's hard peak, which is frozen
until windows are chosen again. Cases with a broken line have loads of parts and anchors as constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropper_jax.base.errors import Progress, SceneError
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.load.scene import Scene
from dropper_jax.model import State
from dropper_jax.scene import whole_lines
from dropper_jax.scene.run import DEFAULT_ACCURACY
from fitting.farm.optimise.broken_link import link_of, masked_still
from fitting.farm.optimise.full_storm import Storms, full_storm
from fitting.farm.optimise.goals import Goals, check_depths
from fitting.farm.optimise.maxima_weights import check_seeds, weights
from fitting.farm.optimise.models import ASSUMPTIONS, Still, designs_beside, idle, in_assumed, sea_of, still
from fitting.farm.optimise.quantities import Quantity
from fitting.farm.optimise.storm import WINDOW_RAMP, Peaks, Settings, WindowRun, check_windows, peaks, slopes
from fitting.farm.optimise.values import RunStart, Values, Window, rest
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.site import Case, Part, Site
from fitting.farm.site.site import LONGEST_INTERVAL

#: Change of a variable up and down in derivatives of windows, relative to its range, and of the assumptions.
#: Differences to one side are not enough: near a leg that is almost taut they are off by more than half.
CHANGE = 2e-3


@dataclass(frozen=True)
class WindowRuns:
    """Runs of the windows of a design.

    Attributes:
        x: the design (p,).
        factors: ratio of the whole run's hard peaks to the soft ones, for each window (q,).
        windows: one of each case; starts: equilibria by what cases share.
    """

    x: np.ndarray
    factors: Sequence[np.ndarray]
    windows: Sequence[Peaks]
    starts: dict[object, RunStart]

    @property
    def peaks(self) -> list[np.ndarray]:
        """Peaks of whole runs as the windows predict them, for each case (q,)."""
        return [window.soft * factor for window, factor in zip(self.windows, self.factors, strict=True)]

    @property
    def solved(self) -> bool:
        return all(window.solved for window in self.windows)


class Design:
    """The problem; stores the last equilibria, from which the next ones are solved."""

    def __init__(self, site: Site, variables: Sequence[Variable], goals: Goals, settings: Settings) -> None:
        check_seeds(site.run)
        self.site, self.calm = site, replace(site, states=(None,))  # windows break their lines themselves
        self.variables, self.goals, self.settings = tuple(variables), goals, settings
        self.cases = self.site.cases
        steps = site.prepared().run
        interval, accuracy = min(steps.interval, LONGEST_INTERVAL), steps.accuracy or DEFAULT_ACCURACY
        #: Windows follow the accuracy of the site's runs, or the default one where these take equal steps.
        self.window_run = WindowRun(settings.window, interval, accuracy)
        self._changes = CHANGE * np.array([v.span for v in self.variables])
        self._near: dict[object, State] = {}
        self._quantities: dict[str, tuple[Quantity, ...]] = {}
        self._strength = [strength_of(part, self.site.scene) for part in self.site.parts]
        self._compiled: set[tuple[str, str]] = set()
        self._scene_cache: tuple[bytes, tuple[np.ndarray, np.ndarray]] = b"", (np.zeros(0), np.zeros(0))

    @property
    def start(self) -> np.ndarray:
        return np.array([v.value for v in self.variables])

    def still(self, x: np.ndarray, case: Case) -> RunStart:
        """Calm model and equilibrium of a design in the current and level of a case, all lines intact."""
        found = in_assumed(still(self.calm, self.variables, x, case.storm))
        own = rest(found, self._near.get(case.storm.still))
        self._near[case.storm.still] = own.state
        return RunStart(found, own)

    def run_start(self, x: np.ndarray, case: Case, cache: dict[object, RunStart], polished: bool = False) -> RunStart:
        """The same for a case, with the later model of its window; `cache` stores what cases share."""
        whole = case.storm.still
        if whole not in cache:
            cache[whole] = self.still(x, case)
        broken = case.storm.broken
        if broken is None:
            return cache[whole]
        key = (*whole, broken.name, polished)
        if key not in cache:
            found = cache[whole].still
            link = link_of(cache[whole].still.model, broken)
            masked = masked_still(found, link)
            if polished:
                own = rest(masked, self._near.get(key))
                self._near[key] = own.state
                cache[key] = RunStart(masked, own, masked)
            else:
                cache[key] = RunStart(masked_still(found, None), cache[whole].rest, masked)
        return cache[key]

    def quantities(self, case: Case, found: Still) -> tuple[Quantity, ...]:
        """The quantities that apply to a case."""
        kind = case.storm.kind
        if kind not in self._quantities:
            self._quantities[kind] = self.goals.quantities(self.site, found.model, kind)
        return self._quantities[kind]

    def count_limited(self, case: Case) -> int:
        """Number of quantities with a limit: all but a motion that is the objective."""
        own = self._quantities[case.storm.kind]
        return len(own) - (1 if self.goals.objective.of == "motion" and case.storm.broken is None else 0)

    def scene_constraints(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Properties of a design without a run: material, then the strength of each part over that at the start.

        Returns:
            (1 + parts,) and the derivatives by the variables (1 + parts, p).
        """
        key = np.asarray(x, float).tobytes()
        if key != self._scene_cache[0]:
            slopes = []
            for distance, higher, lower in designs_beside(self.variables, x):
                slopes.append((self._evaluate_scene(higher) - self._evaluate_scene(lower)) / distance)
            self._scene_cache = key, (self._evaluate_scene(x), np.stack(slopes, axis=1))
        return self._scene_cache[1]

    def _evaluate_scene(self, x: np.ndarray) -> np.ndarray:
        scene = with_design(self.site.scene, self.variables, x)
        strength = np.array([strength_of(part, scene) for part in self.site.parts]) / self._strength
        return np.array([self.goals.objective.material(scene), *strength])

    def check(self) -> None:
        """Reject scenes that cannot be designed, variables without effect, and contradicting depths.

        Raises:
            SceneError: with their names.
        """
        found = still(self.calm, self.variables, self.start, self.cases[0].storm)
        check_windows(found.model)
        check_depths(self.goals.depths, found.model)
        costs = np.any(self.scene_constraints(self.start)[1] != 0, axis=0)
        free = [v.name for v, moves in zip(self.variables, costs, strict=True) if not moves]
        named = [name for name in idle(found, self.variables) if name in free]
        if named:
            raise SceneError(f"variable: {', '.join(map(repr, named))} moves nothing. Use numbers that do")

    def window(self, x: np.ndarray, window: Window, start: RunStart) -> Peaks:
        """Peaks of a window of a design."""
        scene = with_design(self.calm.scene, self.variables, x)
        sea = sea_of(self.calm, scene, window.case, WINDOW_RAMP, window.begin)
        quantities = self.quantities(window.case, start.still)
        return peaks(start.still, start.rest, sea, quantities, self.window_run, window.height, start.after)

    def slopes(self, found: Sequence[Peaks], say: Progress, assumptions: bool = False) -> list[np.ndarray]:
        """Derivatives of the soft peaks of windows (q, p + a) by the variables, and by the assumptions if wanted, else
        0."""
        assumed = CHANGE if assumptions else 0.0
        sizes = np.append(self._changes, np.full(len(ASSUMPTIONS), assumed))
        return slopes(found, sizes, lambda done, of: say(done / of, f"derivatives: {done} of {of}"))

    def renew_windows(self, x: np.ndarray, say: Progress) -> tuple[tuple[Window, ...], list[Storms]]:
        """Windows around the peak loads of the whole runs of a design, and these runs' hard peaks.

        Raises:
            SceneError: a run that failed.
        """
        scene = with_design(self.site.scene, self.variables, x)
        cache = {}
        stands = [self.run_start(x, case, cache) for case in self.cases]
        for case, start in zip(self.cases, stands, strict=True):
            self.quantities(case, start.still)

        def run_fully(i: int) -> Storms:
            case = self.cases[i]
            start = stands[i]
            return full_storm(self.site, scene, case, self.quantities(case, start.still), start.rest.state)

        full = self._run_parallel(run_fully, "whole runs", say)
        for storm in full:
            if storm.message:
                (steps,) = self.site.steps
                raise SceneError(f"design: {storm.message}. Use a smaller run.{steps}, or bounds nearer to the start")
        windows = [self._window_around_peak(case, storm) for case, storm in zip(self.cases, full, strict=True)]
        stands = [self.run_start(x, window.case, cache, window.polished) for window in windows]

        def scale_window(i: int) -> Window:
            soft = self.window(x, windows[i], stands[i])
            if not soft.solved:
                name = windows[i].case.storm.name
                raise SceneError(f"design: a window of {name} has steps that do not converge")
            return replace(windows[i], factor=full[i].hard / soft.soft, height=soft.hard)

        return tuple(self._run_parallel(scale_window, "windows", say)), full

    def _window_around_peak(self, case: Case, storm: Storms) -> Window:
        """The window around the peak of a whole run that is nearest to its limit; its scale factor comes later."""
        when = storm.when[int(np.argmax(storm.hard[: self.count_limited(case)]))]
        last = max(self.site.run.duration - self.settings.window, 0.0)
        begin = float(np.clip(when - self.settings.before, 0.0, last))
        window = Window(case, begin, np.ones(len(storm.hard)))
        if case.storm.broken is None:
            return window
        # the first third is intact, so the impact of the break is in the window if the peak occurs soon enough
        broke = self.site.break_time - self.settings.window / 3
        if when <= broke + self.settings.window:
            return replace(window, begin=max(broke, 0.0))
        return replace(window, polished=True)

    def _run_parallel(self, one: Callable[[int], Any], what: str, say: Progress) -> list[Any]:
        """`one` of every case; a program that is not yet compiled runs alone the first time."""
        count = len(self.cases)
        found = {}
        for kind in dict.fromkeys(case.storm.kind for case in self.cases):
            own = [i for i, case in enumerate(self.cases) if case.storm.kind == kind]
            done = len(found)
            tell = lambda k, done=done: say((done + k) / count, f"{what}: {done + k} of {count}")  # noqa: E731
            alone = int((what, kind) not in self._compiled)
            found |= dict(zip(own, run_parallel(one, own, tell, alone=alone), strict=True))
            self._compiled.add((what, kind))
        return [found[i] for i in range(count)]

    def run_windows(self, x: np.ndarray, windows: Sequence[Window], say: Progress) -> WindowRuns:
        """Runs of the windows of a design, one of each case."""
        cache: dict[object, RunStart] = {}
        stands = [self.run_start(x, window.case, cache, window.polished) for window in windows]
        found = self._run_parallel(lambda i: self.window(x, windows[i], stands[i]), "windows", say)
        factors = [window.factor for window in windows]
        return WindowRuns(x, factors, found, cache)

    def values(self, runs: WindowRuns) -> Values:
        """Objective and constraints of a design by its windows, without derivatives of storms."""
        return self._together(runs.x, runs.peaks, self._no_slopes(runs.peaks), runs.starts, runs.solved)

    def derivatives(self, runs: WindowRuns, say: Progress, assumptions: bool = False) -> Values:
        """The same with derivatives by the variables, and by the assumptions if wanted."""
        found = self.slopes(runs.windows, say, assumptions)
        slope = [own * factor[:, None] for own, factor in zip(found, runs.factors, strict=True)]
        solved = runs.solved and all(np.isfinite(own).all() for own in slope)
        return self._together(runs.x, runs.peaks, slope, runs.starts, solved)

    def _no_slopes(self, hard: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Zero derivatives of quantities (q,) of each case, (q, p + a)."""
        return [np.zeros((len(peaks), len(self.variables) + len(ASSUMPTIONS))) for peaks in hard]

    def measure_full_runs(self, x: np.ndarray, full: Sequence[Storms]) -> Values:
        """The same by the hard peaks of whole runs, without derivatives of storm quantities."""
        cache: dict[object, RunStart] = {}
        for case in self.cases:
            self.run_start(x, case, cache)
        hard = [storm.hard for storm in full]
        return self._together(x, hard, self._no_slopes(hard), cache, True)

    def _together(
        self,
        x: np.ndarray,
        hard: Sequence[np.ndarray],
        slope: Sequence[np.ndarray],
        cache: dict[object, RunStart],
        solved: bool,
    ) -> Values:
        """Objective and constraints from the quantities (q,) of every case and their slopes (q, p + a)."""
        rows: list[tuple[str, float, np.ndarray]] = []
        by_seed: dict[str, np.ndarray] = {}
        (material, *strength), of_scene = self.scene_constraints(x)
        of_scene = np.pad(of_scene, ((0, 0), (0, len(ASSUMPTIONS))))
        # parts come first among the quantities
        n = len(strength)
        now = np.array(strength)[:, None]
        slope = [
            np.vstack([s[:n] / now - h[:n, None] / now**2 * of_scene[1:], s[n:]])
            for h, s in zip(hard, slope, strict=True)
        ]
        hard = [np.concatenate([h[:n] / now[:, 0], h[n:]]) for h in hard]
        for number in sorted({case.storm.number for case in self.cases}):
            own = [i for i, case in enumerate(self.cases) if case.storm.number == number]
            case = self.cases[own[0]]
            peaks = np.array([hard[i] for i in own])
            share = weights(peaks, self.site.run_of(case.storm))
            shares = share[:, :, None] * np.array([slope[i] for i in own])
            mean = np.sum(share * peaks, axis=0)
            way = shares.sum(axis=0)
            for q in range(self.count_limited(case)):
                name = f"{self._quantities[case.storm.kind][q].name}: {case.storm.name}"
                rows.append((name, float(mean[q]), way[q]))
                by_seed[name] = len(own) * shares[:, q]
        storms = {case.storm.still: case.storm for case in self.cases if case.storm.still in cache}
        for key, storm in storms.items():
            start = cache[key]
            level = float(storm.level)
            label = ""
            if len(storms) != 1:
                label = f": {storm.current_name or ''} level {level:+g} m"
            for depth in self.goals.depths:
                own = depth.over(start.still.model, np.asarray(start.rest.state.r), start.rest.dr, level)
                rows += [(name + label, near, by) for name, near, by in own]
        names, value, slopes = zip(*rows, strict=True) if rows else ((), (), ())
        objective = material
        way = of_scene[0]
        if self.goals.objective.of != "material":
            objective, way = self._largest(hard, slope)
        return Values(float(objective), way, tuple(names), np.array(value), np.array(slopes), solved, by_seed)

    def _largest(self, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """The objective if it depends on storms: the maximum of all cases."""
        of = self.goals.objective
        intact = [i for i, case in enumerate(self.cases) if case.storm.broken is None]
        names = [q.name for q in self._quantities[self.cases[intact[0]].storm.kind]]
        q = len(names) - 1 if of.of == "motion" else names.index(of.part)
        worst = max(intact, key=lambda i: hard[i][q])
        return float(hard[worst][q]), slope[worst][q]


def strength_of(part: Part, scene: Scene) -> float:
    """Breaking load of a part [N] if it comes from the scene, so that it follows the design; 1 if the site gives it."""
    if not part.of_scene:
        return 1.0
    specs = {line.name: line.spec for line in whole_lines(scene)}
    loads = [specs[name].breaking_load for name in part.lines]
    return float(np.mean([np.min(load) for load in loads if load is not None]))
