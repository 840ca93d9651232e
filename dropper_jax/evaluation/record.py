"""The evaluated part of a run: finite, after the transient, line by line."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.quantities.end_links import Motion
from dropper_jax.quantities.variables import STEP_SIGNALS
from dropper_jax.run.samples import Samples
from dropper_jax.scene import WholeLine, whole_lines
from dropper_jax.scene.slices import point_nodes
from dropper_jax.stepping.extremes import Extremes


@dataclasses.dataclass(frozen=True)
class Record:
    """The evaluated samples (k) of the arrays of a run; see `Solution` for their meaning.

    Attributes:
        tension: (q, n) [N] at `t_tension` (q,) [s]: q is k, or k - 1 if the start of the run is left out.
        square: mean squares [N^2] of each sample (q, n): those since the previous sample if steps adapt to snap loads,
            else those of the tension.
        extremes: of tensions, end forces and loads of fixed points, over the steps since the previous sample; see
            `Solution.step_extremes`.
        notes: one line for each omission or fault.
    """

    solution: Samples
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    t_tension: np.ndarray
    tension: np.ndarray
    square: np.ndarray
    extremes: dict[str, Extremes]
    notes: tuple[str, ...]

    @property
    def scene(self) -> Scene:
        return self.solution.scene

    @property
    def motion(self) -> Motion:
        """The evaluated nodes and tensions."""
        return Motion(self.scene, self.t, self.positions, self.t_tension, self.tension)

    @cached_property
    def written_lines(self) -> tuple[WholeLine, ...]:
        """The lines as in the scene, which the report uses."""
        return whole_lines(self.scene)

    @cached_property
    def acceleration(self) -> np.ndarray:
        """Acceleration (k, nodes) [m/s^2] of the nodes, by central differences of the saved velocities."""
        return np.linalg.norm(np.gradient(self.velocities, self.t, axis=0), axis=-1)

    @property
    def duration(self) -> float:
        """Time that the record spans [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def interval(self) -> float:
        """Time between saved samples [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def static_start(self) -> bool:
        """Whether the first row of the run is its computed equilibrium; that of a continued run is not."""
        start = self.scene.start
        return start.is_static and start.release_nodes is None and not self.solution.continues

    def point(self, name: str) -> np.ndarray:
        """Positions (k, 3) [m] of a point."""
        return self.positions[:, point_nodes(self.scene)[name]]


def record(solution: Samples, skip: float = 0.0) -> Record:
    """The finite part of a run after `skip` [s].

    The tension at the start is not that of a step and is left out.

    Raises:
        SceneError: fewer than three samples are left.
    """
    notes = [f"warning of the run: {warning}" for warning in solution.warnings]
    good = good_samples(solution)
    last = len(good)
    if not good.all():
        last = int(np.argmin(good))
        notes.append(f"the run is invalid from t = {solution.t[last]:.6g} s: only the time before is reported")
    if solution.failure:
        notes.append(f"the run ended with {solution.failure}")
    first = int(np.searchsorted(solution.t[:last], float(solution.t[0]) + skip - 1e-9))
    kept = slice(first, last)
    rows = slice(max(first, 1), last)
    count = max(last - rows.start, 0)
    if count < 3:
        raise SceneError(
            f"{solution.scene.name}: {count} good samples after {skip:g} s, without that of the start; "
            "needed: at least 3. Use a longer run or a smaller --skip"
        )
    if skip == 0:
        notes.append("the statistics include the start-up transient. Use --skip to leave it out")
    if solution.saved_rows:
        note = "percentiles, angles and fatigue are of saved values; extremes of loads are those of all steps"
        if solution.tension_max is None:
            note = "by an earlier version: peaks between samples are not included"
        notes.append(f"{solution.saved_rows}: {note}")
    samples = {name: np.array(getattr(solution, name)[kept], float) for name in ("t", "positions", "velocities")}
    samples |= {name: np.array(getattr(solution, name)[rows], float) for name in ("t_tension", "tension")}
    square = samples["tension"] ** 2
    if solution.tension_square is not None:
        square = np.array(solution.tension_square[rows], float)
    extremes = {}
    for signal in STEP_SIGNALS:
        extremes[signal] = Extremes(*(np.array(a[rows], float) for a in solution.step_extremes(signal)))
    return Record(solution, **samples, square=square, extremes=extremes, notes=tuple(notes))


def good_samples(solution: Samples) -> np.ndarray:
    """Which samples (k,) are finite, and of steps that succeeded."""
    good = solution.step_status == 0
    for array in (solution.positions, solution.velocities, solution.tension):
        good &= np.isfinite(array).reshape(len(array), -1).all(axis=1)
    return good


def arc(lengths: np.ndarray) -> np.ndarray:
    """Unstretched arc length (n,) [m] of the middles of links from the line's first end."""
    return np.cumsum(lengths) - 0.5 * np.asarray(lengths, float)
