"""Runs of a case step by step, without the checks of `simulate`, and the thesis' schemes on the same case."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build
from dropper_jax.stability.case import Case, scene_of
from dropper_jax.study.march import GridRun, grid_run
from dropper_jax.study.schemes import Scheme

#: Saved times of a run.
SAVES = 40
OURS = Scheme("energy_momentum")
#: Baselines: the thesis' unknowns, and its weighting with the unknowns of this package; as published, without halving.
BASELINES = (
    Scheme("thesis_angles", 0.51),
    Scheme("thesis_angles", 0.5),
    Scheme("theta", 0.51),
    Scheme("theta", 0.5),
)
#: Maximum number of links for the dense systems of the baselines.
BASELINE_LINKS = 20
#: Energy balance error over the energy scale above which a completed run is marked as wrong.
WRONG_BALANCE = 0.1
#: Below this energy scale [J] nothing moves: the drift over it is then large, not a division by zero.
NO_ENERGY = 1e-300


class CaseRun(GridRun):
    """A run of a case at `SAVES` times."""

    @property
    def positions(self) -> np.ndarray:
        """Positions of the free nodes (k + 1, nodes, 3) [m], including the start."""
        return np.concatenate([np.asarray(self.start.r)[None], self.r])

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of the free nodes (k + 1, nodes, 3) [m/s], including the start."""
        return np.concatenate([np.asarray(self.start.v)[None], self.rows.v])

    @property
    def energy_drift(self) -> float:
        """Maximum change of energy minus all work [J]."""
        return np.max(np.abs(self.energy_loss))

    @property
    def relative_drift(self) -> float:
        """Energy drift over the maximum kinetic energy, or the potential energy of the maximum change of height."""
        mass = np.asarray(self.model.line.mass)[: self.model.free_nodes, None]
        kinetic = 0.5 * np.max(np.sum(mass * self.velocities**2, axis=(1, 2)))
        potential = GRAVITY * np.sum(mass * self.positions[:, :, 2:], axis=(1, 2))
        return self.energy_drift / max(float(kinetic), float(np.ptp(potential)), NO_ENERGY)

    @property
    def closure(self) -> float:
        """Maximum error of a link's length [m]."""
        return np.max(np.abs(np.linalg.norm(self.links, axis=-1) - np.asarray(self.model.line.length)))


def run_scene(scene: Scene, dt: float, duration: float, scheme: Scheme, **settings: Any) -> CaseRun:
    """Run a scene for `duration` [s] (rounded to whole steps between `SAVES` saved times)."""
    model, s = build(scene, scheme.dtype)
    every = max(1, round(duration / dt / SAVES))
    run = grid_run(scheme.stepper(model, **settings), model, s, every * dt, every, SAVES)
    rows = run.rows
    if scheme.dtype != "float64":
        model, s, rows = jax.tree.map(_wide, (model, s, rows))
    return CaseRun(run.stepper, model, s, run.t, rows)


def _wide(x: ArrayLike) -> ArrayLike:
    """Numbers of single precision in double precision."""
    if np.asarray(x).dtype == np.float32:
        return np.asarray(x, float)
    return x


@lru_cache(maxsize=2)
def run_named(scene: str, dt: float, duration: float, dtype: str = "float64") -> CaseRun:
    """The run of a scene of the catalogue, the same for cases that are measured on one run."""
    return run_scene(scene_of(scene), dt, duration, Scheme(OURS.integrator, dtype=dtype))


def baselines(case: Case) -> Table | None:
    """Status of the thesis' schemes on a case, by label: {status, failed_at_s, energy_drift_share}.

    `status` is that of a solution; `wrong_energy` marks a run that did not fail but lost or gained more than 10 %.
    """
    if case.baseline is None:
        return None
    return {scheme.label: _baseline(case, case.baseline, scheme) for scheme in BASELINES}


def _baseline(case: Case, duration: float, scheme: Scheme) -> Table:
    """Status and energy of one scheme on a case, if it can run it."""
    scene = scene_of(case.scene)
    links = scene.lines[0].links
    if links > BASELINE_LINKS:
        return {"status": "not_run", "reason": f"dense systems of {5 * links} unknowns"}
    try:
        ran = run_scene(scene, case.dt, duration, scheme, halvings=0)
    except SceneError as error:
        return {"status": "refused", "reason": str(error)}
    if ran.status != "ok":
        return {"status": ran.status, "failed_at_s": (int(ran.rows.bad[-1]) + 1) * case.dt}
    share = ran.relative_drift
    return {"status": "ok", "energy_drift_share": share, "wrong_energy": bool(share > WRONG_BALANCE)}
