"""Interfaces of time integrators: `Implicit`, `Explicit`, and `Embedded` with an error estimate."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.read import Values, read_number
from dropper_jax.model import AddedMass, Model, ModelView, State
from dropper_jax.residual.problem import StepProblem


class LocalError(NamedTuple):
    """The error of one step in positions, from the accelerations a0, a1 that two steps h0, h [s] report in the state.

        e = constant h^3 (a1 - a0)/(h + lag (h - h0))

    Attributes:
        constant: of the third derivative of positions.
        lag: time of a reported acceleration after the end of its step, as a fraction of that step.
        inertia: factor of `M x/h^2` in the rows of the nodes.
    """

    constant: float
    lag: float
    inertia: float


@dataclasses.dataclass(frozen=True)
class Integrator:
    """A time integrator: `Implicit` or `Explicit`. Static: its fields are part of the compiled program.

    Options of a scheme are numbers declared as fields by `base.fields.parameter` with the allowed range;
    they are the keys of `[run]` of the same name.
    """

    name: ClassVar[str]
    #: Design order of convergence in positions.
    order: ClassVar[int]
    #: Whether a step solves equations.
    implicit: ClassVar[bool] = True
    #: Fractions of the substeps (compositions have several).
    stages: ClassVar[tuple[float, ...]] = (1.0,)

    @property
    def holds_length(self) -> bool:
        """Whether rigid links keep their lengths by construction; schemes with drift are stopped at `DRIFT_LIMIT`."""
        return True

    @property
    def tension_time(self) -> float:
        """Time of the reported tension within the step: 0.5 for step averages, 1.0 for values at the new time."""
        return 1.0

    @property
    def dissipates(self) -> bool:
        """Whether the scheme has numerical damping at any step."""
        return False

    @property
    def local_error(self) -> LocalError | None:
        """The error of a step by the accelerations of two steps; None if it is not known."""
        return None

    @property
    def follows_accuracy(self) -> bool:
        """Whether the error of a step is known, so that steps can follow a required accuracy."""
        return self.local_error is not None

    @property
    def evaluations(self) -> int:
        """Evaluations of the equations in a step, for comparisons by counted work.

        A stage that solves equations counts three: the usual number of Newton corrections.
        """
        return (3 if self.implicit else 1) * len(self.stages)

    def __post_init__(self) -> None:
        for name, declared in self.options().items():
            read_number(getattr(self, name), f"run.{name}", declared)

    @classmethod
    def options(cls) -> dict[str, Values]:
        """The declared options: meaning and range by name."""
        return {f.name: f.metadata for f in dataclasses.fields(cls)}

    def form_for(self, model: Model) -> Integrator:
        """The form of this scheme for the model; most schemes have a single form."""
        return self

    def refuse(self, model: Model) -> str | None:
        """Why this integrator cannot run the model, or None."""
        return None

    def begin(self, model: Model, s: State) -> State:
        """The state with the additional variables of this scheme besides positions and velocities."""
        return s

    def problem(self, model: Model, s: State, h: Array) -> StepProblem:
        """The equations of one step, of an implicit scheme."""
        raise NotImplementedError

    def advance(self, model: Model, s: State, h: Array) -> State:
        """One step of an explicit scheme."""
        raise NotImplementedError

    def change_step(self, model: Model, s: State, h: Array) -> State:
        """The state from which steps of h [s] continue smoothly after one of another length."""
        return s


@dataclasses.dataclass(frozen=True)
class Implicit(Integrator, ABC):
    """A scheme whose step solves equations."""

    #: Whether `condensed` pieces exist.
    condensable: ClassVar[bool] = False
    #: Whether the pieces of the network solver exist, and so whether systems of lines can be run.
    networkable: ClassVar[bool] = False
    #: Fraction of the tolerance at which corrections of a line end: rounding, so that energy is conserved.
    enough: ClassVar[float] = 1e-5
    #: Whether it runs rigid links between constant point masses only.
    point_masses: ClassVar[bool] = False
    #: Whether every row involves neighbouring nodes only.
    local_rows: ClassVar[bool] = True
    #: Whether effects with their own unknowns (dry friction) are supported.
    takes_laws: ClassVar[bool] = False
    #: Whether rigid bodies (`model.HolonomicConstraint`) are supported.
    takes_constraints: ClassVar[bool] = False

    @abstractmethod
    def equations(self, model: Model, s: State, h: Array) -> StepProblem:
        """The equations of one step of a model that includes the internal states of its effects."""

    def problem(self, model: Model, s: State, h: Array) -> StepProblem:
        return self.equations(model.with_internal_state(s.own).with_lengths(s.t, h), s, h)

    def refuse(self, model: Model) -> str | None:
        if self.point_masses and (reason := point_masses_only(model)):
            return reason
        if not model.geometry.is_path and not self.networkable:
            elastic = ""
            if model.line.axial.elastic:
                elastic = ", rk2, rk4, semi_implicit_euler"
            return f"it runs single lines only; use energy_momentum, theta_midpoint{elastic}"
        if model.line.failures is not None and not self.networkable:
            return "it has no links that break; use energy_momentum, theta_midpoint, rk2 or rk4"
        if model.laws and not self.takes_laws:
            return _law_not_taken(model)
        if model.constraints and not self.takes_constraints:
            return _BODIES_NOT_TAKEN
        return super().refuse(model)


@dataclasses.dataclass(frozen=True)
class Explicit(Integrator, ABC):
    """An explicit scheme, for lines that stretch."""

    implicit: ClassVar[bool] = False

    def refuse(self, model: Model) -> str | None:
        if not model.line.axial.elastic:
            return "explicit schemes need tensions that follow from lengths, but the links are rigid; set axial.law"
        if model.constraints:
            return _BODIES_NOT_TAKEN
        if couples_inertia(model):
            return "added mass couples neighbouring nodes here; use energy_momentum"
        if not all(law.of_state for law in model.laws):
            return _law_not_taken(model)
        return super().refuse(model)


@dataclasses.dataclass(frozen=True)
class Embedded(Explicit):
    """An explicit scheme that estimates the error of its step."""

    #: h b/m up to which steps are stable; b/m [1/s] is the rate at which damping stops a node.
    stable: ClassVar[float]

    @property
    def follows_accuracy(self) -> bool:
        return True

    @abstractmethod
    def advance_with_error(self, model: Model, s: State, h: Array, tolerance: Array) -> tuple[State, Array]:
        """One step, and its error relative to a tolerance, of the scheme's order in h; not differentiated."""

    def advance(self, model: Model, s: State, h: Array) -> State:
        return self.advance_with_error(model, s, h, jnp.ones((), model.dtype))[0]


def couples_inertia(model: ModelView) -> bool:
    """Whether added mass couples neighbouring nodes, so that accelerations need more than each node's own mass."""
    added = model.effects_with(AddedMass)
    return bool(added) and (model.line.compound or any(e.reach > 0 for e in added))


def point_masses_only(model: Model) -> str | None:
    """Why a scheme of rigid links that eliminates node by node cannot run the model, or None."""
    if model.line.axial.elastic:
        return "it keeps the lengths of links, but the line is elastic; use energy_momentum, rk2 or rk4"
    if model.line.compound:
        return "it needs masses on the nodes, but compound links couple them; use energy_momentum"
    if model.effects_with(AddedMass):
        return "it needs constant masses on the nodes, but the scene has added mass; use energy_momentum"
    return None


_BODIES_NOT_TAKEN = "the scene has rigid bodies, which it does not support; use energy_momentum"


def _law_not_taken(model: Model) -> str:
    name = model.laws[0].name
    other = ""
    if name == "seabed_friction":
        other = ", or law = 'regularised'"
    return f"effect {name!r} has a set-valued law, which it does not solve; use energy_momentum{other}"
