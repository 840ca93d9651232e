"""Variables of a design, and models in calm water with the derivatives of their numbers by the variables.

The effect of a variable on the model is computed on the host, by central differences of the scene's own arithmetic:
leaves of a model are smooth in lengths, diameters and volumes, so that steps of 1e-4 have errors of 1e-8. The compiled
programs then only need the derivative of a run with respect to the leaves (the chain rule).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import (
    Plain,
    ScenePath,
    check_keys,
    plain,
    read_list,
    read_number,
    read_table,
    read_text,
    refuse,
)
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model
from dropper_jax.sea import Sea
from dropper_jax.sea.make import make_sea
from fitting.site import Case, Site, Storm
from fitting.site.case import Break

# --- variables: numbers of the scene with bounds and, where parts come in sizes, a catalogue ---
#
# [[variable]]
# name = "leg"                    of [parameters] of the scene, or any path of it: "line_type.rope.diameter"
# low = 40.0
# high = 80.0
# catalogue = [50.0, 55.0, 60.0]  available sizes; the final design uses one of them

KEYS = ("name", "low", "high", "catalogue")


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number of the scene that the optimiser may choose.

    Attributes:
        name: as specified; `path`: of the scene.
        value: start value; `low`, `high`: its bounds.
        catalogue: available sizes, in increasing order; empty if any value is allowed.
    """

    name: str
    path: str
    value: float
    low: float
    high: float
    catalogue: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        return self.high - self.low

    def sizes(self, value: float) -> tuple[float, ...]:
        """Sizes next to a value, below and above it; the value itself without a catalogue."""
        if not self.catalogue:
            return (value,)
        below = [x for x in self.catalogue if x <= value + 1e-9 * self.span]
        above = [x for x in self.catalogue if x > value + 1e-9 * self.span]
        return (*below[-1:], *above[:1])


def read_variables(raw: Plain, scene: Scene) -> tuple[Variable, ...]:
    """The `[[variable]]` tables of a site.

    Raises:
        SceneError: no table, an unknown number, an empty interval or one that excludes the start, sizes outside it, a
            duplicate variable.
    """
    found: list[Variable] = []
    for i, item in enumerate(read_list(raw, "variable", None, "one or more [[variable]] tables")):
        found.append(_read(read_table(item, f"variable.{i}"), f"variable.{i}", scene))
        if found[-1].path in [v.path for v in found[:-1]]:
            raise refuse(f"variable.{i}.name", found[-1].name, "is a duplicate", "every variable once")
    if not found:
        raise SceneError("variable: none is given; needed: one or more [[variable]] tables")
    return tuple(found)


