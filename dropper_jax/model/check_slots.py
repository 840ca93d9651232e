"""Check, once when a model is built, that the results of an effect have the shapes and precision of its slots.

A force of shape (3,) would otherwise be added to every node, and one in another precision would change that of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
                raise _refuse(effect, method, _shape_in_words(one), _shape_in_words(other))


def _refuse(effect: Effect, method: str, found: str, wanted: str) -> SceneError:
    return SceneError(f"effects.{effect.name}.{method}: returns {found}; needed: {wanted}")


def _shape_in_words(one: jax.ShapeDtypeStruct) -> str:
    return f"shape {one.shape} of {one.dtype}"


def _slots(model: Model, effect: Effect) -> Iterator[Slot]:
    free = model.free_nodes
    number = _array(model)
    vectors = _array(model, free, 3)
    own = jax.eval_shape(model.initial_internal_state)

    def result(method: Callable[..., Any], *more: jax.ShapeDtypeStruct) -> Any:
        """Result of a method of the effect at one instant, with more arguments."""

        def call(r: Array, v: Array, t: Array, at_entry: Any, *rest: Array) -> Any:
            inside = model.with_internal_state(at_entry)
            return method(inside.effect(effect.name), inside.instant(r, v, t), *rest)

        return jax.eval_shape(call, vectors, vectors, number, own, *more)

    if isinstance(effect, Force):
        yield "force", result(lambda e, k: e.force(k)), vectors
    if isinstance(effect, Potential):
        yield "potential", result(lambda e, k: e.potential(k)), number
    if isinstance(effect, AddedMass):
        yield "inertia", result(lambda e, k, a: e.inertia(k, a), vectors), vectors
        yield "kinetic", result(lambda e, k: e.kinetic(k)), number
    if isinstance(effect, LimitsTimeStep):
        yield "too_far", result(lambda e, k: e.too_far(k, k)), jax.ShapeDtypeStruct((), jnp.bool_)
    if isinstance(effect, Stateful):
        tension = _array(model, model.geometry.links)
        yield "advance", result(lambda e, k, *rest: e.advance(k, k, *rest), tension, number), own[effect.name]
    if isinstance(effect, PointMass):
        yield "point_mass", jax.eval_shape(lambda: effect.point_mass(model)), _array(model, free)
    if isinstance(effect, ContactArea):
        yield "contact_area", jax.eval_shape(lambda: effect.contact_area(model)), _array(model, free)
    if isinstance(effect, Displacement):
        yield "displace", jax.eval_shape(lambda t: model.displacement(effect, t), number), _array(model, 3)
    if isinstance(effect, Law) and effect.components:
        z = _array(model, effect.rows(model), effect.components)
        yield "law_force", result(lambda e, k, z: e.law_force(k, z), z), vectors
        yield "law_residual", result(lambda e, k, z, h: e.law_residual(k, z, h), z, number), z
    if isinstance(effect, ElementForce):
        each = _array(model, *effect.piece_nodes(model).shape, 3)
        yield "piece_force", result(lambda e, k, r, v: e.piece_force(k, r, v), each, each), each


def _array(model: Model, *shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, model.dtype)
