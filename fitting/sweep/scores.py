"""Scores of runs against one measured trace, part by part, as the thesis' sections 8.2 and 8.3 do by eye."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from fitting.sweep.plan import STATUS, Plan
from fitting.sweep.run import SweepResult, run_extra_case
from fitting.traces.planar import wrap
from fitting.traces.trace import Trace

TRACE_PARTS = ("head", "middle", "tail")


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

    def run_extra_case(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Angles (k, n) [rad] of one more run, at other values (axes,) such as fitted ones; NaN if it fails."""
        plan = self.sweep.plan
        return link_angles(plan, run_extra_case(plan, np.asarray(values, float))["positions"][0])

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
        simulated = scores.run_extra_case(values)
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


def link_angles(plan: Plan, positions: np.ndarray) -> np.ndarray:
    """Polar angles (k, n) [rad] of the links, without jumps, of free nodes (k, nodes, 3) [m] of a case."""
    model = plan.base[0]
    ends = model.ends(jnp.zeros((), model.dtype))
    link = np.asarray(jax.vmap(lambda free: model.links(free, ends))(positions))
    return np.unwrap(np.arctan2(-link[..., 2], link[..., 0]), axis=0)
