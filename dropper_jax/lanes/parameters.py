"""The parameters of an operation of JAX, whose names change with its version."""

from __future__ import annotations

from typing import Any, NoReturn


class Unreadable(Exception):
    """An operation whose parameters have other names in this JAX; its name."""


class Parameters(dict[str, Any]):
    """The parameters of an operation of a traced function, by name.

    Raises:
        Unreadable: where a name is read that the operation does not have.
    """

    def __init__(self, eqn: Any) -> None:
        super().__init__(eqn.params)
        self.operation = eqn.primitive.name

    def __missing__(self, name: str) -> NoReturn:
        raise Unreadable(self.operation)
