"""The packaged example: synthetic traces of scenarios A, B and C, fitted jointly from start values ten times off.

The traces are synthetic: the thesis' measured ones exist as figures only.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dropper_jax import load_scene
from fitting.fit import fit
from fitting.report import write_report
from fitting.result import FitResult
from fitting.synthetic import Camera, synthetic_traces
from fitting.traces import write_trace

SCENES = ("dropper-release-a", "dropper-release-b", "dropper-release-c")
TRUTH = {"effects.linear_damping.b_l": 0.002, "effects.quadratic_damping.b_q": 0.001}
TIMES_OFF = 10.0


def calibrate_synthetic(
    folder: str | Path,
    duration: float = 30.0,
    noise: float = 0.005,
    method: str = "shooting",
    progress: Callable[[float, str], None] | None = None,
) -> FitResult:
    """Make the three traces, fit them together, write traces and report to `folder`.

    Args:
        duration: of each trace [s].
        noise: of the angles [rad].
        method: see `fitting.fit`.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    scenes = [load_scene(name).with_values(TRUTH) for name in SCENES]
    traces = synthetic_traces(scenes, duration, Camera(angle_noise=noise))
    for trace in traces:
        write_trace(folder / f"{trace.name}.csv", trace)
    start = {name: TIMES_OFF * value for name, value in TRUTH.items()}
    result = fit(traces, SCENES[0], list(TRUTH), method=method, start=start, progress=progress)
    result.warnings.insert(0, "the traces are synthetic: simulated with known damping, seen with artificial noise")
    write_report(result, folder)
    return result
