"""Lines between points that a JAX program moves, as a pure component; forces on these points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.coupled_motion import CoupledMotion
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Displacement, Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.build import SceneLike, build_model, initial_state, stepper_of
from dropper_jax.run.coupled_forces import half_link_mass, point_forces
from dropper_jax.stepping.adaptive import follow_and_save
from dropper_jax.stepping.equal_steps import next_progress
from dropper_jax.stepping.progress import Progress, begin

Array = Array | np.ndarray
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

    forces: Array
    residual: Array
    retried: Array
    failed: Array


@partial(jax.tree_util.register_dataclass, data_fields=["model", "start"], meta_fields=["stepper"])
@dataclass(frozen=True)
class CoupledLines:
    """Lines between points that a JAX program moves: a pure component, to `jit`, `vmap`, `grad`, `scan` and shard.

        lines = dj.coupled_lines("mooring.txt", ["fairlead"])
        state = lines.init()
        state, outputs = lines.step(state, (positions, velocities), dt)                 # equal steps

        state = lines.init(follows=True)
        state, outputs = lines.follow(state, (positions, velocities), dt, accuracy)

    Attributes:
        model: the model; its leaves are the parameters. `replace(lines, model=...)` is the same scene with others.
        start: the state at t = 0. `dj.settle(lines.model, lines.start)` follows changes of the model.
        stepper: static settings; `replace(lines, stepper=lines.stepper.plain)` leaves out the fallback solvers.
    """

    model: Model
    start: State
    stepper: Stepper

    def init(self, start: State | None = None, follows: bool = False) -> CoupledState:
        """The state at t = 0, from `start` (default: that of the scene) with the points where the scene has them.

        Args:
            follows: for `follow`; otherwise for `step`.
        """
        motion = self._motion
        progress = begin(self.stepper, self.model, self.start if start is None else start, follows)
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
        dt = jnp.asarray(dt, self.model.dtype)

        def advance(lines: CoupledLines) -> tuple[Progress, Array, Array]:
            def one(_: Array, result: tuple[Any, ...]) -> tuple[Any, ...]:
                progress, residual, retried = result
                progress, taken = next_progress(lines.stepper, lines.model, progress, dt / count)
                # not `maximum`, which would lose a NaN
                worst = jnp.where(taken.row <= residual, residual, taken.row)
                return progress, worst, retried + taken.retried

            zero = jnp.zeros((), lines.model.dtype), jnp.zeros((), jnp.int32)
            return jax.lax.fori_loop(0, count, one, (state.progress, *zero))

        return self._over(state, inputs, dt, advance)

    def follow(
        self,
        state: CoupledState,
        inputs: PointMotion | tuple[Array, ...],
        dt: Array | float,
        accuracy: Array | float,
    ) -> tuple[CoupledState, CoupledOutputs]:
        """Advance by dt [s] in steps that follow an accuracy, the last of which ends with dt; as `step` otherwise.

        Derivatives exist in forward mode, with the lengths of the steps held constant.

        Args:
            state: from `init(follows=True)` and `follow`.
            accuracy: as `run.accuracy` of a scene.
        """
        dt = jnp.asarray(dt, self.model.dtype)
        accuracy = jnp.asarray(accuracy, self.model.dtype)

        def advance(lines: CoupledLines) -> tuple[Progress, Array, Array]:
            after, row = follow_and_save(lines.stepper, lines.model, state.progress, dt, accuracy)
            return after, row.residual, row.retried

        return self._over(state, inputs, dt, advance)

    def _over(
        self, state: CoupledState, inputs: PointMotion | tuple[Array, ...], dt: Array, advance: Callable[..., Any]
    ) -> tuple[CoupledState, CoupledOutputs]:
        """State and outputs after dt [s], over which `advance` takes the lines with their points on the way."""
        given = [jnp.asarray(a, self.model.dtype) for a in inputs if a is not None]
        motion = PointMotion(*given, *[jnp.zeros_like(given[0])] * (3 - len(given)))
        lines = self.moving(state.motion, motion, state.progress.t, dt)
        progress, residual, retried = advance(lines)
        forces = lines.forces(progress.state)
        return CoupledState(progress, motion, forces), CoupledOutputs(forces, residual, retried, progress.has_failed)

    def moving(self, since: PointMotion, to: PointMotion, t: Array | float, dt: Array | float) -> CoupledLines:
        """The lines with points that move from one motion to the other between t and t + dt [s]."""
        both = jax.tree.map(lambda *ends: jnp.stack(ends), since, to)
        if self._motion.accelerations is None:
            both = both._replace(accelerations=None)
        dtype = both.positions.dtype
        motion = replace(self._motion, begin=jnp.asarray(t, dtype), width=jnp.asarray(dt, dtype), **both._asdict())
        return replace(self, model=replace(self.model, effects=(*self.model.effects[:-1], motion)))

    def forces(self, s: State) -> Array:
        """Forces (c, 3) [N] on the points in a state."""
        return point_forces(self.model, s, self.indices)

    @property
    def mass(self) -> Array:
        """Mass (c,) [kg] of the halves of links at the points, added mass left out."""
        return half_link_mass(self.model, self.indices)

    @property
    def indices(self) -> tuple[int, ...]:
        """The coupled points among those of the model."""
        names = [p.name for p in self.model.points]
        return tuple(map(names.index, self._motion.points))

    @property
    def _motion(self) -> CoupledMotion:
        return self.model.having(CoupledMotion)[-1]


_forces = cached_jit()(CoupledLines.forces)


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
    points = coupled_points(scene, points)
    model = build_model(scene)
    if any(e.moves(name) for e in model.having(Displacement) for name in points):
        raise SceneError("points: already moved by an effect of the scene; allowed: fixed points")
    home = np.array([scene.point(name).position for name in points])
    rates = np.zeros_like(home) if velocities is None else np.asarray(velocities, float)
    motion = CoupledMotion.uniform(points, home, rates, accelerations)
    model = replace(model, effects=(*model.effects, motion)).cast(model.dtype)
    return CoupledLines(model, initial_state(model, scene.start), stepper_of(model, scene.run))


def coupled_points(scene: Scene, given: Sequence[str] | None) -> tuple[str, ...]:
    """The coupled points, checked."""
    held = scene.fixed_points
    if given is None:
        if len(held) != 1:
            raise SceneError(f"points: missing; needed: names of the fixed points that move: {', '.join(held)}")
        return tuple(held)
    names = (given,) if isinstance(given, str) else tuple(given)
    for i, name in enumerate(names):
        scene.check_fixed(name, f"points.{i}")
        if name in names[:i]:
            raise SceneError(f"points.{i}: {name!r} is a duplicate; allowed: every point once")
    if not names:
        raise SceneError(f"points: is empty; allowed: names of fixed points: {', '.join(held)}")
    return names
