"""Classes by name, each imported when it is first looked up."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping
from importlib import import_module
from typing import Any, TypeVar

T = TypeVar("T")


class Registry(UserDict[str, T]):
    """A dictionary of classes; a class given as the text `module:class` is imported when it is first looked up."""

    def __init__(self, paths: Mapping[str, Any]) -> None:
        super().__init__(paths)

    def __getitem__(self, key: str) -> T:
        found = self.data[key]
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            found = self.data[key] = getattr(import_module(module), attribute)
        return found
