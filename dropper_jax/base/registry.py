"""Classes by name, each imported when it is first looked up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import TypeVar

T = TypeVar("T")


class Registry(MutableMapping[str, T]):
    """A dictionary of classes; a class given as the text `module:class` is imported when it is first looked up."""

    def __init__(self, paths: Mapping[str, str]) -> None:
        self.data: dict[str, T | str] = {**paths}

    def __setitem__(self, name: str, cls: T) -> None:
        self.data[name] = cls

    def __delitem__(self, name: str) -> None:
        del self.data[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, name: str) -> T:
        found = self.data[name]
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            found = getattr(import_module(module), attribute)
            self.data[name] = found
        return found
