"""Coupling: another program moves prescribed points of a scene and gets the forces on them, step by step.

`CoupledLines` is the pure component for programs in JAX; `Coupled` wraps it for others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, SimulationError, nearest
from dropper_jax.base.store import read_archive, write_archive
from dropper_jax.effects.coupled_motion import CoupledMotion
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Displacement, Model, State
from dropper_jax.run.build import SceneLike, build_model, stepper_of
from dropper_jax.run.carry import name_leaves, restore_carry, same_scene
from dropper_jax.run.coupled_forces import half_link_mass, point_forces, set_free
from dropper_jax.run.start import initial_state
from dropper_jax.stepping.integrate import Progress, begin, next_progress
from dropper_jax.stepping.stepper import FULL_STEP, Stepper

Array = jax.Array | np.ndarray
Vectors = Sequence[Sequence[float]] | Array


class PointMotion(NamedTuple):
    """Positions [m], velocities [m/s] and accelerations [m/s^2] of the coupled points at one instant, each (c, 3)."""

    positions: Array
    velocities: Array
    accelerations: Array | None = None


class CoupledState(NamedTuple):
    """The whole state of a coupling: the lines, the points at the end of the last step, forces (c, 3) [N] on them."""

    progress: Progress
    motion: PointMotion
    forces: Array


class CoupledOutputs(NamedTuple):
    """Forces (c, 3) [N], maximum scaled residual, inner steps solved by the fallback, whether a step failed so far."""

    forces: jax.Array
    residual: jax.Array
    retried: jax.Array
    failed: jax.Array


@partial(jax.tree_util.register_dataclass, data_fields=["model", "start"], meta_fields=["stepper"])
@dataclass(frozen=True)
class CoupledLines:
    """Lines between points that a JAX program moves: a pure component, to `jit`, `vmap`, `grad`, `scan` and shard.

        lines = dj.coupled_lines("mooring.txt", ["fairlead"])
        state = lines.init()
        state, outputs = lines.step(state, (positions, velocities), dt)

    Attributes:
        model: the model; its leaves are the parameters. `replace(lines, model=...)` is the same scene with others.
        start: the state at t = 0. `dj.settle(lines.model, lines.start)` follows changes of the model.
        stepper: static settings; `replace(lines, stepper=lines.stepper.plain)` leaves out the fallback solvers.
    """

    model: Model
    start: State
    stepper: Stepper

    def init(self, start: State | None = None) -> CoupledState:
        """The state at t = 0, from `start` (default: that of the scene) with the points where the scene has them."""
        motion, start = self._motion, self.start if start is None else start
        progress = begin(self.stepper, self.model, start)
        at_rest = PointMotion(motion.home, motion.velocities[0], jnp.zeros_like(motion.home))
        return CoupledState(progress, at_rest, _forces(self, progress.state))

    def step(
        self, state: CoupledState, inputs: PointMotion | tuple[Array, ...], dt: Array | float, count: Array | int = 1
    ) -> tuple[CoupledState, CoupledOutputs]:
        """Advance by dt [s] in `count` equal steps of the scheme; see `Coupled` for path and forces.

        Args:
            inputs: positions, velocities (and accelerations) of the points at the end of dt, each (c, 3).
            count: a Python integer for derivatives in reverse mode.

        Returns:
            State and outputs. A step that fails raises nothing; `outputs.failed` stays true from then on.
        """
        given = [jnp.asarray(a, self.model.dtype) for a in inputs if a is not None]
        motion = PointMotion(*given, *[jnp.zeros_like(given[0])] * (3 - len(given)))
        dt = jnp.asarray(dt, self.model.dtype)
        lines = self.moving(state.motion, motion, state.progress.t, dt)

        def one(_: jax.Array, result: tuple[Any, ...]) -> tuple[Any, ...]:
            progress, residual, retried = result
            progress, report, _ = next_progress(lines.stepper, lines.model, progress, dt / count)
            # not `maximum`, which would lose a NaN
            worst = jnp.where(report.residual <= residual, residual, report.residual)
            return progress, worst, retried + (report.level > FULL_STEP)

        zero = jnp.zeros((), lines.model.dtype), jnp.zeros((), jnp.int32)
        progress, residual, retried = jax.lax.fori_loop(0, count, one, (state.progress, *zero))
        forces = lines.forces(progress.state)
        outputs = CoupledOutputs(forces, residual, retried, progress.has_failed)
        return CoupledState(progress, motion, forces), outputs

    def moving(self, since: PointMotion, to: PointMotion, t: Array | float, dt: Array | float) -> CoupledLines:
        """The lines with points that move from one motion to the other between t and t + dt [s]."""
        positions, rates, bends = (jnp.stack(both) for both in zip(since, to, strict=True))
        bends = None if self._motion.accelerations is None else bends
        values = {"begin": jnp.asarray(t, rates.dtype), "width": jnp.asarray(dt, rates.dtype), "places": positions}
        motion = replace(self._motion, velocities=rates, accelerations=bends, **values)
        return replace(self, model=replace(self.model, effects=(*self.model.effects[:-1], motion)))

    def forces(self, s: State) -> jax.Array:
        """Forces (c, 3) [N] on the points in a state."""
        return point_forces(self.model, set_free(self.model, self.indices), s, self.indices)

    @property
    def mass(self) -> jax.Array:
        """Mass (c,) [kg] of the halves of links at the points, added mass left out."""
        return half_link_mass(set_free(self.model, self.indices), self.indices)

    @property
    def indices(self) -> tuple[int, ...]:
        """The coupled points among those of the model."""
        names = [p.name for p in self.model.points]
        return tuple(names.index(name) for name in self._motion.points)

    @property
    def _motion(self) -> CoupledMotion:
        return self.model.effects[-1]


_forces = cached_jit()(CoupledLines.forces)
_step = cached_jit()(CoupledLines.step)


def coupled_lines(
    scene: SceneLike,
    points: Sequence[str] | None = None,
    velocities: Vectors | None = None,
    accelerations: bool = False,
) -> CoupledLines:
    """The component of a scene whose fixed points a JAX program moves.

    Args:
        scene, points: as for `Coupled`.
        velocities: of the points at t = 0 (c, 3) [m/s]; default at rest.
        accelerations: whether the inputs of `step` have accelerations.

    Raises:
        SceneError: as `Coupled`.
    """
    scene = load_scene(scene)
    points = _points(scene, points)
    model = build_model(scene)
    if any(e.moves(name) for e in model.having(Displacement) for name in points):
        raise SceneError("points: already moved by an effect of the scene; allowed: fixed points")
    home = np.array([scene.point(name).position for name in points])
    rates = np.zeros_like(home) if velocities is None else np.asarray(velocities, float)
    motion = CoupledMotion.uniform(points, home, rates, accelerations)
    model = replace(model, effects=(*model.effects, motion)).cast(model.dtype)
    stepper = stepper_of(model, scene.run)
    if stepper.integrator.controls_error or scene.run.step_tolerance is not None:
        raise SceneError("run: chooses its own steps, which a coupling cannot use. Use a scheme of equal steps")
    return CoupledLines(model, initial_state(model, scene.start), stepper)


class Coupled:
    """A scene with points moved by another program, which prescribes their motion and gets the forces on them.

        c = dj.Coupled("mooring.txt", points=["fairlead"])
        force = c.init()                              # (c, 3) [N], at rest
        force = c.step(positions, velocities, dt)     # positions and velocities at the end of dt

    Within a step a point moves along the cubic through both positions and velocities (the quintic with accelerations).
    A coupling step consists of a whole number of inner steps of `run.dt` or slightly less. The force on a point is the
    sum of the tensions along the end links of its lines in the last inner step. Weight, buoyancy and drag of the half
    links that belong to the point are added:

        F = sum_j T_j d_j/|d_j| + F_effects,    d_j from the point along link j

    The inertia of these halves is left out: add `mass` to that of the body. Forces come from the last inner step. A
    body that uses them explicitly therefore needs steps that are short compared with its own periods.

    Args:
        scene: as for `simulate`; its `[run]` gives the scheme and the maximum inner step.
        points: names of fixed points of the scene; default: the fixed point, if there is only one.
        dt: maximum inner step [s]; default that of the scene.
        accelerations: whether `init` and `step` take accelerations.

    Attributes:
        points: names of the coupled points, the rows of all arrays.
        time: [s].
        forces: forces of the last step (c, 3) [N].
        mass: of the halves of links at the points (c,) [kg], added mass left out.
        status: `ok`, or how the last step failed: `not_converged`, `non_finite`.
        failure: the reason in one line; empty if the step succeeded.
        residual, retried: of the last step: maximum scaled residual, inner steps solved by the fallback.

    Raises:
        SceneError: points that are not fixed or already move, a scheme that chooses its own steps.
    """

    def __init__(
        self,
        scene: SceneLike,
        points: Sequence[str] | None = None,
        dt: float | None = None,
        accelerations: bool = False,
    ) -> None:
        scene = load_scene(scene)
        self.scene: Scene = scene if dt is None else scene.with_values({"run.dt": dt})
        self.points = _points(self.scene, points)
        self.accelerations = accelerations
        self.status, self.failure, self.residual, self.retried = "ok", "", 0.0, 0
        self._saved: CoupledState | None = None

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
        home = np.array([self.scene.point(name).position for name in self.points])
        all_positions = home if positions is None else self._read("positions", positions)
        rates = np.zeros_like(all_positions) if velocities is None else self._read("velocities", velocities)
        self._lines = coupled_lines(self._moved_to(all_positions), self.points, rates, self.accelerations)
        self._plain = self._lines.stepper.until_converged or not self._lines.model.laws
        self._saved = self._lines.init()
        self.status, self.failure = "ok", ""
        return self.forces

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
        most = 1_000_000  # maximum number of inner steps of one coupling step
        saved = self._state()
        if not (math.isfinite(dt) and dt > 0.0):
            raise SceneError(f"dt: {dt} is out of range; allowed: more than 0 s")
        if (accelerations is not None) != self.accelerations:
            raise SceneError("accelerations: need Coupled(accelerations=True); allowed: in every step or in none")
        read = [self._read("positions", positions), self._read("velocities", velocities)]
        bends = np.zeros_like(read[0]) if accelerations is None else self._read("accelerations", accelerations)
        count = max(1, math.ceil(dt / self.scene.run.dt - 1e-9))
        if count > most:
            why = f"is {count:.3g} inner steps of {self.scene.run.dt:g} s"
            raise SceneError(f"dt: {dt:g} s {why}; allowed: at most {most}")
        state, outputs = self._advance(saved, PointMotion(*read, bends), dt, count)
        self.residual, self.retried = float(outputs.residual), int(outputs.retried)
        if outputs.failed or not np.all(np.isfinite(outputs.forces)):
            self._fail(dt, count)
        self.status, self.failure = "ok", ""
        self._saved = state
        return self.forces

    def save(self, path: str | Path | None = None) -> dict[str, np.ndarray]:
        """The whole state as arrays; also written to an `.npz` file if a path is given."""
        arrays = name_leaves(self._state())
        if path is not None:
            write_archive(path, arrays, {"scene": self.scene.as_written(), "points": list(self.points)})
        return arrays

    def restore(self, saved: dict[str, np.ndarray] | str | Path) -> np.ndarray:
        """Return to a state given by `save`; the continuation is bit-identical.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: a file of another scene or of other points, or not written by `save`.
        """
        if self._saved is None:
            self.init()
        arrays = saved if isinstance(saved, dict) else self._read_file(Path(saved))
        self._saved = restore_carry(self._state(), arrays)
        self.status, self.failure = "ok", ""
        return self.forces

    @property
    def time(self) -> float:
        return float(self._state().progress.state.t)

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
        s, motion = self._state().progress.state, self._state().motion
        model = self._lines.moving(motion, motion, s.t, 1.0).model
        return np.asarray(model.nodes(s.r, model.ends(s.t)))

    @property
    def tension(self) -> np.ndarray:
        """Tensions of all links (n,) [N] in the last step."""
        return np.asarray(self._state().progress.state.tension)

    def _state(self) -> CoupledState:
        if self._saved is None:
            raise SceneError("Coupled: not initialised. Call `init` first")
        return self._saved

    def _advance(
        self, state: CoupledState, to: PointMotion, dt: float, count: int
    ) -> tuple[CoupledState, CoupledOutputs]:
        """The inner steps; if the plain program does not converge, by the program with the fallback solvers."""
        given = state, to, jnp.asarray(dt, self._lines.model.dtype), jnp.asarray(count, jnp.int32)
        full = self._lines.stepper
        result = _step(replace(self._lines, stepper=full.plain if self._plain else full), *given)
        if self._plain and result[1].failed and full != full.plain:
            self._plain = False
            result = _step(self._lines, *given)
        return result

    def _moved_to(self, positions: np.ndarray) -> Scene:
        names = [p.name for p in self.scene.points]
        home = [self.scene.point(name).position for name in self.points]
        if all(np.array_equal(a, b) for a, b in zip(positions, home, strict=True)):
            return self.scene
        where = zip(self.points, positions, strict=True)
        return self.scene.with_values({f"point.{names.index(name)}.position": p.tolist() for name, p in where})

    def _fail(self, dt: float, count: int) -> None:
        end = self.time + dt
        if not math.isfinite(self.residual):
            self.status, why = "non_finite", "non-finite values"
        else:
            self.status, why = "not_converged", f"scaled residual {self.residual:.3g}"
        self.failure = f"{self.status}: the step to t = {end:.6g} s, {count} inner steps of {dt / count:.3g} s: {why}"
        raise SimulationError(self.failure)

    def _read(self, what: str, values: Vectors) -> np.ndarray:
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
        try:
            meta, arrays = read_archive(path)
            scene, points = Scene.from_dict(meta["scene"]), tuple(meta["points"])
        except OSError as error:
            raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
        except Exception:  # any error of a file in another format
            raise SceneError(f"{path}: not a saved coupling; allowed: a file written by `Coupled.save`") from None
        same_scene(self.scene, scene)
        if points != self.points:
            raise SceneError(f"{path}: couples {', '.join(points)}; allowed: {', '.join(self.points)}")
        return arrays


def _points(scene: Scene, given: Sequence[str] | None) -> tuple[str, ...]:
    """The coupled points, checked."""
    held = [p.name for p in scene.points if not p.is_free]
    if given is None:
        if len(held) != 1:
            raise SceneError(f"points: missing; needed: names of the fixed points that move: {', '.join(held)}")
        return tuple(held)
    names = (given,) if isinstance(given, str) else tuple(given)
    for i, name in enumerate(names):
        if name not in held:
            raise SceneError(f"points.{i}: {name!r} is not a fixed point; {nearest(name, held)}")
        if name in names[:i]:
            raise SceneError(f"points.{i}: {name!r} is a duplicate; allowed: every point once")
    if not names:
        raise SceneError(f"points: is empty; allowed: names of fixed points: {', '.join(held)}")
    return names
