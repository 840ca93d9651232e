"""The evaluated part of a run: finite, after the transient, line by line."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.run.samples import Samples
from dropper_jax.run.step_extremes import SIGNALS
from dropper_jax.scene import LineSlice, WholeLine, whole_lines
from dropper_jax.scene.data import point_nodes
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
    def least(self) -> np.ndarray:
        """Minimum tensions (q, n) [N] over the steps since the previous sample."""
        return self.extremes["tension"].least

    @property
    def largest(self) -> np.ndarray:
        """Maximum tensions (q, n) [N] over the steps since the previous sample."""
        return self.extremes["tension"].largest

    @property
    def scene(self) -> Scene:
        return self.solution.scene

    @property
    def lines(self) -> tuple[LineSlice, ...]:
        return self.solution.lines

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
        """Whether the run started in its computed equilibrium."""
        return self.scene.start.is_static and self.scene.start.release_nodes is None

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
    arrays = (solution.positions, solution.velocities, solution.tension)
    finite = [np.isfinite(a).all(axis=tuple(range(1, a.ndim))) for a in arrays]
    good = np.logical_and.reduce([*finite, solution.step_status == 0])
    last = len(good) if good.all() else int(np.argmin(good))
    if last < len(good):
        notes.append(f"the run is invalid from t = {solution.t[last]:.6g} s: only the time before is reported")
    if solution.failure:
        notes.append(f"the run ended with {solution.failure}")
    begin = float(solution.t[0]) + skip
    kept = slice(int(np.searchsorted(solution.t[:last], begin - 1e-9)), last)
    rows = np.arange(len(solution.t))[kept]
    rows = rows[rows > 0]
    if len(rows) < 3 or kept.stop - kept.start < 3:
        raise SceneError(
            f"{solution.scene.name}: {kept.stop - kept.start} good samples after {skip:g} s; "
            "needed: at least 3. Use a longer run or a smaller --skip"
        )
    if skip == 0:
        notes.append("the statistics include the start-up transient. Use --skip to leave it out")
    if solution.saved_rows:
        known = "percentiles, angles and fatigue are of saved values; extremes of loads are those of all steps"
        lost = "by an earlier version: peaks between samples are not included"
        notes.append(f"{solution.saved_rows}: {lost if solution.tension_max is None else known}")
    tension = np.asarray(solution.tension[rows], float)
    if solution.tension_square is None:
        square = tension**2
    else:
        square = np.asarray(solution.tension_square[rows], float)
    extremes = {}
    for signal in SIGNALS:
        extremes[signal] = Extremes(*(np.asarray(a[rows], float) for a in solution.step_extremes(signal)))
    return Record(
        solution,
        t=np.asarray(solution.t[kept], float),
        positions=np.asarray(solution.positions[kept], float),
        velocities=np.asarray(solution.velocities[kept], float),
        t_tension=np.asarray(solution.t_tension[rows], float),
        tension=tension,
        square=square,
        extremes=extremes,
        notes=tuple(notes),
    )


def spread(values: np.ndarray, names: tuple[str, ...] = ("min", "mean", "std", "max")) -> dict[str, float]:
    """Minimum, mean, standard deviation and maximum, or some of them."""
    return {name: float(getattr(np, name)(values)) for name in names}


def arc(lengths: np.ndarray) -> np.ndarray:
    """Unstretched arc length (n,) [m] of the middles of links from the line's first end."""
    return np.cumsum(lengths) - 0.5 * np.asarray(lengths, float)
