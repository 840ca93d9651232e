"""Start of a run from the model: at rest in the static pose, released at an instant that may be unknown.

A released window has no start of its own. Its pose theta_s solves the static equations under the force that holds the
line. It therefore depends on the parameters p (masses, lengths, ends, the force itself), with a derivative:

    theta(t) = theta_s(p) for t <= tau,     theta_s from the implicit function theorem, see `statics.static_pose.settle`

The run is simulated from the release tau on. Its steps are stretched so that the last one ends with the window,
h = dt (1 - (tau - t0)/T): every angle then depends smoothly on tau.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Generic, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax import statics
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from fitting.estimate.static_poses import StaticPoses
from fitting.estimate.windows import ArrayType, Starts, Windows, pick
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import ReleaseTarget
from fitting.traces import planar
from fitting.traces.trace import Trace

RELEASE_TIME = "release.time"
RELEASE_FORCE = "release.force"
RELEASE_NAMES = (RELEASE_TIME, RELEASE_FORCE)
#: Number of release times tried for a first guess.
TRIED_TIMES = 21
#: Minimum stretch of a step [-]: only steps that a fit will not accept go below it.
LEAST_STRETCH = 0.1
AXES = ("x", "y", "z")
#: Maximum distance of a release from the start of its window, as a fraction of the window.
RELEASE_REACH = 0.5


class ReleaseState(NamedTuple, Generic[ArrayType]):
    """Whether a window is released, its start [s] and run, and the derivative of theta_s by p (n, k); or K of each."""

    released: ArrayType
    begin: ArrayType
    run: ArrayType
    slope: ArrayType


class ReleasedStarts(NamedTuple):
    """Angles and rates (K, n) and charts (K, n, m) at the starts of K windows, and what is released of each."""

    theta: np.ndarray
    omega: np.ndarray
    basis: np.ndarray
    state: ReleaseState[np.ndarray]


@dataclass(frozen=True)
class Release:
    """The start of every run.

    Attributes:
        runs: number of runs.
        nodes: released nodes, counted from 1.
        force: holding force [N] (nodes, 3).
        given: the scene's own start, if it has given angles instead of a static pose.
    """

    runs: int
    nodes: tuple[int, ...]
    force: np.ndarray
    given: State | None = None

    def parameters(self, name: str, option: str) -> list[Parameter]:
        """Parameters of `release.time[.RUN]` or `release.force[.RUN[.NODE.AXIS]]`; without AXIS those not zero."""
        known = {p.name: p for p in self._all()}
        if name in known:
            return [known[name]]
        found = [p for key, p in known.items() if key.startswith(name + ".") and (p.value or RELEASE_TIME in key)]
        if found:
            return found
        if name.startswith(RELEASE_FORCE) and not self.nodes:
            raise SceneError(f"{option}: {name!r}: the scene releases no node. Use [start] with release_nodes")
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(name, [*RELEASE_NAMES, *known])}")

    def _all(self) -> list[Parameter]:
        """The times of all runs, and the forces on all released nodes in the plane."""
        times = [Parameter(f"{RELEASE_TIME}.{i}", ReleaseTarget(i, "time"), 0.0, unit="s") for i in range(self.runs)]
        forces = []
        for i, (j, node), c in product(range(self.runs), enumerate(self.nodes), (0, 2)):
            where = ReleaseTarget(i, "force", 3 * j + c)
            forces.append(Parameter(f"{RELEASE_FORCE}.{i}.{node}.{AXES[c]}", where, float(self.force[j, c]), unit="N"))
        return times + forces

    def times(self, parameters: Sequence[Parameter], values: Array) -> Array:
        """Instants of release (runs,) [s] on the traces' clocks; 0 if they are not free."""
        times = [jnp.zeros((), values.dtype)] * self.runs
        for run, i in _free_times(parameters).items():
            times[run] = values[i]
        # not by `.at[].set`, which cannot be part of one kernel
        return jnp.stack(times)

    def late(self, parameters: Sequence[Parameter], p: Array, release_state: ReleaseState[Array]) -> Array:
        """Time from the start of a window to its release [s]; 0 for windows that are not released."""
        late = self.times(parameters, p)[release_state.run] - release_state.begin
        return jnp.where(release_state.released, late, 0.0)

    def static_poses(self, model: Model, parameters: Sequence[Parameter]) -> StaticPoses:
        """The poses in which runs of a model with these parameters start."""
        return StaticPoses(model, parameters, "static start: {}", partial(self._loads, parameters))

    def start_windows(
        self, poses: StaticPoses, values: np.ndarray, starts: Starts, basis: np.ndarray, windows: Windows
    ) -> ReleasedStarts:
        """The windows' starts and charts (K, n, m) with the released ones at the model's own pose, which has none.

        Raises:
            SceneError: no static pose at the start values.
        """
        theta = starts.theta.copy()
        omega = starts.omega.copy()
        basis = basis.copy()
        slope = np.zeros((windows.count, theta.shape[1], len(values)))
        for k in np.flatnonzero(windows.released):
            basis[k] = 0.0
            if self.given is None:
                theta[k], slope[k] = poses.pose(values, int(windows.run[k]))
                omega[k] = 0.0
            else:
                theta[k], omega[k] = planar.from_nodes(poses.model, self.given.r, self.given.v)
        return ReleasedStarts(theta, omega, basis, ReleaseState(windows.released, windows.begin, windows.run, slope))

    def _loads(self, parameters: Sequence[Parameter], model: Model, values: Array, run: int) -> Array:
        """Forces (nodes, 3) [N] that hold a run."""
        force = jnp.asarray(self.force, model.dtype).reshape(-1)
        for i, p in enumerate(parameters):
            if isinstance(p.where, ReleaseTarget) and (p.where.run, p.where.field) == (run, "force"):
                force = force.at[p.where.entry].set(values[i])
        return statics.nodal_loads(model, list(self.nodes), force.reshape(-1, 3))

    def mark(self, windows: Windows, traces: Sequence[Trace]) -> Windows:
        """The windows with the first one of every run released.

        Raises:
            SceneError: a run whose start is not fitted.
        """
        released = np.zeros(windows.count, bool)
        for run, trace in enumerate(traces):
            first = np.flatnonzero((windows.run == run) & (np.abs(windows.begin - trace.t[0]) < 0.5 * windows.dt))
            if not len(first):
                raise SceneError(f"static start: the fit omits the start of {trace.name}. Include its start")
            released[first] = True
        return replace(windows, released=released)

    def bound_times(self, parameters: Sequence[Parameter], windows: Windows) -> tuple[Parameter, ...]:
        """The parameters, with every release time limited to half a window from its run's first sample.

        Raises:
            SceneError: a release outside this range.
        """
        reach = RELEASE_REACH * windows.length
        found = list(parameters)
        free = _free_times(parameters)
        for k in np.flatnonzero(windows.released):
            run = int(windows.run[k])
            t0 = float(windows.begin[k])
            value = found[free[run]].value if run in free else 0.0
            if abs(value - t0) > reach:
                raise SceneError(
                    f"static start: released at {value:g} s, but run {run} starts at {t0:g} s; "
                    f"allowed: {t0 - reach:g} to {t0 + reach:g} s. Cut or shift the trace"
                )
            if run in free:
                p = found[free[run]]
                found[free[run]] = replace(p, low=max(p.low, t0 - reach), high=min(p.high, t0 + reach))
        return tuple(found)

    def guess(
        self,
        residuals: Callable[[np.ndarray, Starts, Windows], np.ndarray],
        parameters: Sequence[Parameter],
        windows: Windows,
        starts: Starts,
        values: np.ndarray,
    ) -> np.ndarray:
        """The values (k,) with the release times that fit each run's first window best, of `TRIED_TIMES` in bounds."""
        index = _free_times(parameters)
        if not index:
            return values
        which = np.flatnonzero(windows.released)
        few = windows.pick(which)
        first = pick(starts, which)
        tries = np.tile(values, (TRIED_TIMES, 1))
        times = [*index.values()]
        low, high = np.array([(parameters[i].low, parameters[i].high) for i in times]).T
        tries[:, times] = np.linspace(low, high, TRIED_TIMES)
        costs = np.array([np.sum(residuals(tried, first, few) ** 2, axis=(1, 2)) for tried in tries])
        costs = np.where(np.isnan(costs), np.inf, costs)
        found = values.copy()
        for run, cost in zip(few.run, costs.T, strict=True):
            best = np.argmin(cost)
            if run in index and np.isfinite(cost[best]):
                found[index[run]] = tries[best, index[run]]
        return found


def _free_times(parameters: Sequence[Parameter]) -> dict[int, int]:
    """The parameter that is the release time of a run, by run; runs without a free time are omitted."""
    found = {}
    for i, p in enumerate(parameters):
        if isinstance(p.where, ReleaseTarget) and p.where.field == "time":
            found[p.where.run] = i
    return found


def release_of(scene: Scene, state: State, runs: int) -> Release:
    """The release of this number of runs, all from the scene's own start.

    Raises:
        SceneError: a scene that releases no node.
    """
    start = scene.start
    if start.kind != "static":
        return Release(runs, (), np.zeros((0, 3)), state)
    if not start.release_nodes:
        raise SceneError("static start: the scene releases no node. Use [start] with release_nodes")
    return Release(runs, tuple(start.release_nodes), np.asarray(start.release_force, float))
