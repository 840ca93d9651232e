"""Sweeps over the span of a measured trace, with a score of every case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax import load_scene
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import SceneLike, build
from dropper_jax.run.storage import extra
from fitting.sweep.axes import changes_size, read_values
from fitting.sweep.run import SweepResult, sweep
from fitting.sweep.scores import TRACE_PARTS, Against, TraceScores, link_angles
from fitting.traces.conventions import check_scale, settle_convention
from fitting.traces.planar import check_planar
from fitting.traces.trace import Convention, Trace, check_trace
from fitting.traces.trace_file import as_trace

#: End of head and middle, as fractions of the trace: 12 and 25 s of the thesis' 50 s (its Figure 8.1).
PART_ENDS = (0.24, 0.5)
#: Minimum number of samples of a part, for a meaningful amplitude spectrum.
FEWEST_SAMPLES = 10
#: Distance from the nearest known sample, in sampling intervals, beyond which an angle counts as missing. Times of
#: runs and samples differ by at most half an interval; the rest allows for rounded times in files.
FARTHEST_SAMPLE = 0.75


def sweep_against_trace(
    scene: SceneLike,
    vary: Mapping[str, Sequence[float]],
    trace: str | Path | Trace,
    out: str | Path,
    *,
    parts: Sequence[float] | None = None,
    integrator: str | None = None,
    until: float | None = None,
    convention: Convention = Convention(),  # noqa: B008 - frozen
    columns: Mapping[str, str] | None = None,
    **settings: Any,
) -> TraceScores:
    """Run every case from the scene's start over the span of a trace, and score it against the trace.

    The release is at t = 0 of the trace's clock. Steps are at most the scene's and divide the samples' interval.

    Args:
        scene, vary, out: as in `sweep`.
        trace: CSV file or `Trace`.
        parts: times [s] at which the head and the middle end; default `PART_ENDS` of the trace.
        integrator: default rattle_4 for point masses, whose error is below a camera's noise; otherwise the scene's.
        until: samples from this time [s] on are not compared.
        convention: angle convention of the trace; default from the file, otherwise inferred from the scene.
        columns: the file's columns if they have other names, as for `read_trace`.
        **settings: further arguments of `sweep`.

    Raises:
        SceneError: a trace of other links or without angles, a scene that leaves its plane, parts outside the trace.
        SweepStopped: as in `sweep`.
    """
    scene = load_scene(scene)
    model, start = build(scene)
    check_planar(model, start)
    _check_varied(scene, vary)
    trace = as_trace(trace, model.line.links, columns)
    check_scale(trace, model, convention)
    trace, warnings = settle_convention(trace, model, convention)
    if until is None:
        until = np.inf
    trace = trace.between(0.0, until)
    check_trace(trace)
    if integrator is None and Rattle4().refuse(model) is None:
        integrator = "rattle_4"
    if integrator is not None:
        scene = scene.with_values({"run.integrator": integrator})
    scene = at_samples(scene, trace)
    t = (1 + np.arange(scene.run.saves)) * scene.run.step * scene.run.save_every
    against = Against(trace, t, sample_trace(trace, t), trace.at(t), part_ends(t, parts))
    _check_parts(against)
    return _score_cases(against, sweep(scene, vary, out, traces=True, **settings), warnings)


def _check_parts(against: Against) -> None:
    """Reject a part of the trace in which every sample is missing: no case has a score there."""
    for i, part in enumerate(TRACE_PARTS):
        if not np.isfinite(against.measured[against.part(i)]).any():
            raise SceneError(f"{against.trace.name}: every sample of the {part} is missing. Use other `parts`")


def _check_varied(scene: Scene, vary: Mapping[str, Sequence[float]]) -> None:
    """Reject paths that move an end of the line or change its number of links: the trace has neither."""
    for path, values in vary.items():
        if path.startswith("point."):
            raise SceneError(f"vary: {path!r} moves an end. With a trace, use paths outside [[point]]")
        if "." in path and changes_size(scene, path, read_values(path, values)):
            raise SceneError(f"vary: {path!r} changes the number of links, which is that of the trace. Use other paths")


def _score_cases(against: Against, result: SweepResult, warnings: list[str]) -> TraceScores:
    """The scores of all cases of a sweep, and the angles of the best one."""
    plan = result.plan
    scores = np.full((2, plan.cases, len(TRACE_PARTS)), np.nan)
    stored = extra("zarr", "sweep").open_group(result.path, mode="r")
    for case in range(plan.cases):
        scores[:, case] = against.score(link_angles(plan, stored["positions"][case]))
    head = scores[0, :, 0]
    if not np.isfinite(head).any():
        raise SceneError("vary: no case ran to its end. Use values for which the scene runs, or a smaller --dt")
    best = int(np.nanargmin(head))
    simulated = link_angles(plan, stored["positions"][best])
    cases = plan.inputs(np.arange(plan.cases))
    return TraceScores(against, result, cases, stored["status"][:], *scores, best, simulated, warnings)


def at_samples(scene: Scene, trace: Trace) -> Scene:
    """The scene adapted to a trace: it runs over its span, saves at its sample interval, with steps that divide it."""
    span = float(trace.t[-1] - trace.t[0])
    interval = span / round(span / trace.interval)  # times in files are rounded
    every = max(1, int(np.ceil(interval / scene.run.step - 1e-9)))
    duration = max(1, round(float(trace.t[-1]) / interval)) * interval
    return scene.with_values({"run.dt": interval / every, "run.save_every": every, "run.duration": duration})


def sample_trace(trace: Trace, t: np.ndarray) -> np.ndarray:
    """Angles (k, n) [rad] at times (k,); NaN if no known sample is near."""
    found = trace.at(t)
    for known, column in zip(np.isfinite(trace.theta).T, found.T, strict=True):
        times = trace.t[known]
        nearest = times[np.rint(np.interp(t, times, np.arange(len(times)))).astype(int)]
        column[np.abs(t - nearest) > FARTHEST_SAMPLE * trace.interval] = np.nan
    return found


def part_ends(t: np.ndarray, parts: Sequence[float] | None) -> tuple[float, float, float]:
    """End times [s] of head, middle and tail of samples at `t`.

    Raises:
        SceneError: two times that do not split the samples into three parts.
    """
    last = float(t[-1])
    ends = [last * part for part in PART_ENDS]
    if parts is not None:
        ends = [float(part) for part in parts]
    counts = [0]
    if len(ends) == 2 and 0.0 <= ends[0] <= ends[1]:
        counts = np.histogram(t, [0.0, *ends, np.inf])[0]
    if min(counts) < FEWEST_SAMPLES:
        given = ",".join(f"{end:g}" for end in ends)
        raise SceneError(
            f"parts: {given}: allowed: two increasing times within the trace's {last:g} s, "
            f"with at least {FEWEST_SAMPLES} samples in each of the three parts"
        )
    return ends[0], ends[1], last
