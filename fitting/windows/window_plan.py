"""Time step and lengths of the windows of a fit, and the windows that a motion allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.error_growth import follow_motion, lyapunov, transitions
from fitting.estimate.first_starts import first_starts
from fitting.estimate.release import Release
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Starts, Windows, cut, fewest_frames, fill
from fitting.traces.trace import Trace
from fitting.windows.fit_settings import FitSettings
from fitting.windows.prepared import STEPS_PER_PERIOD, Samples, program_space

#: Shortest windows that are joined, as a fraction of the shortest link's period: links that whip at ten times the rate
#: of their own swing turn by less than one turn in it.
SHORTEST_WINDOW_PERIODS = 0.2
#: Length [m] of a link whose chain gets windows of at most one second.
ONE_SECOND_LINK = 0.1
#: Longest automatic window [s], and as a fraction of the trace.
LONGEST_WINDOW = 10.0
LONGEST_TRACE_PART = 0.125


@dataclass(frozen=True)
class WindowPlan:
    """Sizes of the windows.

    Attributes:
        dt: time step [s].
        length: maximum length of a window [s].
        short: number of steps of the short windows that are joined.
    """

    dt: float
    length: float
    short: int


def plan_windows(samples: Samples, simulator: Simulator, settings: FitSettings) -> WindowPlan:
    """Time step and length of the windows.

    Raises:
        SceneError: a requested window longer than the trace.
    """
    period = samples.period
    interval = samples.interval
    span = max(one.high - one.low for one in samples.spans)
    dt = time_step(samples.traces, settings.dt or period / STEPS_PER_PERIOD[simulator.stepper.integrator.order])
    fewest = fewest_frames(simulator.model.line.links, simulator.freedoms)
    short = max(SHORTEST_WINDOW_PERIODS * period, fewest * interval)
    link = float(np.mean(np.asarray(simulator.model.line.length)))
    length = settings.window or longest_window(simulator.freedoms // 2, link, span, short)
    if settings.window is not None and settings.window > span:
        raise SceneError(f"window: {settings.window:g} s is longer than the trace; allowed: at most {span:g} s")
    frame = max(1, round(interval / dt))
    frames = max(1, int(length / dt / frame + 1e-6))
    parts = max(1, int(length / short + 1e-6))
    return WindowPlan(dt, length, max(1, frames // parts) * frame)


def longest_window(freedoms: int, length: float, span: float, shortest: float) -> float:
    """Longest automatic window [s].

    It is a part of the span. A chain may be chaotic: its windows are also at most as long as the time scale of its
    links, one second for links of `ONE_SECOND_LINK` and growing as the root of their length.

    Args:
        length: of a link [m].
        span: [s].
        shortest: [s].
    """
    longest = min(LONGEST_WINDOW, LONGEST_TRACE_PART * span)
    if freedoms > 1:  # one angle cannot be chaotic
        longest = min(longest, np.sqrt(length / ONE_SECOND_LINK))
    return max(shortest, longest)


#: Maximum length of held-out spans, in windows, that run in the windows' own program, compiled with space for them.
LONGEST_HELD_OUT = 2.5


def program_capacity(samples: Samples, plan: WindowPlan) -> tuple[int, int]:
    """Steps and sample slots of the windows' programs."""
    end = max(trace.t[-1] for trace in samples.traces)
    length = max((min(high, end) - low for low, high in samples.held_out), default=0.0)
    if not plan.length < length < LONGEST_HELD_OUT * plan.length:
        length = plan.length
    return program_space(samples.traces, length, plan.dt)


#: Maximum turn of a link in a step [rad] at the start of a fit. The error of a fourth-order scheme in a window is then
#: below the usual noise; otherwise `refine` halves the step.
TURN_PER_STEP = 0.25
#: Fraction of the windows in which links turn by less.
TURN_QUANTILE = 0.98


def windows_along_motion(
    samples: Samples, simulator: Simulator, release: Release | None, plan: WindowPlan, values: np.ndarray
) -> tuple[Windows, Starts, float]:
    """Windows as long as the motion allows: short ones are run first and joined (`follow_motion`).

    Returns:
        The windows, the starts that their samples give, and the growth rate of small errors in the motion [1/s].
    """
    model = simulator.model
    sigma = samples.sigma
    fitted = samples.fitted
    windows = cut(samples.traces, plan.short * plan.dt, plan.dt, sigma, samples.spans)
    if release is not None:
        windows = release.mark(windows, samples.traces)
    starts = first_starts(model, fitted, windows, sigma)
    # subdivisions of a step in which the fastest link of nearly all windows turns by at most `TURN_PER_STEP`
    fastest = np.quantile(np.abs(starts.omega).max(axis=1), TURN_QUANTILE)
    halvings = max(0, int(np.ceil(np.log2(max(plan.dt * fastest / TURN_PER_STEP, 1e-9)))))
    windows = replace(windows, substeps=2**halvings)
    evaluation = simulator(values, starts, windows)
    move = transitions(simulator, evaluation, values)
    rate = lyapunov(windows, move)
    pieces = follow_motion(windows, move, int(plan.length / plan.dt + 1e-6))
    windows = replace(fill(samples.traces, pieces, plan.dt, sigma), substeps=windows.substeps)
    if release is not None:
        windows = release.mark(windows, samples.traces)
    return windows, first_starts(model, fitted, windows, sigma), rate


def check_step(traces: Sequence[Trace], dt: float) -> None:
    """Reject a requested step that is longer than the sampling interval.

    Between steps angles are interpolated. A step that skips samples is probably a mistyped one: the default is shorter
    than any motion that a camera can follow.
    """
    longest = max(trace.interval for trace in traces)
    if not dt <= longest * (1 + 1e-6):
        raise SceneError(f"dt: {dt:g} s is longer than the sampling interval; allowed: at most {longest:.4g} s")


#: Relative change of a step that rounded times of samples may cause.
TIME_ROUNDING = 1e-3


def time_step(traces: Sequence[Trace], requested: float) -> float:
    """The step [s] nearest below `requested` that divides the sampling interval, for uniform sampling.

    Times in files are rounded: a step may exceed `requested` by that rounding.
    """
    intervals = [round(trace.interval, 12) for trace in traces]
    if np.ptp(intervals) > 1e-9:
        return requested
    return max(intervals) / max(1, int(np.ceil(max(intervals) / requested - TIME_ROUNDING)))
