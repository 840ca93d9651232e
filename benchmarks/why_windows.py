"""The picture of docs/statistics-of-fits.md: why one long run cannot be fitted, and windows can.

The loss against one parameter, by a single run and by windows, and the growth of its gradient.

python benchmarks/why_windows.py
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import command

from dropper_jax.plots import style
from fitting import prepare
from fitting.calibration.fit import estimate
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution
from fitting.estimate.windows import Starts, cut
from fitting.traces.synthetic import Camera, observe, simulate_truth

SCENE, NAME, TRUTH = "dropper-release-a", "effects.linear_damping.b_l", 0.002
PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "why_windows.png"
#: Long enough for the needle to show, short enough for a picture in a minute [s].
DURATION = 24.0
#: Values of b_l: over everything that could be, and around the truth.
VALUES = np.sort(np.concatenate([np.linspace(0.0, 0.01, 41), TRUTH * (1 + np.linspace(-0.1, 0.1, 41))]))


class Scan(NamedTuple):
    """Mean-square residuals over values of a parameter, and the sensitivity of the angles to it along one run.

    Attributes:
        values: (g,).
        single: mean-square residual of one run from the first sample on (g,), in units of the noise.
        windows: the same with windows whose starts follow the parameter (g,).
        t, sensitivity: times (S,) [s] and largest |d theta/d parameter| at the truth (S,).
    """

    values: np.ndarray
    single: np.ndarray
    windows: np.ndarray
    t: np.ndarray
    sensitivity: np.ndarray


def scan(prepared: Prepared, name: str, values: np.ndarray, best: Solution | None = None) -> Scan:
    """Both losses over values of one parameter, the others at their optimum; starts of windows refitted each time."""
    best = best or estimate(prepared, "shooting")
    index = [p.name for p in prepared.parameters].index(name)
    simulator, windows = prepared.simulator, prepared.windows
    span = windows.length * int(windows.count)
    whole = cut(prepared.traces, span, windows.dt, prepared.sigma)
    start = Starts(best.starts.theta[:1], best.starts.omega[:1])
    problem = prepared.problem(frozen=np.ones(len(prepared.parameters), bool))
    single, separate, starts = [], [], best.starts
    for value in values:
        at = best.values.copy()
        at[index] = value
        run = simulator(at, start, whole)
        single.append(float(np.mean(run.residual**2)))
        found = fit_windows(problem, at, starts, iterations=6)
        separate.append(2 * found.cost / windows.samples)
    run = simulator(best.values, start, whole)
    column = run.jacobian[0, :, :, simulator.freedoms + index] / np.maximum(whole.weight[0], 1e-300)
    return Scan(np.asarray(values), np.array(single), np.array(separate), whole.times()[0], np.abs(column).max(axis=1))


def draw_scan(found: Scan, name: str, truth: float | None, path: str | Path) -> Path:
    """One picture: loss of single shooting, loss of windows, growth of the gradient."""
    with style.plot_style():
        figure = style.new_figure(9.5, 3.4)
        left, right = figure.subplots(1, 2)
        left.semilogy(found.values, found.single, color=style.SECOND, marker=".", ms=3, label="one long run")
        left.semilogy(found.values, found.windows, color=style.FIRST, label="windows, starts eliminated")
        if truth is not None:
            left.axvline(truth, color=style.FAINT, lw=0.8)
        left.set_xlabel(name)
        left.set_ylabel("mean square residual / noise²")
        left.legend()
        right.semilogy(found.t, np.maximum(found.sensitivity, 1e-3), color=style.SECOND, lw=0.8)
        right.set_xlabel("time [s]")
        right.set_ylabel(f"largest |d angle / d {name.rsplit('.', 1)[-1]}|")
        return style.save(figure, path)


@command()
def main() -> None:
    trace = observe(simulate_truth(SCENE, DURATION), Camera(angle_noise=0.005), 0)
    prepared = prepare(trace, SCENE, [NAME], window=1.0)
    found = scan(prepared, NAME, np.unique(VALUES), estimate(prepared, "shooting"))
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    print(draw_scan(found, NAME, TRUTH, PICTURE))
