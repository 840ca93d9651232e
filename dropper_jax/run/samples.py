"""Samples of a run: arrays, status, provenance, and quantities derived from them."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cached_property
from operator import methodcaller
from typing import TypeVar

import numpy as np

from dropper_jax.analysis.angles import angle_rates, link_angles
from dropper_jax.axial import AXIAL_RINGING
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.quantities.bending import bending_moment, curvature, has_bending
from dropper_jax.quantities.end_forces import end_angles
from dropper_jax.quantities.end_links import Motion
from dropper_jax.quantities.step_extremes import saved_signal
from dropper_jax.quantities.twist import torque
from dropper_jax.quantities.variables import ARRAYS, BODIES, EXTREMES, SOME
from dropper_jax.run.row_store import BLOCK_STATES, release_pages
from dropper_jax.scene import LineSlice, line_slices, whole_lines
from dropper_jax.scene.slices import point_nodes
from dropper_jax.stepping.extremes import Extremes

#: Extremes, mean and final value by name, see `extent`.
Extent = dict[str, float]
#: Version of the saved file; files of other versions are rejected.
RUN_FORMAT = 1
#: Status of a run whose companion states an error above 10 % (`run.companion`), or whose steps do not resolve most
#: of the dissipated work.
TOO_LONG = "step_too_long"
#: Status of a run whose energy balance has a large error.
DRIFT = "energy_drift"
#: Motion of a body: reference point [m] and attitude [rad].
MOTIONS = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
#: The ends of a line.
ENDS = ("first", "last")


@dataclasses.dataclass
class Samples:
    """Result of a run. `run.simulate.Solution` describes every array and number, saves the run and continues it."""

    scene: Scene
    settings: Table
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
    first_bad: Table | None = None
    max_residual: float = 0.0
    max_closure_error: float = 0.0
    compile_s: float = 0.0
    run_s: float = 0.0
    versions: dict[str, str] = dataclasses.field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    broken: tuple[Table, ...] = ()
    own: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    last: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    continues: Table | None = None
    tension_min: np.ndarray | None = None
    tension_max: np.ndarray | None = None
    tension_min_time: np.ndarray | None = None
    tension_max_time: np.ndarray | None = None
    end_force_min: np.ndarray | None = None
    end_force_max: np.ndarray | None = None
    end_force_min_time: np.ndarray | None = None
    end_force_max_time: np.ndarray | None = None
    point_load_min: np.ndarray | None = None
    point_load_max: np.ndarray | None = None
    point_load_min_time: np.ndarray | None = None
    point_load_max_time: np.ndarray | None = None
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
            SceneError: unknown point.
        """
        nodes = point_nodes(self.scene)
        if name not in nodes:
            raise SceneError(f"point: {name!r} is not a point; {nearest(name, names_of(self.scene.points))}")
        return self.positions[:, nodes[name]]

    def body(self, name: str) -> dict[str, np.ndarray]:
        """Motion of a rigid body by the names of `BODIES`, each (k, 3).

        Raises:
            SceneError: unknown body.
        """
        names = names_of(self.scene.bodies)
        if name not in names:
            raise SceneError(f"body: {name!r} is not a body; {nearest(name, names)}")
        return {key: getattr(self, key)[:, names.index(name)] for key in BODIES}

    def body_summary(self) -> dict[str, Table]:
        """Minimum, mean, maximum and final x, y, z [m], roll, pitch and yaw [rad] of each body."""
        motions = {}
        for body in self.scene.bodies:
            motion = self.body(body.name)
            values = np.concatenate([motion["body_position"], motion["body_attitude"]], axis=1)
            motions[body.name] = {key: extent(values[:, [i]]) for i, key in enumerate(MOTIONS)}
        return motions

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
        """Maximum change of the energy balance since the start [J]."""
        with np.errstate(invalid="ignore"):  # a run that failed may contain infinite values
            return float(np.max(np.abs(self.balance - self.balance[0])))

    @property
    def axial_ringing(self) -> float:
        """Energy [J] that the scheme has taken from unresolved axial vibrations."""
        if AXIAL_RINGING not in self.work_names:
            return 0.0
        return max(-float(self.work[-1, self.work_names.index(AXIAL_RINGING)]), 0.0)

    @property
    def axial_ringing_share(self) -> float:
        """Energy taken from unresolved axial vibrations as a fraction of all dissipated work."""
        total = float(np.sum(np.maximum(-self.work[-1], 0.0)))
        if total:
            return self.axial_ringing / total
        return 0.0

    @property
    def energy_scale(self) -> float:
        """Reference of the energy drift [J]: range of the potential, or the maximum kinetic energy if larger."""
        return float(max(np.ptp(self.potential), np.max(self.kinetic)))

    @property
    def max_speed(self) -> float:
        """Maximum speed of a node [m/s]."""
        largest = []
        with np.errstate(over="ignore", invalid="ignore"):  # a failed run may contain any value
            for first in range(0, len(self.velocities), BLOCK_STATES):
                block = self.velocities[first : first + BLOCK_STATES]
                largest.append(np.max(np.linalg.norm(block, axis=-1)))
                release_pages([self.velocities])
            return float(np.max(largest))

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Polar angle from the horizontal and azimuth of each link, (k, n) [rad] each, continuous in time."""
        parts = []
        for line in self.lines:
            parts.append(np.stack(link_angles(self.positions[:, line.nodes], zero="horizontal")))
            release_pages([self.positions])
        return tuple(np.concatenate(parts, axis=2))

    @property
    def polar(self) -> np.ndarray:
        """Polar angles (k, n) [rad], zero at the horizontal."""
        return self.angles[0]

    @property
    def azimuth(self) -> np.ndarray:
        """Azimuths (k, n) [rad]."""
        return self.angles[1]

    def angle_rates(self, zero: str = "horizontal") -> tuple[np.ndarray, np.ndarray]:
        """Rates of the angles (k, n) [rad/s]."""
        nodes = [line.nodes for line in self.lines]
        parts = [np.stack(angle_rates(self.positions[:, own], self.velocities[:, own], zero)) for own in nodes]
        return tuple(np.concatenate(parts, axis=2))

    @cached_property
    def curvature(self) -> np.ndarray | None:
        """Curvature (k, nodes) [1/m] if lines have bending stiffness (see `quantities.bending`); else None."""
        if has_bending(self.scene):
            return curvature(self.scene, self.positions, self.t)
        return None

    @cached_property
    def bending_moment(self) -> np.ndarray | None:
        """Bending moment (k, nodes) [N m] if lines have bending stiffness; else None."""
        if has_bending(self.scene):
            return bending_moment(self.scene, self.positions, self.t, self.broken)
        return None

    @property
    def twist(self) -> np.ndarray | None:
        """Twist (k, nodes) [rad] about the axes of lines if they have torsion; else None."""
        return self.own.get("torsion.0")

    @cached_property
    def torque(self) -> np.ndarray | None:
        """Torque (k, n) [N m] of links if lines have torsion; else None."""
        if self.twist is None:
            return None
        return torque(self.scene, self.positions, self.twist, self.own["torsion.1"], self.t, self.broken)

    @property
    def us_per_step(self) -> float:
        """Wall time of a step without compilation [us]; if the run stopped, over its good steps."""
        done = (len(self.t) - 1) * self.settings.get("save_every", 1)
        if "refused_steps" in self.settings:
            done = self.settings["steps"] + self.settings["refused_steps"]
        return 1e6 * self.run_s / max(done, 1)

    @property
    def realtime_factor(self) -> float:
        """Simulated time over wall time without compilation."""
        if self.run_s > 0:
            return float(self.t[-1] - self.t[0]) / self.run_s
        return math.nan

    @property
    def failure(self) -> str:
        """One line with the failed step, its time and the reason; empty if no step failed."""
        if self.status == "ok":
            return ""
        if self.status == DRIFT:
            what = f"energy balance error {self.energy_drift:.3g} J (reference {self.energy_scale:.3g} J)"
            return f"{self.status}: {what}. Use a smaller step"
        if self.status == TOO_LONG:
            what = "tensions or positions are off by more than 10 %, or most dissipated work is unresolved vibration"
            return f"{self.status}: {what}. Use a smaller --accuracy or --dt"
        if self.first_bad is None:
            return f"{self.status}: at t = {self.t[-1]:.6g} s of {self.settings['duration']:g} s"
        bad = self.first_bad
        return (
            f"{self.status}: step {bad['step']} at t = {bad['time_s']:.6g} s, scaled residual {bad['residual']:.3g}: "
            f"{bad['reason']}"
        )

    def tension_summary(self) -> dict[str, Extent]:
        """min, mean, max and final tension [N] of the first, the last and all links; `final` of all is their mean.

        Minima and maxima are those of all steps and of the start, at the times `min_s` and `max_s` [s]. The mean leaves
        out the start, whose tension is not that of a step.
        """
        return self._tension_extents({"first": slice(0, 1), "last": slice(-1, None), "all": slice(None)})

    def line_tensions(self) -> dict[str, Extent]:
        """The statistics of `tension_summary` for every line of the scene, pieces between attached points together."""
        return self._tension_extents({line.name: line.links for line in whole_lines(self.scene)})

    def end_forces(self) -> dict[str, dict[str, Extent]]:
        """The statistics of `tension_summary` for the force [N] of every line on its first and last point.

        Tensions of links are at their middles, so the difference is the weight of half the end link, less its buoyancy
        as far as it is in the water.
        """
        rows = self.signal("end_force")
        extremes = self.step_extremes("end_force", rows)
        forces = {}
        for i, line in enumerate(whole_lines(self.scene)):
            forces[line.name] = {end: extent(rows[:, i, [j]], extremes.of(i, [j])) for j, end in enumerate(ENDS)}
        return forces

    def end_angles(self) -> dict[str, dict[str, Extent]]:
        """min, mean, max and final angle [deg] of the end links above the horizontal at the saved times: the uplift at
        an anchor."""
        angles = {}
        for name, both in end_angles(self.positions, whole_lines(self.scene)).items():
            angles[name] = {end: extent(both[:, [j]]) for j, end in enumerate(ENDS)}
        return angles

    def signal(self, signal: str) -> np.ndarray:
        """Tensions of links (`tension`, (k, n)), forces on the end points of lines (`end_force`, (k, lines, 2)) or the
        horizontal, vertical and total load of fixed points (`point_load`, (k, points, 3)) at the saved times [N]."""
        return saved_signal(signal, self.motion)

    @property
    def motion(self) -> Motion:
        """The saved nodes and tensions of the lines."""
        return Motion(self.scene, self.t, self.positions, self.t_tension, self.tension)

    def step_extremes(self, signal: str, values: np.ndarray | None = None) -> Extremes:
        """Minima and maxima of a signal over the steps since the last saved time (k, ...) [N], and their times [s].

        They are the saved values if every step is saved, and in files of earlier versions that have no extremes.

        Args:
            values: the signal at the saved times, if it is known already.
        """
        stored = [getattr(self, f"{signal}_{name}") for name in EXTREMES]
        if any(array is None for array in stored):
            values = self.signal(signal) if values is None else values
            times = np.broadcast_to(self.t_tension.reshape(-1, *[1] * (values.ndim - 1)), values.shape)
            saved = (values, values, times, times)
            stored = [given if array is None else array for array, given in zip(stored, saved, strict=True)]
        return Extremes(*stored)

    @property
    def tension_range(self) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum tension (k, n) [N] over the steps since the last saved time."""
        return self.step_extremes("tension")[:2]

    @property
    def saved_rows(self) -> str:
        """What the saved tensions are if not every step is saved; else empty."""
        if self.scene.run.accuracy is not None:
            return f"saved tensions are means over {self.settings['dt']:g} s"
        every = self.settings.get("save_every", 1)
        if every == 1:
            return ""
        return f"one step in {every} is saved"

    def _tension_extents(self, parts: dict[str, slice]) -> dict[str, Extent]:
        """Statistics of the tensions of these links, by name."""
        extremes = self.step_extremes("tension")
        return {name: extent(self.tension[:, links], extremes.of(links)) for name, links in parts.items()}

    def provenance(self) -> Table:
        """Everything but the arrays, as plain values: scene, settings, status, versions."""
        arrays = (*ARRAYS, *SOME, "own", "last")
        names = [f.name for f in dataclasses.fields(self) if f.name not in (*arrays, "scene")]
        meta = {"format": RUN_FORMAT, "scene": self.scene.as_written(), **{name: getattr(self, name) for name in names}}
        return json.loads(json.dumps(meta, default=methodcaller("tolist")))


#: The requested class.
Kind = TypeVar("Kind", bound=Samples)


def is_finished(run: Samples) -> bool:
    """Whether a run reached its end with a bounded motion, so that its errors can be estimated."""
    return run.status in ("ok", TOO_LONG) or (run.status == DRIFT and run.energy_drift <= run.energy_scale)


def extent(values: np.ndarray, extremes: Extremes | None = None) -> Extent:
    """min, mean and max of values (k, n), and the mean of the last row.

    With `extremes` the values are those of steps: min and max are those of all steps, `min_s` and `max_s` their times
    [s], and the mean leaves out the first row, which belongs to the start.
    """
    statistics = {"min": np.min(values), "mean": np.mean(values), "max": np.max(values), "final": np.mean(values[-1])}
    if extremes is not None:
        low = np.argmin(extremes.least)
        high = np.argmax(extremes.largest)
        statistics |= {"min": extremes.least.flat[low], "max": extremes.largest.flat[high]}
        statistics |= {"min_s": extremes.least_at.flat[low], "max_s": extremes.largest_at.flat[high]}
        if len(values) > 1:
            statistics["mean"] = np.mean(values[1:])
    return {key: float(value) + 0.0 for key, value in statistics.items()}  # no -0
