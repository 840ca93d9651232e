"""The model: a frozen pytree of arrays, and the view of one instant that effects receive."""

from dropper_jax.model.check_slots import check_slots
from dropper_jax.model.effect import Effect, HeldMotion, HolonomicConstraint, Law, per_node
from dropper_jax.model.graph import Graph, LinkEnd, Member
from dropper_jax.model.kinematics import Ends, Frozen, Kinematics, ModelView
from dropper_jax.model.line import Failures, Line, Point
from dropper_jax.model.model import Model
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
from dropper_jax.model.state import Parted, State, as_parted, state
from dropper_jax.model.work import (
    BREAKING,
    MOVING_ENDS,
    Works,
    book_works,
    end_powers,
    non_conservative_forces,
    turning_work_name,
    work_names,
)

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
    "TurningMass",
    "Works",
    "as_parted",
    "at_pieces",
    "book_works",
    "check_slots",
    "end_powers",
    "non_conservative_forces",
    "per_node",
    "state",
    "sum_of_pieces",
    "turning_work_name",
    "work_names",
]
