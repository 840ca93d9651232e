"""Free parameters: numbers with start values, bounds from the declarations of their fields, and priors.

Bounds apply to raw parameters (no exponential), so that a damping of exactly 0 is reachable. `paths` finds them by
path.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, declared_fields, limits
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from fitting.parameters.targets import (
    CAMERA,
    LOST,
    NODE,
    CameraTarget,
    ClockTarget,
    Direction,
    LostTarget,
    MissingForce,
    ModelTarget,
    NodeMarkerTarget,
    RecordingTarget,
    ReleaseTarget,
    RigScale,
    SetupTarget,
)

Observer = CameraTarget | NodeMarkerTarget | ClockTarget | LostTarget | RecordingTarget
Target = ModelTarget | Direction | RigScale | SetupTarget | Observer | ReleaseTarget | MissingForce


#: Start values, bounds and priors (mean, standard deviation) by path.
StartValues = Mapping[str, float]
Bounds = Mapping[str, tuple[float | None, float | None]]
Priors = Mapping[str, tuple[float, float]]
#: What is given by path.
Given = TypeVar("Given")

#: Typical size of a parameter that starts at zero [its own unit], by its field.
SIZES_AT_ZERO = {
    "b_l": 1e-3,
    "b_q": 1e-3,
    "viscous": 1e-4,
    "dry": 1e-4,
    "time": 1e-2,
    "zero": 1e-2,
    "delay": 1e-3,
    CAMERA: 1e-2,
    NODE: 1e-3,
    LOST: 1e-2,
}


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
        return isinstance(self.where, ModelTarget)

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
        return isinstance(self.where, LostTarget)

    @property
    def bounds_in_words(self) -> str:
        """Its finite bounds with their unit, such as `>= 0 kg/s`."""
        ends = {"low": self.low, "high": self.high}
        return limits({key: end for key, end in ends.items() if np.isfinite(end)} | {"unit": self.unit})

    @property
    def scale(self) -> float:
        """A typical size for steps and plots."""
        if self.value != 0:
            return abs(self.value)
        return SIZES_AT_ZERO.get(self.where.field, 1.0)


def names_in_scene(parameters: Iterable[Parameter]) -> list[str]:
    """Names of the parameters that a scene or its release has, without those of recordings."""
    return [p.name for p in parameters if not isinstance(p.where, RecordingTarget)]


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
        SceneError: a path that is not free, an empty interval, a start outside it, a prior without mean or width.
    """
    known = [p.name for p in parameters]
    given_starts = _for_each("start", start, known)
    given_bounds = _for_each("bounds", bounds, known)
    given_priors = _for_each("prior", priors, known)
    return tuple(_adjust(p, given_starts, given_bounds, given_priors, wider) for p in parameters)


def _for_each(which: str, given: Mapping[str, Given] | None, names: Sequence[str]) -> dict[str, Given]:
    """Given values by parameter name: the value of a field applies to each of its entries."""
    found: dict[str, Given] = {}
    for name, value in (given or {}).items():
        mine = [name]
        if name not in names:
            mine = [p for p in names if p.startswith(name + ".")]
        if not mine:
            raise SceneError(f"{which}: {name!r} is not a free parameter; {nearest(name, names)}")
        found.update(dict.fromkeys(mine, value))
    return found


def check_once(parameters: Sequence[Parameter], option: str) -> None:
    """Reject a duplicate name, and two names of the same number, which no data can tell apart.

    Raises:
        SceneError: with the name or both names.
    """
    first: dict[str | Target, str] = {}
    for p in parameters:
        if p.name in first:
            raise SceneError(f"{option}: {p.name!r} is given twice; allowed: every parameter once")
        if p.where in first:
            raise SceneError(
                f"{option}: {first[p.where]!r} and {p.name!r} are the same number; allowed: every number once"
            )
        first[p.name] = p.name
        first[p.where] = p.name


def _adjust(p: Parameter, start: StartValues, bounds: Bounds, priors: Priors, wider: bool) -> Parameter:
    """The parameter with what is given for its name."""
    low, high = bounds.get(p.name, (None, None))
    if low is None:
        low = p.low
    elif not wider:
        low = max(low, p.low)
    if high is None:
        high = p.high
    elif not wider:
        high = min(high, p.high)
    if not low <= high:
        raise SceneError(f"bounds: {p.name!r}: empty interval {low:g} to {high:g}; allowed: low <= high")
    value = float(start.get(p.name, min(max(p.value, low), high)))
    p = replace(p, value=value, low=low, high=high)
    if not low <= value <= high:
        raise SceneError(f"start: {p.name} = {value:g} is out of bounds; allowed: {p.bounds_in_words}")
    prior = priors.get(p.name, p.prior)
    if prior is not None and not np.isfinite(prior[0]):
        raise SceneError(f"prior: {p.name!r} has mean {prior[0]:g}; allowed: a number")
    if prior is not None and not 0 < prior[1] < np.inf:
        allowed = limits({"above": 0.0, "unit": p.unit})
        raise SceneError(f"prior: {p.name!r} has standard deviation {prior[1]:g}; allowed: {allowed}")
    return replace(p, prior=prior)


def with_parameter_values(model: Model, parameters: Sequence[Parameter], values: Array) -> Model:
    """The model with these values (k,); differentiable."""
    for kind in (ModelTarget, Direction, RigScale):  # setting a value must not undo an earlier change
        for i, p in enumerate(parameters):
            if isinstance(p.where, kind):
                model = p.where.set_in(model, values[i])
    return model


def given_effect(scene: Scene, path: str) -> Any:
    """The value of a path `effects.NAME.FIELD` that a scene gives; None if it gives none."""
    _, effect, field = path.split(".")
    return scene.effects.get(effect, {}).get(field)


def with_zero_damping(scene: Scene, names: Sequence[str]) -> Scene:
    """The scene with value 0 for damping parameters that it lacks, so that its model has them."""
    stems = [ScenePath(name).stem for name in names]
    found = {}
    for effect, cls in EFFECTS.items():
        for key, field in declared_fields(cls).items():
            path = f"effects.{effect}.{key}"
            about = field.metadata
            may_be_zero = about["kind"] == "parameter" and 0.0 in (about["low"], about["above"])
            if path in stems and may_be_zero and given_effect(scene, path) is None:
                found[path] = 0.0
    if found:
        return scene.with_values(found)
    return scene
