"""What an integrator provides: one step as a set of unknowns, residual rows and the state they lead to."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.model.effect import has
from dropper_jax.model.model import Model
from dropper_jax.model.state import State
from dropper_jax.residual.unknowns import Unknowns

GRAVITY_SCALE = 9.81  # [m/s^2]; only sizes residuals, the scene's own gravity is an effect's parameter


@dataclass(frozen=True)
class Integrator:
    """A time integrator. Static: its fields are part of the compiled program."""

    name: ClassVar[str]
    #: Design order of convergence in positions.
    order: ClassVar[int]
    #: Fractions of the step taken one after another (compositions have several).
    stages: ClassVar[tuple[float, ...]] = (1.0,)
    #: Whether the step solves equations; explicit ones define `advance` instead of `problem`.
    implicit: ClassVar[bool] = True
    #: Whether `condensed` pieces exist.
    condensable: ClassVar[bool] = False
    #: Whether the pieces of the network solver exist, and so whether systems of lines can be run.
    networkable: ClassVar[bool] = False
    #: Whether every row involves neighbouring nodes only.
    local_rows: ClassVar[bool] = True
    #: Whether effects with unknowns of their own (dry friction) can be solved along.
    takes_laws: ClassVar[bool] = False
    #: Newton iterations with an exact Jacobian, and with the condensed one.
    iterations: ClassVar[int] = 4
    condensed_iterations: ClassVar[int] = 12
    #: Whether rigid links keep their lengths by construction; schemes that drift are stopped at `DRIFT_LIMIT`.
    holds_length: ClassVar[bool] = True
    #: Where in the step the reported tension belongs: 0.5 for step averages, 1.0 for values at the new time.
    tension_time: ClassVar[float] = 1.0

    def suited(self, model: Model) -> Integrator:
        """The form of this scheme for the model; most have one for all."""
        return self

    def refuse(self, model: Model) -> str | None:
        """Why this integrator cannot run the model, or None."""
        if model.branched and self.implicit and not self.networkable:
            return "it runs single lines only; use energy_momentum, theta_midpoint, rk2, rk4 or semi_implicit_euler"
        if model.line.failures is not None and not (self.networkable or not self.implicit):
            return "it has no links that break; use energy_momentum, theta_midpoint, rk2 or rk4"
        if model.laws and not self.takes_laws:
            name = model.laws[0].name
            return f"effect {name!r} brings a set-valued law, which it does not solve; use energy_momentum"
        return None

    def begin(self, model: Model, s: State) -> State:
        """The state with what this scheme carries beyond places and velocities."""
        return s

    def problem(self, model: Model, s: State, h: jax.Array) -> StepProblem:
        raise NotImplementedError

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        """One explicit step."""
        raise NotImplementedError


class StepProblem:
    """The equations of one step from state `s` over `h`; made anew inside each trace."""

    #: Smoothing of set-valued laws, 1 to 0; None is the laws themselves.
    easing: jax.Array | None = None

    def __init__(self, model: Model, s: State, h: jax.Array):
        self.model, self.s, self.h = model, s, h

    def guess(self) -> Unknowns:
        raise NotImplementedError

    def residual(self, u: Unknowns) -> Unknowns:
        """Rows in physical units: forces [N], elongations [m], torques [N m]."""
        raise NotImplementedError

    def eased(self, easing: jax.Array) -> StepProblem:
        """The same equations with smoothed laws."""
        other = copy(self)
        other.easing = easing
        return other

    def node_matrix(self, u: Unknowns) -> jax.Array:
        """K of the condensed solver, (nodes, 3, 3), or (nodes,) where it is a multiple of the unit matrix."""
        raise NotImplementedError

    def condensed(self, u: Unknowns) -> CondensedParts:
        """The rest of the condensed matrix."""
        raise NotImplementedError

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        """For the network solver: force rows (nodes, 3) without the links' tensions, and the rows of laws."""
        raise NotImplementedError

    def link_vectors(self, x: jax.Array) -> jax.Array:
        """For the network solver: link vectors (n, 3) [m] at the unknowns; they change as x does."""
        raise NotImplementedError

    def link_rows(self, d: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """For the network solver: pull of each link (n, 3) [N] and its axial row (n,) [m]."""
        raise NotImplementedError

    def finish(self, u: Unknowns) -> State:
        """The state at the end of the step."""
        raise NotImplementedError

    def row_scale(self) -> Unknowns:
        """Sizes of the rows: max(m g, m L/h^2) on nodes, L on links, the laws' own."""
        model, h = self.model, self.h
        line = model.line
        force = model.node_mass * jnp.maximum(GRAVITY_SCALE, model.node_length / h**2)
        laws = zip(model.laws, self.s.law, strict=True)
        z = tuple(jnp.broadcast_to(law.law_scale(line, h), guess.shape) for law, guess in laws)
        return Unknowns(force[:, None], line.length, z)

    def column_scale(self) -> Unknowns:
        """Sizes of the unknowns."""
        raise NotImplementedError


def constant_force(model: Model) -> bool:
    """Whether no force of the model depends on positions or velocities."""
    return all(e.constant for e in model.effects if has(e, "force"))


def node_blocks(local, nodes: int, dtype) -> jax.Array:  # noqa: ANN001
    """Diagonal 3x3 blocks (nodes, 3, 3) of a node-local map x -> rows, from three directions of forward mode."""
    axes = jnp.eye(3, dtype=dtype)
    zero = jnp.zeros((nodes, 3), dtype)
    columns = jax.vmap(lambda axis: jax.jvp(local, (zero,), (jnp.broadcast_to(axis, (nodes, 3)),))[1])(axes)
    return jnp.moveaxis(columns, 0, -1)


class CondensedParts(NamedTuple):
    """The matrix without K, in pieces.

    Attributes:
        pull: nodal force of unit tensions along (n, 3).
        gradient: derivative of the axial rows with respect to link differences of x, (n, 3).
        compliance: minus their derivative with respect to the tensions, (n,).
    """

    pull: jax.Array
    gradient: jax.Array
    compliance: jax.Array
