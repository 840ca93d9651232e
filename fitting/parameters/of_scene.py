"""Parameters that are numbers of the scene, not of the model: the length of a whole line, EA of a line type, a buoy.

Such a number changes many numbers of the model at once (the length of a line its links' lengths, masses and internal
damping). Their derivatives are found by differences on the host, once; in the compiled program the model changes along
that direction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, declared_fields
from dropper_jax.load.paths import describe, locate_written
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model, model_slopes
from dropper_jax.scene import PriorSpec
from fitting.parameters.parameter import (
    CAMERA,
    SCALE,
    Bounds,
    Direction,
    ModelPlace,
    Parameter,
    Priors,
    Released,
    StartValues,
    check_once,
    given_effect,
    paths,
    resolve,
)

#: A model that this change moves linearly to within `LINEAR_TOLERANCE` counts as linear in the number.
LINEAR_REACH = 0.2
LINEAR_TOLERANCE = 1e-9


def find_parameters(
    scene: Scene, model: Model, names: Sequence[str], option: str, idle: bool = False
) -> tuple[Parameter, ...]:
    """The parameters of these paths: numbers of the model, otherwise of the scene.

    If lines are specified by the metre, paths have the same meaning as in the file: `line.leg.length` is the whole
    line.

    Args:
        idle: whether a number of the scene may be without effect on the model.

    Raises:
        SceneError: a path that is neither.
    """
    found: list[Parameter] = []
    written = locate_written(scene.as_written())
    for name in names:
        if name in written or ScenePath(name).section == "parameters":
            found.append(scene_parameter(scene, model, name, idle))
            continue
        try:
            found += resolve(model, [name], option=option)
        except SceneError as error:
            try:
                found.append(scene_parameter(scene, model, name, idle))
            except SceneError:
                raise error from None
    check_once([p.name for p in found], option)
    return tuple(found)


def scene_parameter(scene: Scene, model: Model, path: str, idle: bool = False) -> Parameter:
    """The number of the scene at a path, and its effect on the model, which may be none if it may be `idle`.

    Raises:
        SceneError: no such path, not a number, a number without effect on the model, or one that changes its shape.
    """
    slopes = model_slopes(scene, model, path, idle)
    value: Any = scene.value(path)
    shift = LINEAR_REACH * (abs(value) or 1.0)
    here, there = (
        [np.asarray(leaf) for leaf in jax.tree.leaves(build_model(scene.with_values({path: at})))]
        for at in (value, value + shift)
    )
    linear = all(
        np.allclose(
            here[i] + shift * slope,
            there[i],
            rtol=LINEAR_TOLERANCE,
            atol=LINEAR_TOLERANCE * np.max(np.abs(here[i])),
        )
        for i, slope in slopes.items()
    )
    if ScenePath(path).section == "parameters":
        unit = _moved_unit(model, slopes)
    else:
        # lengths along a line are in lists that have no declaration
        if ScenePath(path).key in ("length", "at"):
            unit = "m"
        else:
            unit = describe(path).get("unit", "-")
    # a number keeps its sign
    low = 0.0 if value > 0 else -np.inf
    high = 0.0 if value < 0 else np.inf
    return Parameter(path, Direction(slopes, value, linear), value, low, high, unit)


def _moved_unit(model: Model, slopes: Iterable[int]) -> str:
    """Unit of the model's leaves of these numbers if they share one, otherwise `-`."""
    keys = [path for path, _ in jax.tree_util.tree_flatten_with_path(model)[0]]
    units = set()
    for leaf in slopes:
        item: Any = model
        for key in keys[leaf][:-1]:
            item = item[key.idx] if hasattr(key, "idx") else getattr(item, key.name)
        declared = declared_fields(type(item)).get(getattr(keys[leaf][-1], "name", ""))
        units.add("-" if declared is None else declared.metadata.get("unit", "-"))
    if len(units) == 1:
        return units.pop()
    return "-"


def free_of_traces(
    scene: Scene, model: Model, names: Sequence[str], release: Released | None = None
) -> tuple[Parameter, ...]:
    """The free parameters of a fit to angles: numbers of the model, camera, clock and release, and of `[parameters]`.

    A number of `[parameters]` ties the values that the scene computes from it.

    Raises:
        SceneError: a path that does not exist, or a number of `[parameters]` that moves the model non-linearly.
    """
    found: list[Parameter] = []
    for name in names:
        if ScenePath(name).section != "parameters":
            found += resolve(model, [name], release=release)
            continue
        tied = scene_parameter(scene, model, name)
        if isinstance(tied.where, Direction) and not tied.where.linear:
            raise SceneError(
                f"free: {name!r} changes the model non-linearly, which fits to angles do not follow; allowed: numbers "
                'whose values are proportional to them, such as b_l = ["= head", "= head", "= tail"]'
            )
        found.append(tied)
    check_once([p.name for p in found], "free")
    return tuple(found)