def _read(table: Mapping[str, Any], path: str, scene: Scene) -> Variable:
    check_keys(table, KEYS, path)
    name = read_text(table.get("name"), f"{path}.name")
    where = name if "." in name or scene.template is None else f"parameters.{name}"
    try:
        value = scene.value(where)
    except SceneError as error:
        raise SceneError(f"{path}.name: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise refuse(f"{path}.name", name, f"is {plain(value)!r}, no single number", "paths of such numbers")
    if ScenePath(where).section == "parameters":
        given = scene.template.table["parameters"][ScenePath(where).key]
        if isinstance(given, str):
            raise refuse(f"{path}.name", name, f"follows from others ({given})", "parameters that are numbers")
    low, high = (read_number(table.get(key), f"{path}.{key}", {}, "a number") for key in ("low", "high"))
    if not low < high:
        raise refuse(f"{path}.high", high, "leaves an empty interval", f"> {low:g}")
    if not low <= float(value) <= high:
        raise refuse(f"{path}.low", low, f"and high leave out the scene's {value:g}", "bounds around it")
    sizes = _sizes(table.get("catalogue"), f"{path}.catalogue", low, high)
    return Variable(name, where, float(value), low, high, sizes)


def _sizes(given: Plain, path: str, low: float, high: float) -> tuple[float, ...]:
    if given is None:
        return ()
    items = read_list(given, path, None, "a list of available sizes")
    sizes = [read_number(x, f"{path}.{i}", {}, "a number") for i, x in enumerate(items)]
    if not sizes:
        raise refuse(path, [], "is empty", "at least one size; or leave the key out")
    for i, size in enumerate(sizes):
        if not low <= size <= high:
            raise refuse(f"{path}.{i}", size, "is out of bounds", f"{low:g} to {high:g}")
    return tuple(sorted(set(sizes)))


def with_design(scene: Scene, variables: Sequence[Variable], values: np.ndarray) -> Scene:
    """The scene with the variables at these values (p,)."""
    return scene.with_values({v.path: float(x) for v, x in zip(variables, values, strict=True)})


#: Step of the differences relative to the range of a variable.
DIFFERENCE_STEP = 1e-4
#: Relative changes of the site's assumptions: heights of all waves, speed of the current. They follow the variables in
#: every derivative, so that the end of a design reports the cost of an error in them.
ASSUMPTIONS = ("wave height", "current")


@dataclasses.dataclass(frozen=True)
class Still:
    """The model of a design in calm water under one current, level and month.

    Attributes:
        model: without waves.
        slopes: by number of the model's leaf, its derivative by the variables (p, ...).
        assumed: whether `ASSUMPTIONS` follow the variables.
    """

    model: Model
    slopes: dict[int, np.ndarray]
    assumed: bool = False


def calm_slack_ropes(scene: Scene) -> Scene:
    """The scene with ropes whose damper also acts in slack links (`damped_rope`), at least critically damped.

    Slack ropes with the plain law chatter: a difference of 1e-9 m grows to 1e-2 m within ten seconds and remains. It
    changes peaks by less than 1 %, but derivatives through it are noise. With this damper it does not grow at all. The
    effect of the damper on the peaks is compensated by the factor between soft and hard ones (see `storm`).
    """
    if scene.written is None:
        return scene
    table = scene.as_written()
    for kind in table.get("line_type", []):
        if kind.get("law", "rope") == "rope":
            kind["law"] = "damped_rope"
            if kind.get("damping") is None:
                # ratio of the ropes' damping to the critical one of a link in windows
                kind["damping_ratio"] = max(float(kind.get("damping_ratio") or 0.0), 1.0)
    return Scene.from_dict(table, scene.name)


def still_scene(site: Site, scene: Scene, storm: Storm, calm: bool) -> Scene:
    """The scene of a load case without its waves; with `calm` as used in windows."""
    base = site.prepared(scene).with_values({**site.still_changes(storm), **site.break_changes(storm)})
    table = base.as_written()
    table["sea"] = {k: v for k, v in table["sea"].items() if k not in ("waves", "ramp", "interpolation")}
    base = Scene.from_dict(table, base.name)
    return calm_slack_ropes(base) if calm else base


def still_model(
    site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm, calm: bool = True
) -> Model:
    """The model of a design in calm water."""
    return build_model(still_scene(site, with_design(site.scene, variables, values), storm, calm))


def still(site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm) -> Still:
    """The model with the derivatives of its leaves with respect to the variables.

    Raises:
        SceneError: a variable that changes the model's shape.
    """
    model = still_model(site, variables, values, storm)
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(model)]
    slopes: dict[int, np.ndarray] = {}
    for k, variable in enumerate(variables):
        step = DIFFERENCE_STEP * variable.span
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array(values, float)
            moved[k] += sign * step
            leaves = jax.tree.leaves(still_model(site, variables, moved, storm))
            if [jnp.shape(leaf) for leaf in leaves] != shapes:
                raise SceneError(f"variable.{k}.name: {variable.name!r} changes the number of parts. Use another one")
            ends.append(leaves)
        for i, (high, low) in enumerate(zip(*ends, strict=True)):
            slope = (np.asarray(high, float) - np.asarray(low, float)) / (2 * step)
            if np.any(slope):
                slopes.setdefault(i, np.zeros((len(variables), *slope.shape)))[k] = slope
    return Still(model, slopes)


def idle(found: Still, variables: Sequence[Variable]) -> list[str]:
    """Names of variables without effect on the model."""
    moved = np.zeros(len(variables), bool)
    for slope in found.slopes.values():
        moved |= np.any(slope.reshape(len(variables), -1) != 0, axis=1)
    return [v.name for v, m in zip(variables, moved, strict=True) if not m]


