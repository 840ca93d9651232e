"""Free parameters: numbers of a model's pytree by path, with bounds from the declarations of the fields.

Paths are those of scenes: `effects.linear_damping.b_l`, `line.0.mass`, `line.0.mass.2`, `point.right.position.0`; and

    camera.offset           rotation of the camera, added to every measured angle
    marker.offset[.J]       rotation of a link's marker or encoder relative to the link, added to its own angle
    marker.node[.I[.0]]     offset of a node's marker from it, along (.0) and across (.1) the link that ends there
    rig.scale               common factor of all lengths and positions
    clock.rate              factor that stretches the traces' time
    clock.lost.RUN.FRAME    time that is missing before a frame
    release.time, .force    see `release`
    recording.NAME.zero.J, .scale, .delay   of a further recording of the same motion (`recordings`)

A field with one value per link frees one parameter per entry. Bounds apply to raw parameters (no exponential), so that
a damping of exactly 0 is reachable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, dataclass, fields, replace
from typing import Any, Protocol, TypeVar

import jax
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, declared_fields, limits
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from fitting.parameters.targets import (
    CAMERA,
    CLOCK,
    LOST,
    MARKER,
    NODE,
    SCALE,
    CameraPlace,
    ClockPlace,
    Direction,
    LostPlace,
    MissingForce,
    ModelPlace,
    NodeMarkerPlace,
    RecordingPlace,
    ReleasePlace,
    SetupPlace,
    scale_direction,
)

Observer = CameraPlace | NodeMarkerPlace | ClockPlace | LostPlace | RecordingPlace
Target = ModelPlace | Direction | SetupPlace | Observer | ReleasePlace | MissingForce


#: Start values, bounds and priors (mean, standard deviation) by path.
StartValues = Mapping[str, float]
Bounds = Mapping[str, tuple[float | None, float | None]]
Priors = Mapping[str, tuple[float, float]]
#: What is given by path.
V = TypeVar("V")

#: Step size of a parameter that starts at zero [its own unit], unless its prior gives one.
SIZES_AT_ZERO = {"b_l": 1e-3, "b_q": 1e-3, "viscous": 1e-4, "dry": 1e-4, "time": 1e-2, CAMERA: 1e-2}
SIZES_AT_ZERO |= {NODE: 1e-3, LOST: 1e-2, "zero": 1e-2, "delay": 1e-3}


@dataclass(frozen=True)
class Parameter:
    """One free number.

    Attributes:
        name: its path.
        where: its position in the model, at the camera or at a release.
        value: start value.
        low, high: bounds, both reachable.
        unit: as printed.
        prior: mean and standard deviation of a normal prior, or None.
    """

    name: str
    where: Target
    value: float
    low: float = -np.inf
    high: float = np.inf
    unit: str = "-"
    prior: tuple[float, float] | None = None

    @property
    def in_model(self) -> bool:
        """Whether it is a single number of the model, or one field of it."""
        return isinstance(self.where, ModelPlace)

    @property
    def moves_model(self) -> bool:
        """Whether it is a number of the scene, which moves many numbers of the model at once."""
        return isinstance(self.where, Direction)

    @property
    def is_idle(self) -> bool:
        """Whether it is a number of the scene without effect on the model."""
        return isinstance(self.where, Direction) and not self.where.slopes

    @property
    def is_lost(self) -> bool:
        """Whether it is the time of lost frames."""
        return isinstance(self.where, LostPlace)

    @property
    def scale(self) -> float:
        """A typical size for steps and plots."""
        if self.value != 0:
            return abs(self.value)
        return SIZES_AT_ZERO.get(self.where.field, 1.0)


def names_in_scene(parameters: Iterable[Parameter]) -> list[str]:
    """Names of the parameters that a scene or its release has, without those of recordings."""
    return [p.name for p in parameters if not isinstance(p.where, RecordingPlace)]


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
        SceneError: a path that does not exist (with the nearest one), or is given twice.
    """
    found: list[Parameter] = []
    for name in names:
        released = release is not None and name.startswith("release.")
        found += release.parameters(name, option) if released else _expand(model, name, option)
    check_once([p.name for p in found], option)
    return adjust_parameters(found)


