"""Renamed public Python names: the old ones still work, each with one warning.

A module with a renamed name ends with `__getattr__ = old_names(__name__)`; a class has `__getattr__ = old_attribute`.
Old modules are found by `OldModules`, which the package installs.
"""

import importlib
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import NamedTuple


class Row(NamedTuple):
    """A name that was renamed.

    Attributes:
        kind: `module` (of the package `where`), `name` (of the module `where`) or `attribute` (of the class `where`).
        new: its new name; with dots the whole path.
        since: first version with the new name.
    """

    kind: str
    where: str
    old: str
    new: str
    since: str

    @property
    def path(self) -> str:
        """The new name with its module."""
        return self.new if "." in self.new else f"{self.where}.{self.new}"


RENAMED = (
    Row("module", "dropper_jax.base", "place", "scatter", "0.2"),
    Row("module", "fitting.sensitivity", "quantities", "dropper_jax.run.quantities", "0.2"),
    Row("name", "dropper_jax.base.scatter", "place", "scatter_add", "0.2"),
    Row("name", "dropper_jax.base.scatter", "summed", "scatter_add_many", "0.2"),
    Row("name", "dropper_jax", "followed_steps", "adaptive_step_lengths", "0.2"),
    Row("name", "dropper_jax.plots.style", "look", "plot_style", "0.2"),
    Row("name", "dropper_jax.plots.style", "styled", "with_style", "0.2"),
    Row("name", "fitting.traces.planar", "closed", "close_chain", "0.2"),
    Row("attribute", "dropper_jax.model.geometry.Ends", "places", "positions", "0.2"),
    Row("attribute", "dropper_jax.model.kinematics.Kinematics", "seen", "compute_once", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "advanced", "advance_internal_state", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "begun", "initial_internal_state", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "entered", "with_internal_state", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "lumped", "lump_mass", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "own_inertia", "nodal_inertia", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "pull", "tension_force", "0.2"),
    Row("attribute", "dropper_jax.model.model.Model", "ties", "constraints", "0.2"),
    Row("attribute", "fitting.tracking.track.Tracked", "look", "appearance", "0.2"),
    Row("attribute", "fitting.tracking.track.Tracked", "seen", "detected", "0.2"),
)
_BY_OLD = {(row.kind, row.where, row.old): row for row in RENAMED}
_WARNED: set[Row] = set()


def old_names(module: str, above: int = 0) -> Callable[[str], object]:
    """`__getattr__` of a module with renamed names; `above`: number of calls between it and the user."""

    def get(name: str) -> object:
        row = _BY_OLD.get(("name", module, name))
        if row is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        _warn(row, 3 + above)
        return getattr(sys.modules[module], row.new)

    return get


def old_attribute(thing: object, name: str) -> object:
    """`__getattr__` of a class with renamed attributes."""
    for cls in type(thing).__mro__:
        row = _BY_OLD.get(("attribute", f"{cls.__module__}.{cls.__qualname__}", name))
        if row is not None:
            _warn(row)
            return getattr(thing, row.new)
    raise AttributeError(f"{type(thing).__name__!r} object has no attribute {name!r}")


class OldModules(MetaPathFinder, Loader):
    """Finds modules under their old names."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if ("module", *name.rpartition(".")[::2]) in _BY_OLD else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        row = _BY_OLD["module", *spec.name.rpartition(".")[::2]]
        _warn(row)
        module = importlib.import_module(row.path)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # importing it under the old name replaced the module object


def _warn(row: Row, level: int = 3) -> None:
    if row not in _WARNED:
        _WARNED.add(row)
        text = f"{row.where}.{row.old} is {row.path} since version {row.since}"
        warnings.warn(text, DeprecationWarning, stacklevel=level)
