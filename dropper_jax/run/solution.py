"""The solution of a run: arrays, status and provenance."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.analysis.angles import link_angles
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.json_values import SCHEMA, jsonable
from dropper_jax.base.read import Plain
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.scene import Scene
from dropper_jax.run.bends import bending_moment, bending_summary, bends, curvature
from dropper_jax.run.extents import body_extents, extent, largest_size
from dropper_jax.run.rows import let_go
from dropper_jax.run.twists import torque
from dropper_jax.scene import LineSlice, line_places, line_slices, whole_lines

if TYPE_CHECKING:
    import xarray

#: Version of the saved file; a file that says otherwise is refused.
FORMAT = 1

ARRAYS = (
    "t",
    "positions",
    "velocities",
    "tension",
    "t_tension",
    "kinetic",
    "potential",
    "work",
    "step_status",
)
#: Arrays of runs whose steps follow the snaps.
WITHIN = ("tension_min", "tension_max", "tension_square")
#: Arrays of runs with rigid bodies.
BODIES = ("body_position", "body_attitude", "body_velocity", "body_rates")


@dataclasses.dataclass
class Solution:
    """What a run gives, k saved times, n links.

    Attributes:
        scene: what was simulated.
        settings: integrator, solver, dt, duration, steps, dtype, gamma, rho_infinity, residual_tolerance,
            save_every; with a tolerance also `estimated_error` {rms_angle_rad, until_s}; with errors `load_errors`
            (see `study.load_errors`).
        t: saved times (k,) [s].
        positions, velocities: all nodes, both ends included, (k, n + 1, 3) [m], [m/s]; of a system of lines the nodes
            of all lines, line after line (points where lines join stand once per line), see `lines`.
        tension: (k, n) [N] at the times `t_tension` (k,) [s] (the step's midpoint in midpoint schemes).
        kinetic, potential: energies (k,) [J].
        work: work done since the start (k, w) [J] by each of `work_names`.
        step_status: 0 where every step up to the saved time is good.
        status: `ok` or the named failure.
        failed_steps, retried_steps: counts.
        first_bad: step, time_s, residual and reason of the first bad step, or None.
        max_residual: largest scaled residual of a step.
        max_closure_error: largest error of a rigid link's length [m].
        compile_s, run_s: wall time [s].
        versions: of the packages that matter.
        warnings: one line each.
        broken: what broke, by time: line, link (from 1), time_s, tension_n.
        tension_min, tension_max, tension_square: with a step tolerance the extremes of the tensions since the last
            saved time (k, n) [N] and the means of their squares [N^2]; else None. `tension` then is their mean.
        body_position, body_attitude: of each rigid body its reference point (k, bodies, 3) [m], and roll, pitch and yaw
            [rad]; None without.
        body_velocity, body_rates: velocity of the reference point [m/s], angular velocity in the scene's axes [rad/s].
        own: what effects changed as the run went on, by effect (k, ...); `NAME.0`, `NAME.1` ... of one with several.
        last: the whole state at the end, from which `continued` goes on; empty of a run that failed.
        continues: of a run that went on from another what its times count from: `origin_s`, and the `saves` behind its
            first one; else None.
    """

    scene: Scene
    settings: dict[str, Any]
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    tension: np.ndarray
    t_tension: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    work_names: tuple[str, ...]
    step_status: np.ndarray
    status: str = "ok"
    failed_steps: int = 0
    retried_steps: int = 0
    first_bad: dict[str, Any] | None = None
    max_residual: float = 0.0
    max_closure_error: float = 0.0
    compile_s: float = 0.0
    run_s: float = 0.0
    versions: dict[str, str] = dataclasses.field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    broken: tuple[dict[str, Any], ...] = ()
    own: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    last: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    continues: dict[str, Any] | None = None
    tension_min: np.ndarray | None = None
    tension_max: np.ndarray | None = None
    tension_square: np.ndarray | None = None
    body_position: np.ndarray | None = None
    body_attitude: np.ndarray | None = None
    body_velocity: np.ndarray | None = None
    body_rates: np.ndarray | None = None

    @property
    def lines(self) -> tuple[LineSlice, ...]:
        """The scene's lines in the arrays: `positions[:, line.nodes]`, `tension[:, line.links]`."""
        return line_slices(self.scene)

    def point_path(self, name: str) -> np.ndarray:
        """Positions (k, 3) [m] of a point of the scene.

        Raises:
            SceneError: there is no such point.
        """
        for line, where in zip(self.scene.lines, self.lines, strict=True):
            for point, node in ((line.start, where.nodes.start), (line.end, where.nodes.stop - 1)):
                if point == name:
                    return self.positions[:, node]
        raise SceneError(f"point: {name!r} is not a point; {nearest(name, [p.name for p in self.scene.points])}")

    def body(self, name: str) -> dict[str, np.ndarray]:
        """Motion of a rigid body by the names of `BODIES`, each (k, 3).

        Raises:
            SceneError: there is no such body.
        """
        names = [body.name for body in self.scene.bodies]
        if name not in names:
            raise SceneError(f"body: {name!r} is not a body; {nearest(name, names)}")
        return {key: getattr(self, key)[:, names.index(name)] for key in BODIES}

    def body_summary(self) -> dict[str, dict[str, Any]]:
        """Of each body the least, mean, largest and final x, y, z [m], roll, pitch and yaw [rad]."""
        moved = {body.name: self.body(body.name) for body in self.scene.bodies}
        return {name: body_extents(one["body_position"], one["body_attitude"]) for name, one in moved.items()}

    @property
    def energy(self) -> np.ndarray:
        """Kinetic and potential energy (k,) [J]."""
        return self.kinetic + self.potential

    @property
    def balance(self) -> np.ndarray:
        """Energy minus the work of damping and applied forces (k,) [J]; constant in an exact solution."""
        return self.energy - np.sum(self.work, axis=1)

    @property
    def energy_drift(self) -> float:
        """Largest change of the balance since the start [J]."""
        with np.errstate(invalid="ignore"):  # a run that failed may hold infinities
            return float(np.max(np.abs(self.balance - self.balance[0])))

    @property
    def energy_scale(self) -> float:
        """What to compare the drift with [J]: range of the potential, or the largest kinetic energy if larger."""
        return float(max(np.ptp(self.potential), np.max(self.kinetic)))

    @property
    def max_speed(self) -> float:
        """Largest speed of a node [m/s]."""
        return largest_size(self.velocities)

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Polar angle from the horizontal and azimuth of each link, (k, n) [rad] each, continuous in time."""
        parts = []
        for line in self.lines:
            parts.append(link_angles(self.positions[:, line.nodes], zero="horizontal"))
            let_go([self.positions])
        return tuple(np.concatenate(found, axis=1) for found in zip(*parts, strict=True))

    @property
    def polar(self) -> np.ndarray:
        """Polar angles (k, n) [rad], zero at the horizontal."""
        return self.angles[0]

    @property
    def azimuth(self) -> np.ndarray:
        """Azimuths (k, n) [rad]."""
        return self.angles[1]

    @cached_property
    def curvature(self) -> np.ndarray | None:
        """Curvature (k, nodes) [1/m] where lines have bending stiffness (see `run.bends`); else None."""
        return curvature(self.scene, self.positions) if bends(self.scene) else None

    @cached_property
    def bending_moment(self) -> np.ndarray | None:
        """Bending moment (k, nodes) [N m] where lines have bending stiffness; else None."""
        return bending_moment(self.scene, self.positions, self.t, self.broken) if bends(self.scene) else None

    @property
    def twist(self) -> np.ndarray | None:
        """Twist (k, nodes) [rad] about the axes of lines with torsion; else None."""
        return self.own.get("torsion.0")

    @cached_property
    def torque(self) -> np.ndarray | None:
        """Torque (k, n) [N m] of links with torsion; else None."""
        if self.twist is None:
            return None
        return torque(self.scene, self.positions, self.twist, self.own["torsion.1"])

    @property
    def us_per_step(self) -> float:
        """Wall time of a step without compilation [us]; of a run that stopped, over its good steps."""
        done = (len(self.t) - 1) * self.settings.get("save_every", 1)
        if "refused_steps" in self.settings:
            done = self.settings["steps"] + self.settings["refused_steps"]
        return 1e6 * self.run_s / max(done, 1)

    @property
    def realtime_factor(self) -> float:
        """Simulated time over wall time without compilation."""
        return float(self.t[-1] - self.t[0]) / self.run_s if self.run_s > 0 else math.nan

    @property
    def failure(self) -> str:
        """One line saying which step failed, when and why; empty where none did."""
        if self.status == "ok":
            return ""
        if self.status == "energy_drift":
            what = f"{self.energy_drift:.3g} J are not accounted for, of a scale of {self.energy_scale:.3g} J"
            return f"{self.status}: {what}; take a smaller step"
        if self.first_bad is None:
            return f"{self.status}: at t = {self.t[-1]:.6g} s of {self.settings['duration']:g} s"
        bad = self.first_bad
        return (
            f"{self.status}: step {bad['step']} at t = {bad['time_s']:.6g} s, scaled residual {bad['residual']:.3g}: "
            f"{bad['reason']}"
        )

    def tension_summary(self) -> dict[str, dict[str, float]]:
        """min, mean, max and final tension [N] of the first, the last and all links; `final` of all is their mean."""
        parts = {"first": slice(0, 1), "last": slice(-1, None), "all": slice(None)}
        return {name: self._extent(part) for name, part in parts.items()}

    def line_tensions(self) -> dict[str, dict[str, float]]:
        """The same of every line of the scene, pieces between attached points together."""
        return {line.name: self._extent(line.links) for line in whole_lines(self.scene)}

    def _extent(self, links: slice | np.ndarray) -> dict[str, float]:
        found = extent(self.tension[:, links])
        if self.tension_min is None or self.tension_max is None:
            return found
        extremes = np.min(self.tension_min[:, links]), np.max(self.tension_max[:, links])
        return {**found, "min": float(extremes[0]), "max": float(extremes[1])}

    def summary(self) -> dict[str, Any]:
        """The JSON object of a run; NaN and infinity are null."""
        keys = (
            "integrator",
            "solver",
            "dtype",
            "dt",
            "duration",
            "steps",
            *OPTIONS,
            "residual_tolerance",
            "save_every",
        )
        found = {
            "schema": SCHEMA,
            "status": self.status,
            "scene": self.scene.name,
            **{key: self.settings.get(key) for key in keys},
            **{
                key: self.settings[key]
                for key in ("step_tolerance", "error_tolerance", "refused_steps", "load_errors")
                if key in self.settings
            },
            "failed_steps": self.failed_steps,
            "retried_steps": self.retried_steps,
            "first_bad": self.first_bad,
            "max_residual": self.max_residual,
            "max_closure_error_m": self.max_closure_error,
            "energy_drift_j": self.energy_drift,
            "energy_scale_j": self.energy_scale,
            "work_j": dict(zip(self.work_names, self.work[-1], strict=True)),
            "max_speed_m_per_s": self.max_speed,
            "compile_s": self.compile_s,
            "run_s": self.run_s,
            "us_per_step": self.us_per_step,
            "realtime_factor": self.realtime_factor,
            **({"continued_from_s": self.t[0]} if self.continues else {}),
            "final_time_s": self.t[-1],
            "final_positions_m": self.positions[-1],
            "tension_n": self.tension_summary(),
            **(
                {"tension_of_lines_n": self.line_tensions(), "lines": line_places(self.scene)}
                if self.scene.branched
                else {}
            ),
            **({"bodies": self.body_summary()} if self.body_position is not None else {}),
            **(
                {"bending": bending_summary(self.scene, self.t, self.curvature, self.bending_moment)}
                if bends(self.scene)
                else {}
            ),
            "broken": self.broken,
            "estimated_error": self.settings.get("estimated_error"),
            "warnings": self.warnings,
            "versions": self.versions,
        }
        if self.failure:
            found["error"] = self.failure
        return jsonable(found)

    def provenance(self) -> dict[str, Any]:
        """Everything but the arrays, as plain values: scene, settings, status, versions."""
        arrays = (*ARRAYS, *WITHIN, *BODIES, "own", "last")
        names = [f.name for f in dataclasses.fields(self) if f.name not in (*arrays, "scene")]
        meta = {"format": FORMAT, "scene": self.scene.as_written(), **{name: getattr(self, name) for name in names}}
        return json.loads(json.dumps(meta, default=_plain))

    @classmethod
    def restore(cls, meta: Plain, arrays: dict[str, np.ndarray | dict[str, np.ndarray]]) -> Solution:
        """The solution of saved provenance and arrays.

        Raises:
            ValueError: provenance of another format.
        """
        if not isinstance(meta, dict) or meta.get("format") != FORMAT:
            raise ValueError(f"another format; allowed: format {FORMAT}")
        meta = {key: value for key, value in meta.items() if key != "format"}
        scene = Scene.from_dict(meta.pop("scene"))
        tuples = {key: tuple(meta.pop(key, ())) for key in ("work_names", "warnings", "broken")}
        return cls(scene=scene, **arrays, **tuples, **meta)

    def to_xarray(self) -> xarray.Dataset:
        """The run as an `xarray.Dataset` with names, units and provenance; needs the extra `io`."""
        from dropper_jax.run.storage import to_xarray  # noqa: PLC0415

        return to_xarray(self)

    def save(self, path: str | Path) -> Path:
        """Write to `.npz`, `.nc` or `.zarr` with scene and settings inside, so that `rerun` can repeat the run."""
        from dropper_jax.run.storage import write_netcdf, write_npz, write_zarr  # noqa: PLC0415

        return {".nc": write_netcdf, ".zarr": write_zarr}.get(Path(path).suffix.lower(), write_npz)(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a saved run, `.npz`, `.nc` or `.zarr`.

        Raises:
            SceneError: one line, where the file is missing or is not a saved run.
        """
        from dropper_jax.run.storage import read_netcdf, read_npz, read_zarr  # noqa: PLC0415

        return {".nc": read_netcdf, ".zarr": read_zarr}.get(Path(path).suffix.lower(), read_npz)(path)

    def rerun(self, **kwargs: Any) -> Solution:
        """Simulate again from the provenance; on the same machine the numbers are the same to the bit.

        Raises:
            SceneError: the run went on from another, whose end is not known here.
        """
        from dropper_jax.run.simulate import simulate  # noqa: PLC0415

        if self.continues:
            why = f"went on from another run at {self.t[0]:g} s"
            raise SceneError(f"rerun: this run {why}; allowed: run the first one again and continue that")
        return simulate(self.scene, **{**self._stepping(), **kwargs})

    def continued(self, duration: float | None = None, **kwargs: Any) -> Solution:
        """Go on from the last state: what follows, with times that count on.

        Two runs of 5 s are one of 10 s, to the bit on the same machine. The first row is the last one of this run.

        Args:
            duration: further time [s]; default what an interrupted run has left, else the duration of this one.
            **kwargs: of `simulate`: `dt`, `save_every`, `progress` and others.

        Raises:
            SceneError: this run failed, or holds no last state.
        """
        from dropper_jax.run.simulate import simulate  # noqa: PLC0415

        further = self.further if duration is None else duration
        return simulate(self.scene, start=self, **{**self._stepping(), "duration": further, **kwargs})

    @property
    def further(self) -> float:
        """Time [s] for which the run goes on unless told otherwise: what is left, or its duration once more."""
        whole = float(self.settings["duration"])
        left = whole - float(self.t[-1] - self.t[0])
        return float(f"{left:.12g}") if left > 1e-9 * whole else whole

    def _stepping(self) -> dict[str, Any]:
        """The settings of the stepping that `simulate` takes."""
        implicit = self.settings["solver"] != "none"
        keys = (*(("iterations",) if implicit else ()), "residual_tolerance", "extra", "halvings", "track_work")
        return {key: self.settings[key] for key in keys if key in self.settings}


def _plain(value: np.ndarray) -> Plain:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be saved")