def adjust_parameters(
    parameters: Sequence[Parameter],
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    wider: bool = False,
) -> tuple[Parameter, ...]:
    """The parameters with start values, bounds and priors given by path.

    Args:
        start: start values by path, otherwise the parameters' own.
        bounds: (low, high) by path, inside the declared range; None keeps the declared one.
        priors: (mean, standard deviation) by path.
        wider: whether bounds may lie outside the parameters' own, which are a guess.

    Raises:
        SceneError: a path that is not free, an empty interval, a start outside it, a prior without width.
    """
    known = [p.name for p in parameters]
    values = _for_each("start", start, known)
    ends = _for_each("bounds", bounds, known)
    known_before = _for_each("prior", priors, known)
    return tuple(_adjust(p, values, ends, known_before, wider) for p in parameters)


def _for_each(which: str, given: Mapping[str, V] | None, names: Sequence[str]) -> dict[str, V]:
    """Given values by parameter name: the value of a field applies to each of its entries."""
    found: dict[str, V] = {}
    for name, value in (given or {}).items():
        mine = [name] if name in names else [p for p in names if p.startswith(name + ".")]
        if not mine:
            raise SceneError(f"{which}: {name!r} is not a free parameter; {nearest(name, names)}")
        found.update(dict.fromkeys(mine, value))
    return found


def check_once(names: Sequence[str], option: str) -> None:
    """Reject a duplicate name."""
    for i, name in enumerate(names):
        if name in names[:i]:
            raise SceneError(f"{option}: {name!r} is given twice; allowed: every parameter once")


def _adjust(p: Parameter, start: StartValues, bounds: Bounds, priors: Priors, wider: bool) -> Parameter:
    low, high = bounds.get(p.name, (None, None))
    least, most = (-np.inf, np.inf) if wider else (p.low, p.high)
    low = p.low if low is None else max(low, least)
    high = p.high if high is None else min(high, most)
    value = float(start.get(p.name, min(max(p.value, low), high)))
    if not low <= high:
        raise SceneError(f"bounds: {p.name!r}: empty interval {low:g} to {high:g}; allowed: low <= high")
    if not low <= value <= high:
        allowed = limits({"low": low, "high": high, "unit": p.unit})
        raise SceneError(f"start: {p.name} = {value:g} is out of bounds; allowed: {allowed}")
    prior = priors.get(p.name, p.prior)
    if prior is not None and not (0 < prior[1] < np.inf and np.isfinite(prior[0])):
        allowed = limits({"low": 0.0, "open_low": True, "unit": p.unit})
        raise SceneError(f"prior: {p.name!r} has standard deviation {prior[1]:g}; allowed: {allowed}")
    return replace(p, value=value, low=low, high=high, prior=prior)


def paths(model: Model) -> list[str]:
    """Every path of the model that can be free."""
    return [CAMERA, MARKER, NODE, SCALE, CLOCK, f"{LOST}.RUN.FRAME", *_fields(model)]


def _fields(model: Model) -> dict[str, tuple[str, int, Field]]:
    """Section, number in it and field of every number of the model, by path."""
    sections = (("point", "points"), ("line", "lines"), ("effects", "effects"))
    items = [(word, section, i, item) for word, section in sections for i, item in enumerate(getattr(model, section))]
    found = {}
    for word, section, i, item in items:
        for label in [item.name] if section == "effects" else [str(i), item.name]:
            for f in fields(item):
                if f.metadata.get("kind") == "parameter" and getattr(item, f.name) is not None:
                    found[f"{word}.{label}.{f.name}"] = (section, i, f)
    return found


