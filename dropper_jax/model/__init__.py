"""The model: a frozen pytree of arrays, and the view of one instant that effects receive."""

from dropper_jax.model.broken_links import Parted, as_parted
from dropper_jax.model.check_slots import check_slots
from dropper_jax.model.effect import Effect, HeldMotion, HolonomicConstraint, Law, per_node
from dropper_jax.model.failures import Failures
from dropper_jax.model.geometry import Ends, Geometry, Member
from dropper_jax.model.graph import Graph
from dropper_jax.model.kinematics import Frozen, Kinematics
from dropper_jax.model.line import Line, Point
from dropper_jax.model.model import MOVING_ENDS, Forces, Model
from dropper_jax.model.path import Path, gather_links, link_differences
from dropper_jax.model.pieces import at_pieces, sum_of_pieces
from dropper_jax.model.shares import Part
from dropper_jax.model.slots import AddedMass, ContactArea, CoupledMass, Displacement, ElementForce, LimitsTimeStep
from dropper_jax.model.state import State, state
from dropper_jax.model.view import ModelView
from dropper_jax.model.work import BREAKING, Works, book_works, turning, work_names

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
    "Geometry",
    "Graph",
    "HeldMotion",
    "Kinematics",
    "Law",
    "Line",
    "MOVING_ENDS",
    "Member",
    "Model",
    "ModelView",
    "Part",
    "Parted",
    "LimitsTimeStep",
    "Path",
    "ElementForce",
    "Point",
    "State",
    "HolonomicConstraint",
    "Forces",
    "Works",
    "as_parted",
    "at_pieces",
    "book_works",
    "check_slots",
    "gather_links",
    "link_differences",
    "per_node",
    "state",
    "sum_of_pieces",
    "turning",
    "work_names",
]
