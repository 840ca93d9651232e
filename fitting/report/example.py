"""The packaged example: synthetic traces of scenarios A, B and C, fitted jointly from values wrong by a factor 10.

The traces are synthetic: the measured ones of the thesis exist as figures only. `dropper demo` runs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dropper_jax import load_scene
from dropper_jax.base.markdown import Rows
from dropper_jax.base.progress import Progress, part_of
from fitting.calibration.fit import fit
from fitting.calibration.result import FitResult
from fitting.report.report import write_report
from fitting.traces.synthetic import Camera, synthetic_traces
from fitting.traces.trace_file import write_trace

LABEL = "the traces are synthetic: simulated with known damping and artificial noise"


@dataclass(frozen=True)
class Example:
    """Settings of the synthetic data: scenes, true damping, observation, and error of the start values.

    Attributes:
        duration: of each trace [s].
        noise: of the angles [rad].
        times_off: ratio of start values to true values.
    """

    scenes: tuple[str, ...] = ("dropper-release-a", "dropper-release-b", "dropper-release-c")
    b_l: float = 0.002
    b_q: float = 0.001
    duration: float = 48.0
    noise: float = 0.005
    times_off: float = 10.0

    @property
    def truth(self) -> dict[str, float]:
        """True values by path."""
        return {"effects.linear_damping.b_l": self.b_l, "effects.quadratic_damping.b_q": self.b_q}

    @property
    def start(self) -> dict[str, float]:
        """Start values by path."""
        return {name: self.times_off * value for name, value in self.truth.items()}


EXAMPLE = Example()
#: Fractions of the progress at which the traces are made, and the fit has ended.
TRACES_MADE = 0.4
FIT_ENDED = 0.91


def calibrate_synthetic(
    folder: Path,
    example: Example,
    progress: Progress,
) -> FitResult:
    """Make the traces, fit them together, write traces and report to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    scenes = [load_scene(name).with_values(example.truth) for name in example.scenes]
    traces = synthetic_traces(
        scenes,
        example.duration,
        Camera(angle_noise=example.noise),
        progress=part_of(progress, 0.0, TRACES_MADE),
    )
    for trace in traces:
        write_trace(folder / f"{trace.name}.csv", trace)
    result = fit(
        traces,
        example.scenes[0],
        list(example.truth),
        start=example.start,
        progress=part_of(progress, TRACES_MADE, FIT_ENDED),
    )
    result.warnings.insert(0, LABEL)
    progress(FIT_ENDED, "report")
    write_report(result, folder)
    progress(1.0, result.status)
    return result


def calibrated_rows(result: FitResult, example: Example) -> Rows:
    """Truth, start, estimate and 90 % interval of every parameter, with a heading."""
    u = result.uncertainty
    rows = [("parameter", "truth", "start", "fitted", "std error", "90 % low", "high", "unit")]
    for i, p in enumerate(result.parameters):
        numbers = (example.truth[p.name], p.value, result.values[i], u.std_error[i], u.low[i], u.high[i])
        rows.append((p.name, *(f"{x:.4g}" for x in numbers), p.unit))
    return rows
