"""Check, once when a model is built, that the results of an effect have the shapes and precision of its slots.

A force of shape (3,) would otherwise be added to every node, and one in another precision would change that of the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.model.effect import Effect, Law
from dropper_jax.model.model import Model
from dropper_jax.model.slots import (
    AddedMass,
    ContactArea,
    Displacement,
    ElementForce,
    Force,
    LimitsTimeStep,
    PointMass,
    Potential,
    Stateful,
)

#: A method, what it returns, and what it should return.
Slot = tuple[str, Any, Any]


def check_slots(model: Model, effect: Effect) -> None:
    """Reject an effect whose results have other shapes or another precision than its slots; nothing is computed.

    Raises:
        SceneError: with the effect, the method, what it returns and what is needed.
    """
    for method, found, wanted in _slots(model, effect):
        if jax.tree.structure(found) != jax.tree.structure(wanted):
            raise _refuse(effect, method, str(jax.tree.structure(found)), str(jax.tree.structure(wanted)))
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
            if one.shape != other.shape or one.dtype != other.dtype:
                raise _refuse(effect, method, _words(one), _words(other))


def _refuse(effect: Effect, method: str, found: str, wanted: str) -> SceneError:
    return SceneError(f"effects.{effect.name}.{method}: returns {found}; needed: {wanted}")


def _words(one: jax.ShapeDtypeStruct) -> str:
    return f"shape {one.shape} of {one.dtype}"


def _slots(model: Model, effect: Effect) -> Iterator[Slot]:
    free = model.free_nodes
    number = _array(model)
    vectors = _array(model, free, 3)
    own = jax.eval_shape(model.initial_internal_state)

    def results(method: str, *more: jax.ShapeDtypeStruct, instants: int = 1) -> Any:
        """Results of a method of one instant, or of both ends of a step."""

        def call(r: Array, v: Array, t: Array, at_entry: Any, *rest: Array) -> Any:
            inside = model.with_internal_state(at_entry)
            return getattr(inside.effect(effect.name), method)(*[inside.instant(r, v, t)] * instants, *rest)

        return jax.eval_shape(call, vectors, vectors, number, own, *more)

    for slot, method, more, instants, wanted in (
        (Force, "force", (), 1, vectors),
        (Potential, "potential", (), 1, number),
        (AddedMass, "inertia", (vectors,), 1, vectors),
        (AddedMass, "kinetic", (), 1, number),
        (LimitsTimeStep, "too_far", (), 2, jax.ShapeDtypeStruct((), jnp.bool_)),
        (Stateful, "advance", (_array(model, model.geometry.links), number), 2, own.get(effect.name)),
    ):
        if isinstance(effect, slot):
            yield method, results(method, *more, instants=instants), wanted
    for slot, method in ((PointMass, "point_mass"), (ContactArea, "contact_area")):
        if isinstance(effect, slot):
            yield method, jax.eval_shape(partial(getattr(effect, method), model)), _array(model, free)
    if isinstance(effect, Displacement):
        yield "displace", jax.eval_shape(lambda t: model.displacement(effect, t), number), _array(model, 3)
    if isinstance(effect, Law) and effect.components:
        z = _array(model, effect.rows(model), effect.components)
        yield "law_force", results("law_force", z), vectors
        yield "law_residual", results("law_residual", z, number), z
    if isinstance(effect, ElementForce):
        each = _array(model, *effect.piece_nodes(model).shape, 3)
        yield "piece_force", results("piece_force", each, each), each


def _array(model: Model, *shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, model.dtype)