# A scene with fitted values, ready to simulate


def fitted_scene(scene: Scene, model: Model, parameters: Sequence[Parameter], values: np.ndarray) -> Scene:
    """The scene with the values (k,) of those parameters that belong to it, without sensors' and cameras'.

    One entry of a number that the scene gives once for all links is written together with the other entries.

    Args:
        model: the fitted one.
    """
    for p, value in zip(parameters, values, strict=True):
        if scene.branched and p.in_model and p.where.section == "lines":
            scene = _of_all_lines(scene, p.where, float(value))
            continue
        try:
            scene.value(p.name)
        except SceneError:
            if p.in_model:
                whole = np.asarray(getattr(getattr(model, p.where.section)[p.where.index], p.where.field), float)
                scene = scene.with_values({ScenePath(p.name).stem: whole.tolist()})
        else:
            scene = scene.with_values({p.name: float(value)})
    return scene


def _of_all_lines(scene: Scene, where: ModelPlace, value: float) -> Scene:
    """The scene with a value of one link, counted among those of all lines, as in the model of a system."""
    ends = np.cumsum([line.links for line in scene.lines])
    i = int(np.searchsorted(ends, where.entry or 0, side="right"))
    line = scene.lines[i]
    each = np.array(np.broadcast_to(np.asarray(getattr(line, where.field), float), line.links))
    each[(where.entry or 0) - ends[i]] = value
    return scene.with_values({f"line.{i}.{where.field}": each.tolist()})


# Names of free parameters: full paths, unique short names, or by default the scene's damping

#: Damping fields by effect.
DAMPING = {
    "linear_damping": ("b_l",),
    "quadratic_damping": ("b_q",),
    "joint_friction": ("viscous", "dry"),
}
#: Paths of them.
DAMPING_PATHS = tuple(f"effects.{effect}.{key}" for effect, keys in DAMPING.items() for key in keys)


def default_free(scene: Scene) -> list[str]:
    """The parameters listed in the scene's `[fit] free`, otherwise every damping parameter that it has.

    Raises:
        SceneError: a scene without damping.
    """
    if scene.fit is not None and scene.fit.free:
        return full_names(scene, scene.fit.free, "fit.free")
    found = [path for path in DAMPING_PATHS if given_effect(scene, path) is not None]
    if not found:
        raise SceneError("free: the scene has no damping to fit. Use --free with paths such as b_l, b_q")
    return found


def default_rig(scene: Scene) -> list[str]:
    """What a ruler and a hand leave open: a factor of all lengths and the zero of the angles; none if `[fit]` lists
    what is free, or without weight, which shows the lengths.
    """
    if (scene.fit is not None and scene.fit.free) or "weight" not in scene.effects:
        return []
    return [SCALE, CAMERA]


def full_names(scene: Scene, names: Sequence[str], option: str = "free") -> list[str]:
    """Full paths of names that may be short: `b_l`, `dry`, `dry.1` if only one field has this name.

    Error messages use `option` as their heading.
    """
    names = [name.strip() for name in names]
    known = None
    if not all(_is_full(name) for name in names):
        known = [*paths(build_model(scene)), *scene.parameter_paths]
    return [name if _is_full(name) else _full(name, known, option) for name in names]


def free_option(names: Sequence[str], more: Sequence[str]) -> str:
    """The option that frees parameters of these names and the paths `more`."""
    fields = {ScenePath(path).key for path in DAMPING_PATHS}
    short = [ScenePath(name).key if ScenePath(name).key in fields else name for name in names]
    return f"--free {','.join(dict.fromkeys([*short, *more]))}"


def by_full_path(
    scene: Scene, start: StartValues | None, bounds: Bounds | None, priors: Priors | None, of_data: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """Start values, bounds and priors by full paths; names of the sections `of_data` are full already."""
    given = (("start", start), ("bounds", bounds), ("prior", priors))
    return [
        {
            name if ScenePath(name).section in of_data else full_names(scene, [name], option)[0]: value
            for name, value in (values or {}).items()
        }
        for option, values in given
    ]


def _is_full(name: str) -> bool:
    sections = ("camera", "clock", "marker", "parameters", "release", "rig")
    return name.count(".") >= 2 or (ScenePath(name).section in sections and "." in name)


def _full(name: str, names: Sequence[str], option: str) -> str:
    if not name:
        raise SceneError(f"{option}: an empty name; allowed: names of parameters, separated by commas")
    stem, _, entry = name.partition(".")
    names = [p for p in names if not p.startswith("line.") or p.split(".")[1].isdecimal()]
    own = [p for p in names if ScenePath(p).section != "parameters"]
    found: list[str] = []
    for group in (own, DAMPING_PATHS, names):
        found = found or [p for p in group if ScenePath(p).key == stem]
    if len(found) != 1:
        short = sorted({ScenePath(p).key for p in [*names, *DAMPING_PATHS]})
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(stem, short + names)}")
    return found[0] + (f".{entry}" if entry else "")


