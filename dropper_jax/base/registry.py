"""Classes by name, each imported when it is first looked up."""

from __future__ import annotations

from collections import UserDict
from importlib import import_module
from typing import TypeVar

T = TypeVar("T")


class Registry(UserDict[str, T]):
    """A dictionary of classes; a class given as the text `module:class` is imported when it is first looked up."""

    def __getitem__(self, name: str) -> T:
        found = self.data[name]
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            found = self.data[name] = getattr(import_module(module), attribute)
        return found
