"""A design problem: objective and constraints of a design, with their derivatives, over all cases and seeds.

A constraint on a storm applies to the characteristic load: the mean over the seeds of the peaks, or the most probable
maximum (`maxima_weights`). Each peak is a window's soft peak times the ratio of the whole run's hard peak to it, which
is frozen until windows are chosen again. Cases with a broken line have loads of parts and anchors as constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.base.progress import Progress
from dropper_jax.base.records import names_of
from dropper_jax.scene.run import DEFAULT_ACCURACY
from fitting.farm.optimise.full_storm import Storms, full_storm
from fitting.farm.optimise.goals import DepthUtilisation, Goals, check_depths
from fitting.farm.optimise.maxima_weights import check_seeds, weights
from fitting.farm.optimise.models import ASSUMPTIONS, Still, idle, sea_of, shifted_designs, still
from fitting.farm.optimise.run_starts import DesignCache, RunStarts
from fitting.farm.optimise.settings import WINDOW_RAMP, SearchSettings
from fitting.farm.optimise.storm import Peaks, WindowRun, check_windows, peaks, slopes
from fitting.farm.optimise.strength import over_strength, strength_of
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.optimise.windows import Window, WindowRuns
from fitting.farm.site import Case, Site, Storm
from fitting.farm.site.case import name_waters
from fitting.farm.site.site import LONGEST_INTERVAL

#: Change of a variable up and down in derivatives of windows, relative to its range, and of the assumptions.
#: Differences to one side are not enough: near a leg that is almost taut they are off by more than half.
WINDOW_DIFFERENCE_STEP = 2e-3


class Design:
    """The problem.

    Attributes:
        start: the design at the start (p,).
        starts: of the runs of any design.
        quantities: that apply to storms, by kind of state (`Storm.kind`).

    Raises:
        SceneError: a scene that cannot be designed, variables without effect, contradicting depths, too few seeds.
    """

    def __init__(self, site: Site, variables: Sequence[Variable], goals: Goals, settings: SearchSettings) -> None:
        check_seeds(site.run)
        self.site = site
        self.calm = replace(site, states=(None,))  # windows break their lines themselves
        self.variables = tuple(variables)
        self.goals = goals
        self.settings = settings
        self.cases = site.cases
        self.start = np.array([v.value for v in variables])
        steps = site.prepared().run
        #: Windows follow the accuracy of the site's runs, or the default one where these take equal steps.
        self.window_run = WindowRun(
            settings.window, min(steps.interval, LONGEST_INTERVAL), steps.accuracy or DEFAULT_ACCURACY
        )
        self._strength = [strength_of(part, site.scene) for part in site.parts]
        self._compiled: set[tuple[str, str]] = set()
        self._of_scene = DesignCache()
        self.starts = RunStarts(self.calm, self.variables)
        first = still(self.calm, self.variables, self.start, self.cases[0].storm)
        check_windows(first.model)
        check_depths(goals.depths, first.model)
        self.quantities = {kind: goals.quantities(site, first.model, kind) for kind in site.kinds}
        self._check_effects(first)

    def _check_effects(self, first: Still) -> None:
        """Reject variables that change neither the model nor what the scene costs and carries."""
        costs = np.any(self.scene_constraints(self.start)[1] != 0, axis=0)
        named = [repr(v.name) for k, v in enumerate(self.variables) if idle(first, k) and not costs[k]]
        if named:
            raise SceneError(f"variable: {', '.join(named)} moves nothing. Use numbers that do")

    def count_limited(self, kind: str) -> int:
        """Number of quantities with a limit: all but a motion that is the objective."""
        objective = self.goals.objective.of == "motion" and kind == "intact"
        return len(self.quantities[kind]) - objective

    def scene_constraints(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Properties of a design without a run: material, then the strength of each part over that at the start.

        Returns:
            (1 + parts,) and the derivatives by the variables (1 + parts, p).
        """
        found = self._of_scene.at(x)
        if not found:
            slopes = []
            for distance, higher, lower in shifted_designs(self.variables, x):
                slopes.append((self._evaluate_scene(higher) - self._evaluate_scene(lower)) / distance)
            found["constraints"] = (self._evaluate_scene(x), np.stack(slopes, axis=1))
        return found["constraints"]

    def _evaluate_scene(self, x: np.ndarray) -> np.ndarray:
        """Material, then the strength of each part over that at the start (1 + parts,)."""
        scene = with_design(self.site.scene, self.variables, x)
        strength = np.array([strength_of(part, scene) for part in self.site.parts]) / self._strength
        return np.array([self.goals.objective.material(scene), *strength])

    def depths(self, x: np.ndarray, storm: Storm) -> list[DepthUtilisation]:
        """Depths of a design at rest, all lines intact, in the water of a load case."""
        start = self.starts.at(x, replace(storm, broken=None))
        found = []
        for depth in self.goals.depths:
            r = np.asarray(start.rest.state.r)
            found += depth.utilisations(start.still.model, r, start.rest.dr, storm.level)
        return found

    def window(self, x: np.ndarray, window: Window) -> Peaks:
        """Peaks of a window of a design."""
        storm = window.case.storm
        scene = with_design(self.calm.scene, self.variables, x)
        sea = sea_of(self.calm, scene, window.case, WINDOW_RAMP, window.begin)
        start = self.starts.at(x, storm, window.starts_broken)
        return peaks(start, sea, self.quantities[storm.kind], self.window_run, window.height)

    def slopes(self, found: Sequence[Peaks], say: Progress, assumptions: bool = False) -> list[np.ndarray]:
        """Derivatives of the soft peaks of windows (q, p + a) by the variables, and by the assumptions if wanted, else
        0."""
        spans = [v.span for v in self.variables]
        sizes = WINDOW_DIFFERENCE_STEP * np.array([*spans, *[float(assumptions)] * len(ASSUMPTIONS)])
        return slopes(found, sizes, lambda done, of: say(done / of, f"derivatives: {done} of {of}"))

    def measure(self, x: np.ndarray, say: Progress) -> tuple[tuple[Window, ...], Values]:
        """Windows around the peak loads of the whole runs of a design, and its values by the hard peaks of these runs,
        without derivatives of storm quantities.

        Raises:
            SceneError: a run that failed.
        """
        scene = with_design(self.site.scene, self.variables, x)
        states = [self.starts.at(x, case.storm).rest.state for case in self.cases]

        def run_fully(i: int) -> Storms:
            case = self.cases[i]
            return full_storm(self.site, scene, case, self.quantities[case.storm.kind], states[i])

        full = self._run_parallel(run_fully, "whole runs", say)
        for storm in full:
            if storm.message:
                (steps,) = self.site.steps
                raise SceneError(f"design: {storm.message}. Use a smaller run.{steps}, or bounds nearer to the start")
        windows = [self._window_around_peak(case, storm) for case, storm in zip(self.cases, full, strict=True)]
        for i, soft in enumerate(self.run_windows(x, windows, say).windows):
            if not soft.solved:
                name = self.cases[i].storm.name
                raise SceneError(f"design: a window of {name} has steps that do not converge")
            windows[i] = replace(windows[i], factor=full[i].hard / soft.soft, height=soft.hard)
        hard = [storm.hard for storm in full]
        return tuple(windows), self._combine(x, hard, (), True)

    def _window_around_peak(self, case: Case, storm: Storms) -> Window:
        """The window around the peak of a whole run that is nearest to its limit; its scale factor comes later."""
        when = storm.when[np.argmax(storm.hard[: self.count_limited(case.storm.kind)])]
        last = max(self.site.run.duration - self.settings.window, 0.0)
        begin = float(np.clip(when - self.settings.before, 0.0, last))
        window = Window(case, begin, np.ones(len(storm.hard)))
        if case.storm.broken is None:
            return window
        # the first third is intact, so the impact of the break is in the window if the peak occurs soon enough
        broke = self.site.break_time - self.settings.window / 3
        if when <= broke + self.settings.window:
            return replace(window, begin=max(broke, 0.0))
        return replace(window, starts_broken=True)

    def _run_parallel(self, one: Callable[[int], Any], what: str, say: Progress) -> list[Any]:
        """`one` of the number of every case; a program that is not yet compiled runs alone the first time."""
        count = len(self.cases)
        found = {}

        def say_done(before: int, k: int) -> None:
            say((before + k) / count, f"{what}: {before + k} of {count}")

        for kind in self.site.kinds:
            own = [i for i, case in enumerate(self.cases) if case.storm.kind == kind]
            alone = int((what, kind) not in self._compiled)
            results = run_parallel(one, own, partial(say_done, len(found)), alone=alone)
            found |= dict(zip(own, results, strict=True))
            self._compiled.add((what, kind))
        return [found[i] for i in range(count)]

    def run_windows(self, x: np.ndarray, windows: Sequence[Window], say: Progress) -> WindowRuns:
        """Runs of the windows of a design, one of each case."""
        for window in windows:  # equilibria are made before threads ask for them
            self.starts.at(x, window.case.storm, window.starts_broken)
        found = self._run_parallel(lambda i: self.window(x, windows[i]), "windows", say)
        return WindowRuns(x, [window.factor for window in windows], found)

    def differentiate(self, runs: WindowRuns, say: Progress, assumptions: bool = False) -> WindowRuns:
        """Runs with derivatives by the variables, and by the assumptions if wanted; without any if a shifted run
        fails."""
        slopes = []
        for own, factor in zip(self.slopes(runs.windows, say, assumptions), runs.factors, strict=True):
            slopes.append(own * factor[:, None])
        if not all(np.isfinite(own).all() for own in slopes):
            return runs
        return replace(runs, slopes=slopes)

    def values(self, runs: WindowRuns) -> Values:
        """Objective and constraints of a design by its windows; derivatives of storms are 0 where they are unknown."""
        return self._combine(runs.x, runs.peaks, runs.slopes, runs.solved)

    def _combine(self, x: np.ndarray, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray], solved: bool) -> Values:
        """Objective and constraints from the quantities (q,) of every case and their slopes (q, p + a), 0 if empty."""
        if not slope:
            slope = [np.zeros((len(peaks), len(self.variables) + len(ASSUMPTIONS))) for peaks in hard]
        rows: list[tuple[str, float, np.ndarray]] = []
        by_seed: dict[str, np.ndarray] = {}
        (material, *strength), of_scene = self.scene_constraints(x)
        of_scene = np.pad(of_scene, ((0, 0), (0, len(ASSUMPTIONS))))
        hard, slope = over_strength(hard, slope, np.array(strength), of_scene[1:])
        seeds = len(self.site.seeds)
        for i, storm in enumerate(self.site.storms):
            own = slice(i * seeds, (i + 1) * seeds)  # seeds vary fastest
            peaks = np.array(hard[own])
            share = weights(peaks, self.site.run_of(storm))
            shares = share[:, :, None] * np.array(slope[own])
            for q in range(self.count_limited(storm.kind)):
                name = f"{self.quantities[storm.kind][q].name}: {storm.name}"
                rows.append((name, float(share[:, q] @ peaks[:, q]), shares[:, q].sum(axis=0)))
                by_seed[name] = seeds * shares[:, q]
        storms = list({storm.still: storm for storm in self.site.storms}.values())
        for storm, water in zip(storms, name_waters(storms), strict=True):
            label = f": {water}" if len(storms) > 1 else ""
            rows += [(name + label, near, by) for name, near, by in self.depths(x, storm)]
        names, value, slopes = zip(*rows, strict=True)
        objective = float(material)
        objective_slope = of_scene[0]
        if self.goals.objective.of != "material":
            objective, objective_slope = self._largest(hard, slope)
        return Values(objective, objective_slope, names, np.array(value), np.array(slopes), solved, by_seed)

    def _largest(self, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """The objective if it depends on storms: the maximum of all cases."""
        of = self.goals.objective
        # a motion is the last quantity
        q = -1 if of.of == "motion" else names_of(self.site.parts).index(of.part)
        intact = [i for i, case in enumerate(self.cases) if case.storm.broken is None]
        worst = max(intact, key=lambda i: hard[i][q])
        return hard[worst][q], slope[worst][q]