def sea_of(site: Site, scene: Scene, case: Case, ramp: float, begin: float = 0.0) -> Sea:
    """The sea of a case; its waves rise from t = 0 over the ramp [s], with the phase of time `begin` [s]."""
    spec = site.prepared(scene).with_values(site.changes(case)).sea
    sea = make_sea(dataclasses.replace(spec, interpolation="none", ramp=ramp))
    waves = sea.waves
    return dataclasses.replace(sea, waves=dataclasses.replace(waves, phase=waves.phase - waves.omega * begin))


def in_waves(model: Model, sea: Sea) -> Model:
    """The calm model in the waves of a sea."""
    waves = jax.tree.map(lambda x: jnp.asarray(x, model.dtype), sea.waves)
    return dataclasses.replace(model, sea=dataclasses.replace(model.sea, waves=waves))


def leaf_numbers(model: Model, still_: Still) -> dict[int, np.ndarray]:
    """Slopes by number of the leaf of a model in waves, from those of the calm one."""
    path = jax.tree_util.tree_flatten_with_path
    number = {jax.tree_util.keystr(key): i for i, (key, _) in enumerate(path(model)[0])}
    names = [jax.tree_util.keystr(key) for key, _ in path(still_.model)[0]]
    found = {number[names[i]]: slope for i, slope in still_.slopes.items()}
    if still_.assumed:
        size = np.asarray(model.sea.waves.amplitude)
        count = next(iter(found.values())).shape[0]
        own = found.setdefault(number[".sea.waves.amplitude"], np.zeros((count, *size.shape)))
        own[count - len(ASSUMPTIONS)] = size
    return found


def in_assumed(found: Still) -> Still:
    """The slopes with the current's relative change as a further variable, and space for the waves (`leaf_numbers`)."""
    path = jax.tree_util.tree_flatten_with_path(found.model)[0]
    slopes = {
        i: np.concatenate([slope, np.zeros((len(ASSUMPTIONS), *slope.shape[1:]))]) for i, slope in found.slopes.items()
    }
    count = next(iter(slopes.values())).shape[0]
    for i, (key, leaf) in enumerate(path):
        if jax.tree_util.keystr(key) in (".sea.current.speed", ".sea.current.velocities"):
            slopes.setdefault(i, np.zeros((count, *np.shape(leaf))))[count - 1] = np.asarray(leaf)
    return Still(found.model, slopes, assumed=True)


# Windows of storms in which a line breaks: the first third intact while the waves rise, then without its link.
#
#     s_1 = run(intact, s_0),    s_2 = run(parted, s_1)
#
# The backward pass includes both runs, so the impact of the break is in the derivatives. The peak load of a whole run
# may occur long after the break, when the farm has drifted to another position. The window then starts from the
# equilibrium without that link (`settled`), which is solved again and follows the variables by its own stiffness.


def link_of(model: Model, broken: Break) -> int:
    """Number of the link that breaks."""
    spans = zip(model.geometry.members, model.geometry.spans, strict=True)
    own = next(span for member, span in spans if member.name == broken.line)
    return int(np.arange(model.line.links)[own][broken.link - 1])


def with_link_mask(model: Model, broken_link: int | None) -> Model:
    """The model with a mask of intact links, without `broken_link`; with None all are intact."""
    intact = jnp.ones(model.line.links, model.dtype)
    intact = intact if broken_link is None else intact.at[broken_link].set(0.0)
    return dataclasses.replace(
        model, lines=(dataclasses.replace(model.line, axial=model.line.axial.with_broken_links(intact)),)
    )


def masked_still(found: Still, broken_link: int | None) -> Still:
    """The same for a model, including the derivatives of its leaves with respect to the variables."""
    model = with_link_mask(found.model, broken_link)
    path = jax.tree_util.tree_flatten_with_path
    number = {jax.tree_util.keystr(key): i for i, (key, _) in enumerate(path(model)[0])}
    names = [jax.tree_util.keystr(key) for key, _ in path(found.model)[0]]
    return Still(model, {number[names[i]]: slope for i, slope in found.slopes.items()}, found.assumed)
