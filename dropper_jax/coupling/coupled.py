"""Coupling: another program moves prescribed points of a scene and gets the forces on them, step by step.

`CoupledLines` is the pure component for programs in JAX; `Coupled` wraps it for others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, SimulationError, unreadable
from dropper_jax.base.store import read_archive, write_archive
from dropper_jax.coupling.coupled_lines import (
    CoupledLines,
    CoupledState,
    PointMotion,
    Vectors,
    coupled_lines,
    coupled_points,
)
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import SceneLike
from dropper_jax.run.end_of_run import name_leaves, restore_carry, same_scene

_step = cached_jit(kernel=True)(CoupledLines.step)
_follow = cached_jit(kernel=True)(CoupledLines.follow)
_start = cached_jit(static=("follows",))(CoupledLines.init)

#: Name of the points' positions at the start in a saved state.
BEGIN = "begin_positions"
#: Maximum number of inner steps of one coupling step, if they are equal.
MOST_STEPS = 1_000_000


class Coupled:
    """A scene with points moved by another program, which prescribes their motion and gets the forces on them.

        c = dj.Coupled("mooring.txt", points=["fairlead"])
        force = c.init()                              # (c, 3) [N], at rest
        force = c.step(positions, velocities, dt)     # positions and velocities at the end of dt

    Within a step a point moves along the cubic through both positions and velocities (the quintic with accelerations).
    Inner steps follow the accuracy of the scene, and the last one ends with the coupling step. Of a scene with `run.dt`
    they are equal, of this length or slightly less. The force on a point is the sum of the tensions along the end links
    of its lines in the last inner step, with weight, buoyancy and drag of the half links that belong to the point:

        F = sum_j T_j d_j/|d_j| + F_effects,    d_j from the point along link j

    The inertia of these halves is left out: add `mass` to that of the body. A body that uses the forces explicitly
    needs steps that are short compared with its own periods, for they come from the last inner step.

    Args:
        scene: as for `simulate`; its `[run]` gives the scheme and the accuracy, or the maximum inner step.
        points: names of fixed points of the scene; default: the fixed point, if there is only one.
        dt: maximum equal inner step [s] in place of those of the scene.
        accelerations: whether `init` and `step` take accelerations.

    Attributes:
        points: names of the coupled points, the rows of all arrays.
        time: [s].
        forces: forces of the last step (c, 3) [N].
        mass: of the halves of links at the points (c,) [kg], added mass left out.
        status: `ok`, or how the last step failed: `not_converged`, `non_finite`.
        failure: the reason in one line; empty if the step succeeded.
        residual, retried: of the last step: maximum scaled residual, inner steps solved by the fallback.
        unresolved: number of inner steps so far of the shortest length, whose error is larger than the accuracy allows.
        positions, tension: of all nodes [m] and links [N].

    Raises:
        SceneError: points that are not fixed or already move.
    """

    def __init__(
        self,
        scene: SceneLike,
        points: Sequence[str] | None = None,
        dt: float | None = None,
        accelerations: bool = False,
    ) -> None:
        scene = load_scene(scene)
        if dt is not None:
            scene = scene.with_values({"run.dt": dt})
        self.scene: Scene = scene
        self.points = coupled_points(scene, points)
        self.accelerations = accelerations
        self.status = "ok"
        self.failure = ""
        self.residual = 0.0
        self.retried = 0
        self._saved: CoupledState | None = None
        self._home = np.array([scene.point(name).position for name in self.points])
        self._begin = self._home  # positions at the start

    def init(self, positions: Vectors | None = None, velocities: Vectors | None = None) -> np.ndarray:
        """Start at t = 0 as defined in the scene's `[start]`, with the points at `positions` (c, 3) [m].

        Args:
            positions: default: as in the scene; lines that start at rest are in equilibrium with these positions.
            velocities: of the points (c, 3) [m/s]; default at rest.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: no equilibrium found, values that are not finite or not of this shape.
        """
        begin = self._home if positions is None else self._read("positions", positions)
        if velocities is not None:
            velocities = self._read("velocities", velocities)
        scene = self.scene
        if not np.array_equal(begin, self._home):
            numbers = {point.name: i for i, point in enumerate(scene.points)}
            moved = zip(self.points, begin.tolist(), strict=True)
            scene = scene.with_values({f"point.{numbers[name]}.position": position for name, position in moved})
        self._lines = coupled_lines(scene, self.points, velocities, self.accelerations)
        self._begin = begin
        return self._accept(_start(self._lines, follows=scene.run.accuracy is not None))

    def step(
        self, positions: Vectors, velocities: Vectors, dt: float, accelerations: Vectors | None = None
    ) -> np.ndarray:
        """Advance by dt [s] to positions (c, 3) [m] and velocities [m/s] of the points at its end.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: values that are not finite or not of this shape, a step before `init`.
            SimulationError: the step failed, see `status`; the state is that before the step.
        """
        saved = self._state()
        if not (math.isfinite(dt) and dt > 0.0):
            raise SceneError(f"dt: {dt} is out of range; allowed: more than 0 s")
        if (accelerations is not None) != self.accelerations:
            raise SceneError("accelerations: need Coupled(accelerations=True); allowed: in every step or in none")
        motion = PointMotion(self._read("positions", positions), self._read("velocities", velocities))
        if accelerations is not None:
            motion = motion._replace(accelerations=self._read("accelerations", accelerations))
        dtype = self._lines.model.dtype
        given = (self._lines, saved, motion, jnp.asarray(dt, dtype))
        run = self.scene.run
        if run.accuracy is None:
            count = max(1, math.ceil(dt / run.step - 1e-9))
            if count > MOST_STEPS:
                why = f"is {count:.3g} inner steps of {run.step:g} s"
                raise SceneError(f"dt: {dt:g} s {why}; allowed: at most {MOST_STEPS}")
            inner = f"{count} inner steps of {dt / count:.3g} s"
            state, outputs = _step(*given, jnp.asarray(count, jnp.int32))
        else:
            inner = run.steps_in_words
            state, outputs = _follow(*given, jnp.asarray(run.accuracy, dtype))
        self.residual = float(outputs.residual)
        self.retried = int(outputs.retried)
        if outputs.failed or not np.all(np.isfinite(outputs.forces)):
            self.status = "not_converged"
            why = f"scaled residual {self.residual:.3g}"
            if not math.isfinite(self.residual):
                self.status = "non_finite"
                why = "non-finite values"
            self.failure = f"{self.status}: the step to t = {self.time + dt:.6g} s, {inner}: {why}"
            raise SimulationError(self.failure)
        return self._accept(state)

    def save(self, path: str | Path | None = None) -> dict[str, np.ndarray]:
        """The whole state as arrays; also written to an `.npz` file if a path is given."""
        arrays = {**name_leaves(self._state()), BEGIN: self._begin}
        if path is not None:
            write_archive(path, arrays, {"scene": self.scene.as_written(), "points": list(self.points)})
        return arrays

    def restore(self, saved: dict[str, np.ndarray] | str | Path) -> np.ndarray:
        """Return to a state given by `save`; the continuation is bit-identical, without `init`.

        Growth, wakes and flow-dependent coefficients follow from the positions at the start, which are saved too. Of a
        state that an earlier version saved they are those of `init`, which is called first if they are not the scene's.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: a file of another scene or of other points, or not written by `save`.
        """
        arrays = saved if isinstance(saved, dict) else self._read_file(Path(saved))
        begin = self._read("positions", arrays.get(BEGIN, self._begin))
        if self._saved is None:
            self.init(begin)
        state = restore_carry(self._state(), arrays)
        if not np.array_equal(begin, self._begin):
            self.init(begin)
        return self._accept(state)

    @property
    def time(self) -> float:
        return float(self._state().progress.state.t)

    @property
    def unresolved(self) -> int:
        """Number of inner steps so far of the shortest length, whose error is larger than the accuracy allows."""
        control = self._state().progress.control
        return 0 if control is None else int(control.shortest)

    @property
    def forces(self) -> np.ndarray:
        return np.array(self._state().forces)

    @property
    def mass(self) -> np.ndarray:
        self._state()
        return np.asarray(self._lines.mass)

    @property
    def positions(self) -> np.ndarray:
        """All nodes, line after line, both ends of each included (n + lines, 3) [m]."""
        s = self._state().progress.state
        motion = self._state().motion
        model = self._lines.moving(motion, motion, s.t, 1.0).model
        return np.asarray(model.nodes(s.r, model.ends(s.t)))

    @property
    def tension(self) -> np.ndarray:
        """Tensions of all links (n,) [N] in the last step."""
        return np.asarray(self._state().progress.state.tension)

    def _accept(self, state: CoupledState) -> np.ndarray:
        """Make this the present state, and return its forces on the points (c, 3) [N]."""
        self._saved = state
        self.status = "ok"
        self.failure = ""
        return self.forces

    def _state(self) -> CoupledState:
        """The present state; an error before `init`."""
        if self._saved is None:
            raise SceneError("Coupled: not initialised. Call `init` first")
        return self._saved

    def _read(self, what: str, values: Vectors) -> np.ndarray:
        """Vectors of the points (c, 3), checked; `what` names them in messages."""
        found = np.array(values, float)  # a copy: the caller may change its own array in place
        shape = (len(self.points), 3)
        if found.shape == (3,) and shape[0] == 1:
            found = found[None]
        if found.shape != shape:
            raise SceneError(f"{what}: has shape {list(found.shape)}; allowed: {list(shape)}, a row per point")
        if not np.all(np.isfinite(found)):
            row = int(np.flatnonzero(~np.all(np.isfinite(found), axis=1))[0])
            raise SceneError(f"{what}: {found[row].tolist()} of {self.points[row]!r} is not finite; allowed: numbers")
        return found

    def _read_file(self, path: Path) -> dict[str, np.ndarray]:
        """The arrays of a file written by `save` for the same scene and points."""
        try:
            meta, arrays = read_archive(path)
            scene = Scene.from_dict(meta["scene"])
            points = tuple(meta["points"])
        except OSError as error:
            raise unreadable(path, error) from None
        except Exception:  # any error of a file in another format
            raise SceneError(f"{path}: not a saved coupling; allowed: a file written by `Coupled.save`") from None
        same_scene(self.scene, scene)
        if points != self.points:
            raise SceneError(f"{path}: couples {', '.join(points)}; allowed: {', '.join(self.points)}")
        return arrays
