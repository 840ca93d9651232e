"""What moves, as effects and kinematics see it: how nodes, links and held ends belong together."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

import jax

from dropper_jax.model.line import Line
from dropper_jax.sea import Sea


class Ends(NamedTuple):
    """Held ends of a line: positions and velocities, (3,) [m], [m/s]; `end` is None where the end is free."""

    start: jax.Array
    end: jax.Array | None
    start_velocity: jax.Array | None = None
    end_velocity: jax.Array | None = None


Role = TypeVar("Role")


class Geometry(Protocol):
    """A model, less its motion; `dropper_jax.model.model.Model` is one."""

    @property
    def line(self) -> Line: ...

    @property
    def sea(self) -> Sea | None: ...

    @property
    def end_held(self) -> bool: ...

    @property
    def free_nodes(self) -> int: ...

    @property
    def node_mass(self) -> jax.Array: ...

    def having(self, slot: type[Role]) -> tuple[Role, ...]: ...

    def node(self, line: str | int, j: int) -> int: ...

    def nodes(self, r: jax.Array, ends: Ends, rates: bool = False) -> jax.Array: ...

    def links(self, r: jax.Array, ends: Ends) -> jax.Array: ...

    def differences(self, free: jax.Array, ends: Ends | None, rates: bool = False) -> jax.Array: ...
