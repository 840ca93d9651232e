"""Definition of a hard case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.run.build import build
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.study.march import Marched, Scheme, grid_run, link_vectors, status_of
from dropper_jax.study.work_precision import energy_loss


@dataclass(frozen=True)
class Watched:
    """A scene with a claim on the motion of one point, so that other simulators can be measured as well.

    Attributes:
        scene, dt, duration: what is run, at which step [s] and how long [s].
        point: name of the point.
        measure: the quantity limited by the claim, from times (k,) [s] and positions (k, 3) [m].
        drive: displacement (3,) [m] over time of the prescribed points that `end_motion` moves.
    """

    scene: Scene
    dt: float
    duration: float
    point: str
    measure: Callable[[np.ndarray, np.ndarray], float]
    drive: Callable[[float], np.ndarray] | None = None


@dataclass(frozen=True)
class Outcome:
    """What was measured, the status it ended with, and what others run: (scene, dt, duration) for the thesis' schemes,
    what is watched for MoorDyn, where these apply."""

    measured: float
    status: str
    compare: tuple[Scene, float, float] | None = None
    watched: Watched | None = None


@dataclass(frozen=True)
class Case:
    """A hard case: a claim in words, its limit, and how it is measured (`measure(short)`: shortened for the tests).

    It holds where the measured number is at most the limit and the status is `expected`.
    """

    name: str
    claim: str
    limit: float
    unit: str
    measure: Callable[[bool], Outcome]
    expected: str = "ok"


SAVES = 40
#: Baselines: the thesis' unknowns, and its weighting with the unknowns of this package; as published, without halving.
BASELINES = (
    Scheme("thesis_angles", 0.51),
    Scheme("thesis_angles", 0.5),
    Scheme("theta", 0.51),
    Scheme("theta", 0.5),
)
#: Maximum duration of the baselines [s]: failures occur early.
BASELINE_SPAN = 10.0
#: Maximum number of unknowns of the dense systems of the baselines.
BASELINE_LINKS = 20
#: Energy balance error over the energy scale above which a completed run is marked as wrong.
WRONG = 0.1


@dataclass(frozen=True)
class CaseRun:
    """A run of a case at `SAVES` times t [s]."""

    model: Model
    start: State
    run: Marched
    status: str
    t: np.ndarray

    @property
    def energy_drift(self) -> float:
        """Maximum change of energy minus all work [J]."""
        return float(np.max(np.abs(energy_loss(self.model, self.start, self.run, self.t))))

    @property
    def energy_scale(self) -> float:
        """Maximum kinetic energy, or the potential energy of the maximum change of height [J]."""
        mass = np.asarray(self.model.line.mass)[: self.model.free_nodes, None]
        speeds = np.concatenate([np.asarray(self.start.v)[None], self.run.v])
        heights = np.concatenate([np.asarray(self.start.r)[None], self.run.r])[:, :, 2:]
        kinetic = 0.5 * np.max(np.sum(mass * speeds**2, axis=(1, 2)))
        return float(max(kinetic, np.ptp(GRAVITY * np.sum(mass * heights, axis=(1, 2)))))

    @property
    def relative_drift(self) -> float:
        """Energy drift over the scale."""
        return self.energy_drift / max(self.energy_scale, 1e-300)

    @property
    def closure(self) -> float:
        """Maximum error of a link's length [m]."""
        sizes = np.linalg.norm(link_vectors(self.model, self.run.r, self.t), axis=-1)
        return float(np.max(np.abs(sizes - np.asarray(self.model.line.length))))


def run_case(scene: Scene, dt: float, duration: float, scheme: Scheme | None = None, **settings: Any) -> CaseRun:
    """Simulate a scene for `duration` [s] (rounded to whole steps between `SAVES` saved times)."""
    scheme = scheme or Scheme("energy_momentum")
    model, s = build(scene, scheme.dtype)
    stepper = scheme.stepper(model, **settings)
    every = max(1, round(duration / dt / SAVES))
    run = grid_run(stepper, model, s, every * dt, every, SAVES)
    if scheme.dtype != "float64":
        model, s, run = (jax.tree.map(_wide, x) for x in (model, s, run))
    return CaseRun(model, s, run, status_of(run, stepper), every * dt * np.arange(1, SAVES + 1))


def _wide(x: ArrayLike) -> ArrayLike:
    return np.asarray(x, float) if np.asarray(x).dtype == np.float32 else x


def baselines(scene: Scene, dt: float, duration: float) -> dict[str, Any]:
    """Status of the thesis' schemes on a case, by label: {status, failed_at_s, energy_drift_share}.

    `status` is that of a solution; `wrong_energy` marks a run that did not fail but lost or gained more than 10 %.
    """
    return {scheme.label: _baseline(scene, dt, duration, scheme) for scheme in BASELINES}


def _baseline(scene: Scene, dt: float, duration: float, scheme: Scheme) -> dict[str, Any]:
    if scene.lines[0].links > BASELINE_LINKS:
        return {"status": "not_run", "reason": f"dense systems of {5 * scene.lines[0].links} unknowns"}
    try:
        ran = run_case(scene, dt, min(duration, BASELINE_SPAN), scheme, halvings=0)
    except SceneError as error:
        return {"status": "refused", "reason": str(error)}
    if ran.status != "ok":
        return {"status": ran.status, "failed_at_s": (int(ran.run.bad[-1]) + 1) * dt}
    share = ran.relative_drift
    return {"status": "ok", "energy_drift_share": share, "wrong_energy": bool(share > WRONG)}


def watch(name: str, claim: str, limit: float, unit: str, make: Callable[[bool], Watched]) -> Case:
    """A case with a measure of the path of a point; `make(short)` gives the scene and the point."""

    def measure(short: bool) -> Outcome:
        watched = make(short)
        return outcome(simulate(watched.scene, dt=watched.dt, duration=watched.duration), watched)

    return Case(name, claim, limit, unit, measure)


def outcome(run: Solution, watched: Watched) -> Outcome:
    """The measured value of a run; infinite if the run did not complete."""
    measured = watched.measure(run.t, run.point_path(watched.point)) if run.status == "ok" else float("inf")
    return Outcome(measured, run.status, watched=watched)


def relative_drift(run: Solution) -> Outcome:
    """The drift of the energy balance of a run over its energy scale."""
    return Outcome(run.energy_drift / run.energy_scale, run.status)


def rise(t: np.ndarray, positions: np.ndarray) -> float:
    """The measure of a path: its maximum height above its start [m]."""
    return float(np.max(positions[:, 2]) - positions[0, 2])


def distance_from(
    exact: Callable[[np.ndarray], np.ndarray], size: float, from_start: bool = False
) -> Callable[[np.ndarray, np.ndarray], float]:
    """The measure of a path: its maximum distance from `exact` at times (k,), over `size` [m].

    `exact` gives heights (k,), or positions (k, 2) in the plane y = 0; with `from_start` from the first one on.
    """

    def measure(t: np.ndarray, positions: np.ndarray) -> float:
        wanted = exact(t)
        found = positions[:, [0, 2]] if wanted.ndim == 2 else positions[:, 2:]
        found = found - from_start * found[0]
        return float(np.max(np.linalg.norm(found - wanted.reshape(found.shape), axis=1))) / size

    return measure
