"""The interface of a model for effects and kinematics."""

from __future__ import annotations

from typing import Protocol, TypeVar

import jax

from dropper_jax.model.geometry import Ends, Geometry
from dropper_jax.model.line import Line, Point
from dropper_jax.sea import Sea

Role = TypeVar("Role")


class ModelView(Protocol):
    """A model without its motion; `dropper_jax.model.model.Model` implements it."""

    @property
    def line(self) -> Line: ...

    @property
    def geometry(self) -> Geometry: ...

    @property
    def points(self) -> tuple[Point, ...]: ...

    @property
    def sea(self) -> Sea | None: ...

    @property
    def free_nodes(self) -> int: ...

    @property
    def node_mass(self) -> jax.Array: ...

    def having(self, slot: type[Role]) -> tuple[Role, ...]: ...

    def node(self, line: str | int, j: int) -> int: ...

    def nodes(self, r: jax.Array, ends: Ends, rates: bool = False) -> jax.Array: ...

    def links(self, r: jax.Array, ends: Ends) -> jax.Array: ...

    def rates(self, v: jax.Array, ends: Ends | None) -> jax.Array: ...

    def gather(self, pull: jax.Array) -> jax.Array: ...
