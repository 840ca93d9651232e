"""Parameters by path: numbers of a model's pytree, and of what saw its motion.

Paths are those of scenes: `effects.linear_damping.b_l`, `line.0.mass`, `line.0.mass.2`, `point.right.position.0`; and

    camera.offset           rotation of the camera, added to every measured angle
    marker.offset[.J]       rotation of a link's marker or encoder relative to the link, added to its own angle
    marker.node[.I[.0]]     offset of a node's marker from it, along (.0) and across (.1) the link that ends there
    rig.scale               common factor of all lengths and positions
    clock.rate              factor that stretches the traces' time
    clock.lost.RUN.FRAME    time that is missing before a frame
    release.time, .force    see `release`
    recording.NAME.zero.J, .scale, .delay   of a further recording of the same motion (`recordings`)

A field with one value per link frees one parameter per entry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import Field, fields
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, Values
from dropper_jax.model import Model
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import (
    CAMERA,
    CLOCK,
    LOST,
    MARKER,
    NODE,
    SCALE,
    CameraTarget,
    ClockTarget,
    LostTarget,
    ModelTarget,
    NodeMarkerTarget,
    RigScale,
)


class Released(Protocol):
    """Provider of the parameters of `release.*` names."""

    def parameters(self, name: str, option: str) -> list[Parameter]: ...


def resolve(
    model: Model,
    names: Sequence[str],
    option: str = "free",
    release: Released | None = None,
) -> tuple[Parameter, ...]:
    """The free parameters of these paths.

    Args:
        names: paths; the path of a field with several values frees each of them.
        option: heading of error messages about `names`.
        release: provides the `release.*` names.

    Raises:
        SceneError: a path that does not exist (with the nearest one).
    """
    found: list[Parameter] = []
    for name in names:
        if release is not None and name.startswith("release."):
            found += release.parameters(name, option)
        else:
            found += _expand(model, name, option)
    return tuple(found)


class _Number(NamedTuple):
    """Where a model has a number: a section, the number of the item in it, the declared field."""

    section: str
    index: int
    field: Field


def paths(model: Model) -> list[str]:
    """Every path of the model that can be free."""
    return [CAMERA, MARKER, NODE, SCALE, CLOCK, f"{LOST}.RUN.FRAME", *_numbers(model)]


def _numbers(model: Model) -> dict[str, _Number]:
    """Every number of the model by path; points and lines by their name and by their number."""
    found = {}
    for word, section in (("point", "points"), ("line", "lines"), ("effects", "effects")):
        for i, item in enumerate(getattr(model, section)):
            labels = [item.name]
            if section != "effects":
                labels.insert(0, str(i))
            for f in fields(item):
                if f.metadata.get("kind") == "parameter" and getattr(item, f.name) is not None:
                    for label in labels:
                        found[f"{word}.{label}.{f.name}"] = _Number(section, i, f)
    return found


def _expand(model: Model, name: str, option: str) -> list[Parameter]:
    """The parameters of one path."""
    if name == SCALE:
        return [Parameter(SCALE, RigScale(), 1.0, 0.5, 2.0, unit="m/m")]
    kind = ".".join(name.split(".")[:2])
    if kind == LOST:
        return [_lost_frame(name, option)]
    seen = [p for p in _observers(model) if p.name == name or ("." in name and p.name.startswith(name + "."))]
    if seen:
        return seen
    if kind == MARKER:
        raise SceneError(f"{option}: {name!r}: unknown link; allowed: {kind}.0 to {kind}.{model.line.links - 1}")
    if kind == NODE:
        allowed = f"{kind}.0 to {kind}.{count_joints(model) - 1}, each .0 or .1"
        raise SceneError(f"{option}: {name!r}: unknown node; allowed: {allowed}")
    return _of_model(model, name, option)


def _lost_frame(name: str, option: str) -> Parameter:
    """The time that is missing before a frame."""
    _, entries = ScenePath(name).entry_of((LOST,)) or (name, ())
    if len(entries) != 2:
        raise SceneError(f"{option}: {name!r} gives no frame; allowed: {LOST}.RUN.FRAME, both counted from 0")
    return Parameter(name, LostTarget(*entries), 0.0, unit="s")


def _observers(model: Model) -> list[Parameter]:
    """Parameters of the camera, the clock and all markers."""
    found = [
        Parameter(CAMERA, CameraTarget(), 0.0, unit="rad"),
        Parameter(CLOCK, ClockTarget(), 1.0, 0.5, 2.0, unit="s/s"),
    ]
    for i in range(model.line.links):
        found.append(Parameter(f"{MARKER}.{i}", CameraTarget(i), 0.0, unit="rad"))
    for i, axis in product(range(count_joints(model)), (0, 1)):
        found.append(Parameter(f"{NODE}.{i}.{axis}", NodeMarkerTarget(i, axis), 0.0, unit="m"))
    return found


def _of_model(model: Model, name: str, option: str) -> list[Parameter]:
    """The parameters of a field of the model, one for each entry that acts, or of one entry."""
    known = _numbers(model)
    found = ScenePath(name).entry_of(known)
    if found is None or len(found[1]) > 1:
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(name, paths(model))}")
    stem, entries = found
    section, index, field = known[stem]
    value = np.asarray(getattr(getattr(model, section)[index], field.name))
    if value.ndim == 0 and entries in ((), (0,)):
        return [_parameter(name, ModelTarget(section, index, field.name), float(value), field.metadata)]
    count = min(value.size, _acting_entries(model, section, field, value.size))
    if entries and entries[0] >= count:
        raise SceneError(f"{option}: {name!r}: unknown entry; allowed: 0 to {count - 1}")
    parameters = []
    for i in entries or range(count):
        where = ModelTarget(section, index, field.name, i)
        parameters.append(_parameter(f"{stem}.{i}", where, float(value.flat[i]), field.metadata))
    return parameters


def _acting_entries(model: Model, section: str, field: Field, size: int) -> int:
    """Number of entries of a field that act: a free end has no joint, a fixed end no moving node."""
    shape = field.metadata["shape"] if section == "effects" else None
    if shape == "joint":
        return count_joints(model)
    mass_of_nodes = field.name == "mass" and section == "lines" and not model.line.compound and model.geometry.is_path
    if shape == "node" or mass_of_nodes:
        return model.free_nodes
    return size


def count_joints(model: Model) -> int:
    """Number of joints, and of nodes with a marker: one at the start of each link, and one at a fixed end."""
    if model.both_ends_fixed:
        return model.line.links + 1
    return model.line.links


#: Distance of the bound from a limit that must not be reached (0 of a mass, of a length), over the start value.
OPEN_BOUND_MARGIN = 1e-3


def _parameter(name: str, where: ModelTarget, value: float, meta: Values) -> Parameter:
    """A number of the model with the bounds of its declared field."""
    low, high = declared_bounds(meta, value)
    return Parameter(name, where, value, float(low), high, meta["unit"])


def declared_bounds(meta: Values, value: float | np.ndarray) -> tuple[float | np.ndarray, float]:
    """Both reachable bounds of a declared field with this value; a limit that must not be reached is not one."""
    low = -np.inf if meta.get("low") is None else meta["low"]
    high = np.inf if meta.get("high") is None else meta["high"]
    if meta.get("above") is not None:
        low = meta["above"] + OPEN_BOUND_MARGIN * np.abs(value)
    return low, float(high)
