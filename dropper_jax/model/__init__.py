"""The model: a frozen pytree of arrays, and the view of one instant that effects receive."""

from dropper_jax.model.check_slots import check_slots
from dropper_jax.model.effect import Effect, HeldMotion, HolonomicConstraint, Law, per_node
from dropper_jax.model.graph import Graph, LinkEnd, Member
from dropper_jax.model.kinematics import Ends, Frozen, Kinematics, ModelView
from dropper_jax.model.line import Failures, Line, Point
from dropper_jax.model.model import MOVING_ENDS, Forces, Model
from dropper_jax.model.slots import (
    AddedMass,
    ContactArea,
    CoupledMass,
    Displacement,
    ElementForce,
    LengthOverTime,
    LimitsTimeStep,
    Potential,
    TurningMass,
    at_pieces,
    sum_of_pieces,
)
from dropper_jax.model.state import BREAKING, Parted, State, Works, as_parted, book_works, state, turning, work_names

__all__ = [
    "AddedMass",
    "BREAKING",
    "ContactArea",
    "CoupledMass",
    "Displacement",
    "Effect",
    "Ends",
    "Failures",
    "Frozen",
    "Graph",
    "HeldMotion",
    "Kinematics",
    "Law",
    "Line",
    "LinkEnd",
    "MOVING_ENDS",
    "Member",
    "Model",
    "ModelView",
    "Parted",
    "LengthOverTime",
    "LimitsTimeStep",
    "ElementForce",
    "Point",
    "Potential",
    "State",
    "HolonomicConstraint",
    "Forces",
    "TurningMass",
    "Works",
    "as_parted",
    "at_pieces",
    "book_works",
    "check_slots",
    "per_node",
    "state",
    "sum_of_pieces",
    "turning",
    "work_names",
]
