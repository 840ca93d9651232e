"""Renamed public names: the old ones still work, each with one warning.

A module with a renamed name ends with `__getattr__ = old_names(__name__)`; a class has `__getattr__ = old_attribute`.
Old modules are found by `OldModules`, which the package installs. Readers of scenes and sites call `new_keys` and
`new_path`, the command line `new_option`, and writers of JSON `with_old_keys`, which warns of nothing.
"""

import importlib
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, NamedTuple

from dropper_jax.base.errors import SceneError


class Row(NamedTuple):
    """A name that was renamed.

    Attributes:
        kind: `module` (of the package `where`), `name` (of the module `where`), `attribute` (of the class `where`),
            `key` (of the section `where` of a scene or site), `option` (of the command `where`) or `json` (of the
            objects that the command `where` prints).
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
    Row("module", "dropper_jax.base", "place", "numerics", "0.2"),
    Row("module", "dropper_jax.base", "scatter", "numerics", "0.2"),
    Row("module", "dropper_jax.base", "progress", "errors", "0.2"),
    Row("module", "dropper_jax.cli", "codes", "dropper_jax.cli.options", "0.2"),
    Row("module", "dropper_jax.cli", "commands", "dropper_jax.cli", "0.2"),
    Row("module", "dropper_jax.cli", "output", "dropper_jax.cli.options", "0.2"),
    Row("module", "dropper_jax.view", "make", "dropper_jax.view", "0.2"),
    Row("module", "dropper_jax.study", "schemes", "dropper_jax.study.march", "0.2"),
    Row("module", "fitting.optimise", "picture", "run", "0.2"),
    Row("module", "fitting.parameters", "fitted", "of_scene", "0.2"),
    Row("module", "fitting.sensitivity", "screening", "derivatives", "0.2"),
    Row("module", "fitting.sensitivity", "quantities", "dropper_jax.run.quantities", "0.2"),
    Row("key", "effects.recorded_motion", "places", "positions", "0.2"),
    Row("key", "constraint", "least", "minimum", "0.2"),
    Row("key", "constraint", "most", "maximum", "0.2"),
    Row("option", "sweep", "--listed", "--paired", "0.2"),
    Row("option", "response", "--no-more", "--no-higher-waves", "0.2"),
    Row("option", "track", "--begin", "--from", "0.2"),
    Row("option", "track", "--end", "--until", "0.2"),
    Row("json", "design", "wanted", "required", "0.2"),
    Row("json", "equilibrium --tide", "moved_m", "displacement_m", "0.2"),
    Row("json", "report", "wanted_factor", "required_factor", "0.2"),
    Row("json", "report", "looked_every_s", "sampled_every_s", "0.2"),
    Row("attribute", "dropper_jax.effects.recorded_motion.RecordedMotion", "places", "positions", "0.2"),
    Row("name", "dropper_jax.base.numerics", "place", "scatter_add", "0.2"),
    Row("name", "dropper_jax.base.numerics", "summed", "scatter_add_many", "0.2"),
    Row("name", "dropper_jax", "followed_steps", "adaptive_step_lengths", "0.2"),
    Row("name", "dropper_jax.plots.style", "look", "plot_style", "0.2"),
    Row("name", "dropper_jax.plots.style", "styled", "with_style", "0.2"),
    Row("name", "fitting.traces.planar", "closed", "close_chain", "0.2"),
    Row("name", "fitting.report.pictures", "fitted", "fit_over_trace", "0.2"),
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
_KEYS = [row for row in RENAMED if row.kind == "key"]
_JSON = {row.new: row.old for row in RENAMED if row.kind == "json"}
_WARNED: set[Row] = set()
#: Part of every warning.
SINCE = "since version"


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


def new_keys(table: Mapping[str, Any]) -> Mapping[str, Any]:
    """Plain values of a scene or site with the new names of keys.

    Raises:
        SceneError: a key that has its old and its new name.
    """
    for row in _KEYS:
        table = _rename_key(table, tuple(row.where.split(".")), row)
    return table


def _rename_key(table: object, path: tuple[str, ...], row: Row) -> object:
    if isinstance(table, list):
        return [_rename_key(item, path, row) for item in table]
    if not isinstance(table, Mapping) or (path[0] if path else row.old) not in table:
        return table
    if path:
        return {**table, path[0]: _rename_key(table[path[0]], path[1:], row)}
    if row.new in table:
        raise SceneError(f"{row.where}.{row.old}: is the old name of {row.new!r}, which is given too. Use one of them")
    _warn(row)
    return {row.new if key == row.old else key: value for key, value in table.items()}


def new_path(path: str) -> str:
    """A path of a scene's value with the new name of its key."""
    for row in _KEYS:
        old = f"{row.where}.{row.old}"
        if path == old or path.startswith(f"{old}."):
            _warn(row)
            return f"{row.where}.{row.new}{path.removeprefix(old)}"
    return path


def new_option(command: str | None, word: str) -> str:
    """A word of the command line with the new name of an option."""
    name, equals, value = word.partition("=")
    row = _BY_OLD.get(("option", command, name))
    if row is None:
        return word
    _warn(row)
    return f"{row.new}{equals}{value}"


def with_old_keys(values: dict[str, Any]) -> dict[str, Any]:
    """An object of JSON with the old names of its scalar keys too."""
    old = {_JSON[key]: value for key, value in values.items() if key in _JSON and not isinstance(value, dict | list)}
    return {**values, **old} if old else values


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
        old, new = f"{row.where}.{row.old}", row.path
        if row.kind == "option":
            old, new = f"dropper {row.where} {row.old}", row.new
        warnings.warn(f"{old} is {new} {SINCE} {row.since}", DeprecationWarning, stacklevel=level)
