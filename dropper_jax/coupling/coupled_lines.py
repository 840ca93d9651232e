"""Lines between points that a JAX program moves, as a pure component.

The force on a point is the sum of the tensions of its lines and of the loads on the half links that belong to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.records import names_of
from dropper_jax.effects.coupled_motion import CoupledMotion
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Displacement, HolonomicConstraint, Law, Model, State, as_parted
from dropper_jax.model.slots import Force
from dropper_jax.modelling.build import SceneLike, build_model, initial_state, stepper_of
from dropper_jax.residual import Stepper
from dropper_jax.stepping.adaptive import follow_and_save
from dropper_jax.stepping.equal_steps import next_progress
from dropper_jax.stepping.progress import Progress, begin

#: A NumPy or JAX array, and rows of numbers.
AnyArray = Array | np.ndarray
Vectors = Sequence[Sequence[float]] | AnyArray


class PointMotion(NamedTuple):
    """Positions [m], velocities [m/s] and accelerations [m/s^2] of the coupled points at one instant, each (c, 3)."""

    positions: AnyArray
    velocities: AnyArray
    accelerations: AnyArray | None = None


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


#: Lines after some steps: their progress, the maximum scaled residual, inner steps solved by the fallback.
Advanced = tuple[Progress, Array, Array]
#: Positions, velocities (and accelerations) of the points at the end of a step, each (c, 3).
Inputs = PointMotion | tuple[AnyArray, ...]


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
        self, state: CoupledState, inputs: Inputs, dt: AnyArray | float, count: AnyArray | int = 1
    ) -> tuple[CoupledState, CoupledOutputs]:
        """Advance by dt [s] in `count` equal steps of the scheme; see `Coupled` for path and forces.

        Args:
            inputs: motion of the points at the end of dt.
            count: a Python integer for derivatives in reverse mode.

        Returns:
            State and outputs. A step that fails raises nothing; `outputs.failed` stays true from then on.
        """
        dt = jnp.asarray(dt, self.model.dtype)

        def advance(lines: CoupledLines) -> Advanced:
            def one_step(_: Array, result: Advanced) -> Advanced:
                progress, residual, retried = result
                progress, taken = next_progress(lines.stepper, lines.model, progress, dt / count)
                return progress, jnp.maximum(residual, taken.row), retried + taken.retried

            start = state.progress, jnp.zeros((), lines.model.dtype), jnp.zeros((), jnp.int32)
            return jax.lax.fori_loop(0, count, one_step, start)

        return self._over(state, inputs, dt, advance)

    def follow(
        self,
        state: CoupledState,
        inputs: Inputs,
        dt: AnyArray | float,
        accuracy: AnyArray | float,
    ) -> tuple[CoupledState, CoupledOutputs]:
        """Advance by dt [s] in steps that follow an accuracy, the last of which ends with dt; as `step` otherwise.

        Derivatives exist in forward mode, with the lengths of the steps held constant.

        Args:
            state: from `init(follows=True)` and `follow`.
            accuracy: as `run.accuracy` of a scene.
        """
        dt = jnp.asarray(dt, self.model.dtype)
        accuracy = jnp.asarray(accuracy, self.model.dtype)

        def advance(lines: CoupledLines) -> Advanced:
            after, row = follow_and_save(lines.stepper, lines.model, state.progress, dt, accuracy)
            return after, row.residual, row.retried

        return self._over(state, inputs, dt, advance)

    def _over(
        self, state: CoupledState, inputs: Inputs, dt: Array, advance: Callable[[CoupledLines], Advanced]
    ) -> tuple[CoupledState, CoupledOutputs]:
        """State and outputs after dt [s], over which `advance` takes the lines while their points move."""
        given = [jnp.asarray(a, self.model.dtype) for a in inputs if a is not None]
        motion = PointMotion(*given, *[jnp.zeros_like(given[0])] * (3 - len(given)))
        lines = self.moving(state.motion, motion, state.progress.t, dt)
        progress, residual, retried = advance(lines)
        forces = lines.forces(progress.state)
        return CoupledState(progress, motion, forces), CoupledOutputs(forces, residual, retried, progress.has_failed)

    def moving(self, since: PointMotion, to: PointMotion, t: AnyArray | float, dt: AnyArray | float) -> CoupledLines:
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
        names = names_of(self.model.points)
        return tuple(map(names.index, self._motion.points))

    @property
    def _motion(self) -> CoupledMotion:
        return self.model.effects_with(CoupledMotion)[-1]


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
    if any(e.moves(name) for e in model.effects_with(Displacement) for name in points):
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


def set_free(model: Model, points: tuple[int, ...]) -> Model:
    """The model with these fixed points released, and those of its forces that act on any node.

    The first point of a single line stays fixed: no part of a link belongs to it.

    Raises:
        SceneError: compound links, whose ends share their inertia with the points.
    """
    line = model.line
    if line.compound:
        raise SceneError(
            "points: ends of compound links, whose inertia they share; allowed: points of point-mass links"
        )
    effects = []
    for effect in model.effects:
        of_some_nodes = isinstance(effect, (Law, HolonomicConstraint)) or effect.bodily or effect.single_line
        if not (isinstance(effect, Force) and of_some_nodes):
            effects.append(effect)
    freed = replace(line, geometry=line.geometry.without_fixed(points))
    return replace(model, lines=(freed,), effects=tuple(effects))


def point_forces(model: Model, s: State, points: tuple[int, ...]) -> Array:
    """Forces (c, 3) [N] on fixed points: tensions along their links and forces of effects."""
    acting = as_parted(model.with_internal_state(s.own), s.parted)
    graph = acting.geometry
    ends = acting.ends(s.t)
    links = acting.links(s.r, ends)
    held_forces = graph.held_force((s.tension / safe_norm(links))[:, None] * links)
    rows = [list(graph.held_points).index(point) for point in points]
    # forces of the effects on the nodes of the freed model
    free = set_free(model, points).with_internal_state(s.own)
    nodes = np.concatenate([np.arange(graph.inner), graph.point_node[free.geometry.free_points]])
    r = graph.everywhere(s.r, ends.positions)[nodes]
    velocities = jnp.zeros_like(ends.positions) if ends.velocities is None else ends.velocities
    v = graph.everywhere(s.v, velocities)[nodes]
    return held_forces[np.array(rows)] + _at_points(free, points, free.force(free.instant(r, v, s.t)))


def half_link_mass(model: Model, points: tuple[int, ...]) -> Array:
    """Mass (c,) [kg] of the halves of links at the points."""
    free = set_free(model, points)
    return _at_points(free, points, free.line.node_mass[:, None])[:, 0]


def _at_points(free: Model, points: tuple[int, ...], nodal: Array) -> Array:
    """Rows of the points of a field of the freed model (nodes, ...); zero for a point that stays fixed."""
    return free.geometry.everywhere(nodal, None)[free.geometry.point_node[list(points)]]
