"""One implicit step as a set of unknowns, residual rows and the resulting state."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.constants import GRAVITY
from dropper_jax.model import Effect, ElementForce, Kinematics, Model, State


class Unknowns(NamedTuple):
    """Unknowns of a step, or its rows, or sizes of either.

    Attributes:
        x: per free node, (nodes, 3).
        y: per link, (n,): tensions; as rows: the axial laws.
        z: per law of an effect, (joints, c) each.
    """

    x: jax.Array
    y: jax.Array
    z: tuple[jax.Array, ...] = ()


def add(a: Unknowns, b: Unknowns, factor: float = 1.0) -> Unknowns:
    """a + factor b."""
    return jax.tree.map(lambda p, q: p + factor * q, a, b)


def norm(rows: Unknowns, scale: Unknowns) -> jax.Array:
    """Maximum scaled entry, a scalar; NaN if any entry is."""
    sizes = [jnp.max(jnp.abs(r) / s) for r, s in zip(jax.tree.leaves(rows), jax.tree.leaves(scale), strict=True)]
    return jnp.max(jnp.stack(sizes))


GRAVITY_SCALE = GRAVITY  # [m/s^2]; only scales residuals, the gravity of the scene is a parameter of an effect


class CondensedParts(NamedTuple):
    """The parts of the matrix without K.

    Attributes:
        force: nodal force of unit tensions along (n, 3).
        gradient: derivative of the axial rows with respect to link differences of x, (n, 3).
        compliance: minus their derivative with respect to the tensions, (n,).
    """

    force: jax.Array
    gradient: jax.Array
    compliance: jax.Array


class StepProblem:
    """The equations of one step from state `s` over `h`; created again in each trace."""

    #: Smoothing of set-valued laws, 1 to 0; None means the laws themselves.
    easing: jax.Array | None = None

    def __init__(self, model: Model, s: State, h: jax.Array) -> None:
        self.model, self.s, self.h = model.lump_mass(), s, h

    @property
    def pieces(self) -> tuple[ElementForce, ...]:
        """Forces in the rows that couple nodes element by element."""
        return self.model.pieces

    def guess(self) -> Unknowns:
        raise NotImplementedError

    def residual(self, u: Unknowns) -> Unknowns:
        """Rows in physical units: forces [N], elongations [m], torques [N m]."""
        raise NotImplementedError

    def evaluate(self, u: Unknowns) -> tuple[Unknowns, Any]:
        """The rows, and the intermediate values for `finish`."""
        return self.residual(u), None

    def with_smoothing(self, easing: jax.Array) -> StepProblem:
        """The same equations with smoothed laws."""
        other = copy(self)
        other.easing = easing
        return other

    def acting(self, effects: tuple[Effect, ...]) -> StepProblem:
        """The same equations with only these effects of the model, with their frozen values."""
        other = copy(self)
        other.model = replace(self.model, effects=effects)
        return other

    def instant(self, x: jax.Array) -> Kinematics:
        """Positions and velocities at which forces act at the unknowns x; those of each node depend only on its own
        x."""
        raise NotImplementedError

    def node_matrix(self, u: Unknowns) -> jax.Array:
        """K of the condensed solver, (nodes, 3, 3), or (nodes,) if it is a multiple of the unit matrix."""
        raise NotImplementedError

    def condensed_parts(self, u: Unknowns) -> CondensedParts:
        """The rest of the condensed matrix."""
        raise NotImplementedError

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        """For the network solver: force rows (nodes, 3) without the links' tensions, and the rows of laws."""
        raise NotImplementedError

    def link_vectors(self, x: jax.Array) -> jax.Array:
        """For the network solver: link vectors (n, 3) [m] at the unknowns; they change as x does."""
        raise NotImplementedError

    def link_rows(self, d: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """For the network solver: force of each link (n, 3) [N] and its axial row (n,) [m]."""
        raise NotImplementedError

    def finish(self, u: Unknowns, evaluated: Any = None) -> State:
        """The state at the end of the step; `evaluated` is the result of `evaluate` at u, if available."""
        raise NotImplementedError

    def end_state(
        self, r: jax.Array, v: jax.Array, tension: jax.Array, work: Callable[[], jax.Array], **more: Any
    ) -> State:
        """The state at the end of the step from its positions and velocities (nodes, 3), tensions (n,) and work
        (k,)."""
        model, s, t = self.model, self.s, self.s.t + self.h
        own = s.own
        if own:
            own = model.advance_internal_state(
                model.kinematics(s.r, s.v, s.t), model.kinematics(r, v, t), tension, self.h
            )
        done = s.work + work() if s.work.size else s.work
        return replace(s, r=r, v=v, tension=tension, t=t, work=done, own=own, **{"angles": None, **more})

    def row_scale(self) -> Unknowns:
        """Sizes of the rows: max(m g, m L/h^2) on nodes, L on links, and those of the laws."""
        model, h = self.model, self.h
        line = model.line
        force = model.node_mass * jnp.maximum(GRAVITY_SCALE, model.node_length / h**2)
        laws = zip(model.laws, self.s.law, strict=False)  # then multipliers
        z = tuple(jnp.broadcast_to(law.law_scale(line, h), guess.shape) for law, guess in laws)
        return Unknowns(
            force[:, None], line.length, z + tuple(constraint.gap_size(model) for constraint in model.constraints)
        )

    def column_scale(self) -> Unknowns:
        """Sizes of the unknowns: x by `unknown_size`, tensions by mean weights or inertia, those of the laws as their
        rows."""
        line = self.model.line
        force = jnp.mean(line.mass) * jnp.maximum(GRAVITY_SCALE, jnp.mean(line.length) / self.h**2)
        laws = self.row_scale().z[: len(self.model.laws)]
        pulls = tuple(constraint.force_size(self.model) for constraint in self.model.constraints)
        return Unknowns(self.unknown_size(), jnp.broadcast_to(force, line.length.shape), laws + pulls)

    def unknown_size(self) -> jax.Array:
        """Size of x, (nodes, 1): a length [m]."""
        return self.model.node_length[:, None]


class SpeedProblem(StepProblem):
    """Equations of rigid links between point masses whose unknown x is a speed, with tensions along the first links."""

    def __init__(self, model: Model, s: State, h: jax.Array) -> None:
        super().__init__(model, s, h)
        self.ends0, self.ends1 = model.ends(s.t), model.ends(s.t + h)
        self.mass = model.line.node_mass
        self.pull0 = self.unit_forces(model.links(s.r, self.ends0))

    def unit_forces(self, links: jax.Array) -> jax.Array:
        """Forces (n, 3) of unit tensions in links (n, 3) [m]."""
        return links / self.model.line.length[:, None]

    def unknown_size(self) -> jax.Array:
        """Size of x, (nodes, 1) [m/s]: a link's length per step."""
        return self.model.line.length[: self.model.free_nodes, None] / jnp.abs(self.h)


def node_blocks(local: Callable[[jax.Array], jax.Array], nodes: int, dtype: jnp.dtype) -> jax.Array:
    """Diagonal 3x3 blocks (nodes, 3, 3) of a node-local map x -> rows, from three directions of forward mode."""
    axes = jnp.eye(3, dtype=dtype)
    zero = jnp.zeros((nodes, 3), dtype)
    columns = jax.vmap(lambda axis: jax.jvp(local, (zero,), (jnp.broadcast_to(axis, (nodes, 3)),))[1])(axes)
    return jnp.moveaxis(columns, 0, -1)
