"""The solution of a run: its samples, and how it is told, saved, read again and gone on with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropper_jax.base.errors import SceneError
from dropper_jax.run.samples import Samples
from dropper_jax.run.summary import summary

if TYPE_CHECKING:
    import xarray


class Solution(Samples):
    """What a run gives, k saved times, n links.

    Attributes:
        scene: what was simulated.
        settings: integrator, solver, dt, duration, steps, dtype, gamma, rho_infinity, residual_tolerance,
            save_every; with a tolerance also `estimated_error` {rms_angle_rad, until_s}; with errors `load_errors`
            (see `study.load_errors`); else `step_check` (see `run.step_check`).
        t: saved times (k,) [s].
        positions, velocities: all nodes, both ends included, (k, n + 1, 3) [m], [m/s]; of a system of lines the nodes
            of all lines, line after line (points where lines join stand once per line), see `lines`.
        tension: (k, n) [N] at the times `t_tension` (k,) [s] (the step's midpoint in midpoint schemes).
        kinetic, potential: energies (k,) [J].
        work: work done since the start (k, w) [J] by each of `work_names`.
        step_status: 0 where every step up to the saved time is good.
        status: `ok`, `energy_drift` (the end is reached, more than 10 % of the energy scale is not accounted for),
            `retry_exhausted`, `not_converged`, `non_finite` or `interrupted`.
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

    def summary(self) -> dict[str, Any]:
        """The JSON object of a run; NaN and infinity are null."""
        return summary(self)

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

        return {".nc": read_netcdf, ".zarr": read_zarr}.get(Path(path).suffix.lower(), read_npz)(path, cls)

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

        Two runs of 5 s are one of 10 s, to the bit on the same machine (systems of lines: where both are of fewer than
        20 000 steps or both of more, else to rounding). The first row is the last one of this run.

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


def load_run(path: str | Path) -> Solution:
    """A saved run from an `.npz` or `.nc` file or a `.zarr` folder, with the numbers that were saved.

    Raises:
        SceneError: one line, where the file is missing or is not a saved run.
    """
    return Solution.load(path)