def _expand(model: Model, name: str, option: str) -> list[Parameter]:
    kind = ".".join(name.split(".")[:2])
    if name == SCALE:
        return [Parameter(SCALE, scale_direction(model), 1.0, 0.5, 2.0, unit="m/m")]
    if kind == LOST:
        _, entries = ScenePath(name).entry_of((LOST,)) or (name, ())
        if len(entries) != 2:
            raise SceneError(f"{option}: {name!r} gives no frame; allowed: {LOST}.RUN.FRAME, both counted from 0")
        return [Parameter(name, LostPlace(*entries), 0.0, unit="s")]
    found = [p for p in _observers(model) if p.name == name or ("." in name and p.name.startswith(name + "."))]
    if found:
        return found
    if kind in (MARKER, NODE):
        if kind == MARKER:
            what = "link"
            last = model.line.links
            axes = ""
        else:
            what = "node"
            last = _joints(model)
            axes = ", each .0 or .1"
        raise SceneError(f"{option}: {name!r}: unknown {what}; allowed: {kind}.0 to {kind}.{last - 1}{axes}")
    known = _fields(model)
    found = ScenePath(name).entry_of(known)
    if found is None or len(found[1]) > 1:
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(name, paths(model))}")
    stem, entries = found
    section, index, field = known[found[0]]
    value = np.asarray(getattr(getattr(model, section)[index], field.name))
    if value.ndim == 0 and not entries:
        return [_parameter(name, ModelPlace(section, index, field.name), float(value), field.metadata)]
    flat = value.reshape(-1)
    count = min(len(flat), _entries(model, section, field, len(flat)))
    if entries and entries[0] >= count:
        raise SceneError(f"{option}: {name!r}: unknown entry; allowed: 0 to {count - 1}")
    entries = entries or range(count)
    targets = [(i, ModelPlace(section, index, field.name, i)) for i in entries]
    return [_parameter(f"{stem}.{i}", target, float(flat[i]), field.metadata) for i, target in targets]


def _observers(model: Model) -> list[Parameter]:
    """Parameters of the camera, the clock and all markers."""
    links = [Parameter(f"{MARKER}.{i}", CameraPlace(i), 0.0, unit="rad") for i in range(model.line.links)]
    markers = [NodeMarkerPlace(i, axis) for i in range(_joints(model)) for axis in (0, 1)]
    nodes = [Parameter(f"{NODE}.{at.node}.{at.axis}", at, 0.0, unit="m") for at in markers]
    camera = Parameter(CAMERA, CameraPlace(), 0.0, unit="rad")
    return [camera, Parameter(CLOCK, ClockPlace(), 1.0, 0.5, 2.0, unit="s/s"), *links, *nodes]


def _entries(model: Model, section: str, field: Field, size: int) -> int:
    """Number of entries of a field that act: a free end has no joint, a fixed end no moving node."""
    shape = field.metadata["shape"]
    if section == "effects" and shape == "joint":
        return _joints(model)
    of_nodes = (section == "effects" and shape == "node") or (
        section == "lines" and field.name == "mass" and not model.line.compound and model.geometry.is_path
    )
    if of_nodes:
        return model.free_nodes
    return size


def _joints(model: Model) -> int:
    """Number of joints, and of nodes with a marker."""
    return model.line.links + (1 if model.end_held else 0)


#: A bound that must not be reached (of a mass, a length).
OFF_BOUND = 1e-3


def _parameter(name: str, where: Target, value: float, meta: Mapping[str, Any]) -> Parameter:
    low = -np.inf if meta["low"] is None else float(meta["low"])
    if meta["open_low"]:
        low += OFF_BOUND * abs(value)
    return Parameter(name, where, value, low, np.inf if meta["high"] is None else float(meta["high"]), meta["unit"])


def apply(model: Model, parameters: Sequence[Parameter], values: jax.Array) -> Model:
    """The model with these values (k,); differentiable."""
    for kind in (ModelPlace, Direction):  # setting a value must not undo an earlier direction
        for i, p in enumerate(parameters):
            if isinstance(p.where, kind):
                model = p.where.set_in(model, values[i])
    return model


def given_effect(scene: Scene, path: str) -> Any:
    """The value of a path `effects.NAME.FIELD` that a scene gives; None if it gives none."""
    _, effect, field = path.split(".")
    return scene.effects.get(effect, {}).get(field)


def with_effects(scene: Scene, names: Sequence[str]) -> Scene:
    """The scene with value 0 for damping parameters that it lacks, so that its model has them."""
    zero = {
        f"effects.{effect}.{key}"
        for effect, cls in EFFECTS.items()
        for key, field in declared_fields(cls).items()
        if field.metadata["kind"] == "parameter" and field.metadata["low"] == 0.0
    }
    stems = [ScenePath(name).stem for name in names]
    found = {path: 0.0 for path in stems if path in zero and given_effect(scene, path) is None}
    if found:
        return scene.with_values(found)
    return scene
