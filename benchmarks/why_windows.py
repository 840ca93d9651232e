"""The picture of docs/statistics-of-fits.md: why one long run cannot be fitted, and windows can.

The loss against one parameter, by a single run and by windows, and the growth of its gradient.

python benchmarks/why_windows.py
"""

from pathlib import Path

import numpy as np
from study import command

from dropper_jax.plots import style
from fitting import Camera, observe, prepare, simulate_truth
from fitting.calibration.fit import estimate
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution
from fitting.estimate.windows import Starts, cut

SCENE, NAME, TRUTH = "dropper-release-a", "effects.linear_damping.b_l", 0.002
PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "why_windows.png"
#: Long enough for the needle to show, short enough for a picture in a minute [s].
DURATION = 24.0
#: Values of b_l: over everything that could be, and around the truth.
VALUES = np.unique([*np.linspace(0.0, 0.01, 41), *(TRUTH * (1 + np.linspace(-0.1, 0.1, 41)))])


def scan(prepared: Prepared, best: Solution) -> tuple[list[float], list[float], np.ndarray, np.ndarray]:
    """Mean-square residuals in units of the noise at `VALUES`, times [s], the largest sensitivity of the angles then.

    The first are those of one run from the first sample on, the second those of windows, whose starts are refitted at
    every value. The sensitivity |d theta/d b_l| (samples,) is that of the run at the optimum.
    """
    simulator, windows = prepared.simulator, prepared.windows
    whole = cut(prepared.traces, float(np.sum(windows.lengths)), windows.dt, prepared.sigma)
    start = Starts(best.starts.theta[:1], best.starts.omega[:1])
    problem = prepared.problem(frozen=np.ones(1, bool))
    single, separate = [], []
    for value in VALUES:
        single.append(float(np.mean(simulator(np.array([value]), start, whole).residual ** 2)))
        found = fit_windows(problem, np.array([value]), best.starts, iterations=6)
        separate.append(2 * found.cost / windows.samples)
    slopes = simulator(best.values, start, whole).jacobian[0, :, :, simulator.freedoms]
    sensitivity = np.abs(slopes / np.maximum(whole.weight[0], 1e-300)).max(axis=1)
    return single, separate, whole.times()[0], sensitivity


@command()
def main() -> None:
    trace = observe(simulate_truth(SCENE, DURATION), Camera(angle_noise=0.005), 0)
    prepared = prepare(trace, SCENE, [NAME], window=1.0)
    single, separate, t, sensitivity = scan(prepared, estimate(prepared, "shooting"))
    with style.plot_style():
        figure = style.new_figure(9.5, 3.4)
        left, right = figure.subplots(1, 2)
        left.semilogy(VALUES, single, color=style.SECOND, marker=".", ms=3, label="one long run")
        left.semilogy(VALUES, separate, color=style.FIRST, label="windows, starts eliminated")
        left.axvline(TRUTH, color=style.FAINT, lw=0.8)
        left.set(xlabel=NAME, ylabel="mean square residual / noise²")
        left.legend()
        right.semilogy(t, np.maximum(sensitivity, 1e-3), color=style.SECOND, lw=0.8)
        right.set(xlabel="time [s]", ylabel="largest |d angle / d b_l|")
        print(style.save(figure, PICTURE))