# Priors of the free parameters from the rig's known numbers (`[fit]` of a scene).
#
# An independent prior applies to every free parameter of its path. A common one describes a relative error shared by
# all of its numbers: if some of them are free, it constrains their mean relative change and leaves their ratios to
# the traces. If masses are not free, their common relative error s is added to the errors. Angles do not change if
# masses, inertias, damping and forces all grow by s, so each free number with a mass in its unit has at least the
# relative error s.


@dataclass(frozen=True)
class Common:
    """A prior of a mean relative change: `share . values` is 1 with standard deviation `sigma`."""

    share: np.ndarray
    sigma: float


@dataclass(frozen=True)
class JointPrior:
    """Joint prior knowledge of the parameters.

    Attributes:
        common: priors of several of them.
        carried: standard deviation of the scale of mass, which traces of angles cannot determine.
        massive: power of mass in every parameter's unit (k,).
        doubt: moves of the parameters (k,) by indistinguishable candidates, each one standard deviation.
    """

    common: tuple[Common, ...] = ()
    carried: float = 0.0
    massive: np.ndarray | None = None
    doubt: tuple[np.ndarray, ...] = ()

    def carried_covariance(self, values: np.ndarray) -> np.ndarray:
        """Covariance (k, k) of the parameters by `carried` and `doubt`."""
        moves = [np.zeros(len(values)), *self.doubt]
        if self.massive is not None and self.carried:
            moves.append(self.carried * self.massive * values)
        return np.sum([np.outer(move, move) for move in moves], axis=0)


def rig_priors(scene: Scene, model: Model, parameters: Sequence[Parameter]) -> tuple[tuple[Parameter, ...], JointPrior]:
    """The parameters with the rig's priors, unless the caller gave some, and their joint prior.

    Raises:
        SceneError: the prior of a number that the scene does not have, or with another unit than the number's.
    """
    found = list(parameters)
    common = []
    carried = 0.0
    for i, prior in enumerate([] if scene.fit is None else scene.fit.priors):
        option = f"fit.prior.{i}.of"
        known = _resolve_prior(scene, model, prior.of, option)
        names = {p.name for p in known}
        mine = [j for j, p in enumerate(found) if p.name in names]
        if not prior.common:
            for j in mine:
                if found[j].prior is None:
                    found[j] = replace(found[j], prior=(found[j].value, _width(prior, found[j], f"fit.prior.{i}")))
        elif mine:
            share = np.zeros(len(found))
            share[mine] = [1 / (len(mine) * _nonzero(found[j], option)) for j in mine]
            common.append(Common(share, prior.si[0]))
        elif all(p.unit == "kg" for p in known):
            carried = float(np.hypot(carried, prior.si[0]))
    massive = np.array([float(power_of_mass(p.unit)) for p in found])
    return tuple(found), JointPrior(tuple(common), carried, massive)


def _resolve_prior(scene: Scene, model: Model, of: str, option: str) -> Sequence[Parameter]:
    """The numbers that a prior applies to: of the model, otherwise of the scene, such as `sea.current.speed`."""
    name = full_names(scene, [of], option)[0]
    if ScenePath(name).section in ("point", "line", "effects") and scene.written is None:
        return resolve(model, [name], option=option)
    return find_parameters(scene, model, [name], option)


def power_of_mass(unit: str) -> int:
    """1 for a unit proportional to the unit of mass, such as `kg/s` and `N m`; otherwise 0."""
    above = unit.split("/")[0].split()
    return int(any(word.split("^")[0] in ("kg", "N", "Pa", "J") for word in above))


def _width(prior: PriorSpec, p: Parameter, path: str) -> float:
    sigma, unit = prior.si
    if unit == "%":
        return sigma * abs(_nonzero(p, path))
    if unit != p.unit:
        raise SceneError(f"{path}.unit: {prior.unit!r} is not a unit of {p.name!r}; allowed: {p.unit}, %")
    return sigma


def _nonzero(p: Parameter, path: str) -> float:
    if p.value == 0:
        raise SceneError(f"{path}: {p.name!r} is 0, which has no relative error; allowed: sigma in {p.unit}")
    return p.value
