"""Runs of the storms of a design: whole ones, and windows around their peak loads with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.base.progress import Progress
from dropper_jax.scene.run import DEFAULT_ACCURACY
from fitting.farm.optimise.calm_model import ASSUMPTIONS, sea_of
from fitting.farm.optimise.full_storm import StormPeaks, run_full_storm
from fitting.farm.optimise.quantities import LimitedSignal
from fitting.farm.optimise.run_starts import RunStarts
from fitting.farm.optimise.settings import WINDOW_RAMP, SearchSettings
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.optimise.window_peaks import Peaks, WindowSettings, differentiate_peaks, run_window
from fitting.farm.optimise.windows import Window, WindowRuns
from fitting.farm.site import Case, Site
from fitting.farm.site.site import LONGEST_INTERVAL

#: Change of a variable up and down in derivatives of windows, relative to its range, and of the assumptions.
#: Differences to one side are not enough: near a leg that is almost taut they are off by more than half.
WINDOW_DIFFERENCE_STEP = 2e-3


@dataclass(frozen=True)
class StormRuns:
    """Runs of the load cases of a site for any design.

    Attributes:
        starts: equilibria of any design, from which the runs start.
        quantities: that have peaks, by kind of state (`Storm.kind`).
        limited: of these the number with a limit, which come first.
        compiled: programs that were run before, by name and kind.
    """

    site: Site
    variables: tuple[Variable, ...]
    settings: SearchSettings
    starts: RunStarts
    quantities: dict[str, tuple[LimitedSignal, ...]]
    limited: dict[str, int]
    compiled: set[tuple[str, str]] = field(default_factory=set)

    @cached_property
    def window_settings(self) -> WindowSettings:
        """Windows follow the accuracy of the site's runs, or the default one where these take equal steps."""
        steps = self.site.prepared().run
        interval = min(steps.interval, LONGEST_INTERVAL)
        return WindowSettings(self.settings.window, interval, steps.accuracy or DEFAULT_ACCURACY)

    def run_window(self, x: np.ndarray, window: Window) -> Peaks:
        """Peaks of a window of a design."""
        storm = window.case.storm
        site = self.starts.intact_site
        sea = sea_of(site, with_design(site.scene, self.variables, x), window.case, WINDOW_RAMP, window.begin)
        start = self.starts.at(x, storm, window.starts_broken)
        return run_window(start, sea, self.quantities[storm.kind], self.window_settings, window.height)

    def run_windows(self, x: np.ndarray, windows: Sequence[Window], say: Progress) -> WindowRuns:
        """Runs of the windows of a design, one of each case."""
        for window in windows:  # equilibria are made before threads ask for them
            self.starts.at(x, window.case.storm, window.starts_broken)
        found = self._run_cases(lambda i: self.run_window(x, windows[i]), "windows", say)
        return WindowRuns(x, [window.factor for window in windows], found)

    def differentiate_peaks(self, found: Sequence[Peaks], say: Progress, assumptions: bool = False) -> list[np.ndarray]:
        """Derivatives of the soft peaks of windows (q, p + a) by the variables, and by the assumptions if wanted, else
        0."""
        spans = [v.span for v in self.variables]
        sizes = WINDOW_DIFFERENCE_STEP * np.array([*spans, *[float(assumptions)] * len(ASSUMPTIONS)])
        return differentiate_peaks(found, sizes, lambda done, of: say(done / of, f"derivatives: {done} of {of}"))

    def differentiate(self, runs: WindowRuns, say: Progress, assumptions: bool = False) -> WindowRuns:
        """Runs with derivatives by the variables, and by the assumptions if wanted; without any if a shifted run
        fails."""
        slopes = []
        for own, factor in zip(self.differentiate_peaks(runs.windows, say, assumptions), runs.factors, strict=True):
            slopes.append(own * factor[:, None])
        if not all(np.isfinite(own).all() for own in slopes):
            return runs
        return replace(runs, slopes=slopes)

    def run_full_storms(self, x: np.ndarray, say: Progress) -> list[StormPeaks]:
        """Peaks of the whole run of every case of a design.

        Raises:
            SceneError: a run that failed.
        """
        scene = with_design(self.site.scene, self.variables, x)
        states = [self.starts.at(x, case.storm).rest.state for case in self.site.cases]

        def run_storm(i: int) -> StormPeaks:
            case = self.site.cases[i]
            return run_full_storm(self.site, scene, case, self.quantities[case.storm.kind], states[i])

        found = self._run_cases(run_storm, "whole runs", say)
        for storm in found:
            if storm.message:
                (steps,) = self.site.steps
                raise SceneError(f"design: {storm.message}. Use a smaller run.{steps}, or bounds nearer to the start")
        return found

    def choose_windows(self, x: np.ndarray, full_runs: Sequence[StormPeaks], say: Progress) -> tuple[Window, ...]:
        """Windows around the peak loads of the whole runs of a design, with the ratios of their peaks to those of the
        windows.

        Raises:
            SceneError: a window that failed.
        """
        found = [self._window_around_peak(case, storm) for case, storm in zip(self.site.cases, full_runs, strict=True)]
        for i, soft in enumerate(self.run_windows(x, found, say).windows):
            if not soft.solved:
                name = self.site.cases[i].storm.name
                raise SceneError(f"design: a window of {name} has steps that do not converge")
            found[i] = replace(found[i], factor=full_runs[i].hard / soft.soft, height=soft.hard)
        return tuple(found)

    def _window_around_peak(self, case: Case, storm: StormPeaks) -> Window:
        """The window around the peak of a whole run that is nearest to its limit; its scale factor comes later."""
        when = storm.when[np.argmax(storm.hard[: self.limited[case.storm.kind]])]
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

    def _run_cases(self, one: Callable[[int], Any], what: str, say: Progress) -> list[Any]:
        """`one` of the number of every case; a program that is not yet compiled runs alone the first time."""
        count = len(self.site.cases)
        found = {}

        def say_done(before: int, k: int) -> None:
            say((before + k) / count, f"{what}: {before + k} of {count}")

        for kind in self.site.kinds:
            own = [i for i, case in enumerate(self.site.cases) if case.storm.kind == kind]
            alone = int((what, kind) not in self.compiled)
            results = run_parallel(one, own, partial(say_done, len(found)), alone=alone)
            found |= dict(zip(own, results, strict=True))
            self.compiled.add((what, kind))
        return [found[i] for i in range(count)]
