"""Cases of a sweep scored against one measured trace, part by part, as the thesis' sections 8.2 and 8.3 do by eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax import load_scene
from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.base.errors import SceneError
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import SceneLike, build
from dropper_jax.run.storage import extra
from fitting.sweep.axes import changes_size, read_values
from fitting.sweep.plan import STATUS, Plan
from fitting.sweep.run import SweepResult, run_at, sweep
from fitting.traces.conventions import check_scale, settle_convention
from fitting.traces.planar import check_planar, wrap
from fitting.traces.trace import Convention, Trace, check_trace
from fitting.traces.trace_file import as_trace

TRACE_PARTS = ("head", "middle", "tail")
#: End of head and middle, as fractions of the trace: 12 and 25 s of the thesis' 50 s (its Figure 8.1).
PART_ENDS = (0.24, 0.5)
#: Minimum number of samples of a part, for a meaningful amplitude spectrum.
FEWEST_SAMPLES = 10
#: Distance from the nearest known sample, in sampling intervals, beyond which an angle counts as missing. Times of
#: runs and samples differ by at most half an interval; the rest allows for rounded times in files.
FARTHEST_SAMPLE = 0.75


@dataclass(frozen=True)
class Against:
    """Reference data for the comparison of runs.

    Attributes:
        trace: angles [rad] from the horizontal, positive downwards.
        t, measured: samples (k,) [s] and (k, n) [rad], NaN if missing.
        interpolated: the same, interpolated where samples are missing.
        ends: end times [s] of head, middle and tail.
    """

    trace: Trace
    t: np.ndarray
    measured: np.ndarray
    interpolated: np.ndarray
    ends: tuple[float, float, float]

    def part(self, index: int) -> slice:
        """The samples of head (0), middle (1) or tail (2)."""
        edges = np.searchsorted(self.t, (0.0, *self.ends[:-1], np.inf))
        return slice(edges[index], edges[index + 1])

    def score(self, simulated: np.ndarray) -> np.ndarray:
        """RMS angle error and distance of spectra (2, 3) [rad] of simulated angles (k, n); NaN of a run that failed.

        Both are defined in `TraceScores`.
        """
        found = np.full((2, len(TRACE_PARTS)), np.nan)
        if not np.isfinite(simulated).all():
            return found
        for i in range(len(TRACE_PARTS)):
            part = self.part(i)
            found[0, i] = np.sqrt(np.nanmean(wrap(simulated[part] - self.measured[part]) ** 2))
            apart = self.spectrum(simulated, i)[1] - self.spectrum(self.interpolated, i)[1]
            found[1, i] = np.sqrt(np.mean(np.sum(apart**2, axis=0)) / 2)
        return found

    def spectrum(self, x: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (m,) [Hz] and amplitudes (m, n) [rad] of angles (k, n) in a part."""
        return amplitude_spectrum(self.t[self.part(index)], x[self.part(index)])


@dataclass(frozen=True)
class TraceScores:
    """Deviation of each case of a sweep from a trace.

    Attributes:
        against: the trace.
        sweep: result of the sweep.
        values: of the cases (cases, axes).
        status: of the cases (cases,), indices of `STATUS`.
        angle: RMS angle error (cases, 3) [rad] over the links and samples of a part, as shortest turns.
        spectrum: distance of amplitude spectra (cases, 3) [rad]: `sqrt(sum_m (A_m - B_m)^2 / 2)` of a link's measured
            and simulated amplitudes (Hann window), RMS over the links.
        best: case with the smallest RMS angle error of the head, where the motion is large.
        simulated: its angles (k, n) [rad].
        warnings: about the reading of the trace.
    """

    against: Against
    sweep: SweepResult
    values: np.ndarray
    status: np.ndarray
    angle: np.ndarray
    spectrum: np.ndarray
    best: int
    simulated: np.ndarray
    warnings: list[str]

    @property
    def paths(self) -> tuple[str, ...]:
        """What is varied."""
        return tuple(axis.path for axis in self.sweep.plan.axes)

    def best_of(self, part: int, by: str = "angle") -> int:
        """Case with the best score of a part, by `angle` or `spectrum`."""
        return int(np.nanargmin(getattr(self, by)[:, part]))

    def run_at(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Angles (k, n) [rad] of one more run, at other values (axes,) such as fitted ones; NaN if it fails."""
        plan = self.sweep.plan
        return link_angles(plan, run_at(plan, np.asarray(values, float))["positions"][0])

    def to_json(self) -> Table:
        """Plain values."""
        cases = []
        for values, status, angle, spectrum in zip(self.values, self.status, self.angle, self.spectrum, strict=True):
            named = dict(zip(self.paths, values, strict=True))
            cases.append({"values": named, "status": STATUS[status], **by_part(angle, spectrum)})
        best = {}
        for i, part in enumerate(TRACE_PARTS):
            best[part] = {"angle": self.best_of(i), "spectrum": self.best_of(i, "spectrum")}
        return jsonable(
            {
                "name": self.against.trace.name,
                "samples": len(self.against.t),
                "parts_s": dict(zip(TRACE_PARTS, pairwise((0.0, *self.against.ends)), strict=True)),
                "cases": cases,
                "best": best,
            }
        )


@dataclass(frozen=True)
class FittedScore:
    """A fit of the varied inputs to the same trace: status, values and standard errors (axes,), and one run at them.

    Attributes:
        simulated: angles (k, n) [rad] of that run.
        angle, spectrum: its scores (3,) [rad].
    """

    paths: tuple[str, ...]
    status: str
    values: np.ndarray
    errors: np.ndarray
    simulated: np.ndarray
    angle: np.ndarray
    spectrum: np.ndarray

    @classmethod
    def of(cls, scores: TraceScores, status: str, values: np.ndarray, errors: np.ndarray) -> FittedScore:
        """A run with the fit's values from the scene's start, like the cases."""
        simulated = scores.run_at(values)
        return cls(scores.paths, status, values, errors, simulated, *scores.against.score(simulated))

    def to_json(self) -> Table:
        """Plain values."""
        values = dict(zip(self.paths, self.values, strict=True))
        errors = dict(zip(self.paths, self.errors, strict=True))
        found = {"status": self.status, "values": values, "std_errors": errors}
        return jsonable(found | by_part(self.angle, self.spectrum))


def by_part(angle: np.ndarray, spectrum: np.ndarray) -> dict[str, dict[str, float]]:
    """Scores (3,) [rad] by the names of parts; NaN for a case that failed."""
    found = {}
    for part, a, s in zip(TRACE_PARTS, angle, spectrum, strict=True):
        found[part] = {"angle_rms_rad": a, "spectrum_distance_rad": s}
    return found


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


def link_angles(plan: Plan, positions: np.ndarray) -> np.ndarray:
    """Polar angles (k, n) [rad] of the links, without jumps, of free nodes (k, nodes, 3) [m] of a case."""
    model = plan.base[0]
    ends = model.ends(jnp.zeros((), model.dtype))
    link = np.asarray(jax.vmap(lambda free: model.links(free, ends))(positions))
    return np.unwrap(np.arctan2(-link[..., 2], link[..., 0]), axis=0)
