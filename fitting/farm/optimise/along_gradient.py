"""Check of a design's derivatives: two runs of a window along the gradient of its highest peak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.study.gradient_check import GradientCheck, check_gradient
from fitting.farm.optimise.design_problem import DesignProblem
from fitting.farm.optimise.windows import Window


def along_error(along: GradientCheck) -> float:
    """Relative error of the derivative along the gradient."""
    return abs(along.ratio - 1.0)


def along_text(along: GradientCheck) -> str:
    """What two runs along the gradient show."""
    return f"two runs along the gradient change the highest peak by {along.ratio:.3g} of what it predicts"


def check_along(problem: DesignProblem, say: Progress = silent) -> GradientCheck:
    """Two runs of a window along the gradient of its highest peak, by 0.5 % of the variables' ranges, at the start of a
    design: the worst window."""
    say(0.0, "two runs along the gradient")
    found = [_check_window(problem, window) for window in first_windows(problem)]
    return max(found, key=lambda one: np.nan_to_num(along_error(one), nan=np.inf))


def _check_window(problem: DesignProblem, window: Window) -> GradientCheck:
    """Two runs of one window."""
    runs = problem.storm_runs
    peaks = runs.run_window(problem.start, window)
    (slopes,) = runs.differentiate_peaks([peaks], silent)
    highest = np.argmax(peaks.hard)
    span = np.array([v.span for v in problem.variables])

    def peak(x: np.ndarray) -> float:
        return runs.run_window(np.asarray(x), window).soft[highest]

    return check_gradient(peak, problem.start, slopes[highest, : len(span)], span)


def first_windows(problem: DesignProblem) -> list[Window]:
    """A window of one case of each kind, from the start of the storm."""
    windows = []
    for kind, quantities in problem.quantities.items():
        case = next(case for case in problem.cases if case.storm.kind == kind)
        begin = Window(case, 0.0, np.ones(len(quantities)))
        windows.append(replace(begin, height=problem.storm_runs.run_window(problem.start, begin).hard))
    return windows
