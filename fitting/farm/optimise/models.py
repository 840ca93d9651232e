"""Models of a design in calm water with the derivatives of their numbers by the variables.

The effect of a variable on the model is computed on the host, by central differences of the scene's own arithmetic:
leaves of a model are smooth in lengths, diameters and volumes, so that steps of 1e-4 have errors of 1e-8. Windows then
move the leaves along them, without another scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model
from dropper_jax.sea import Sea
from dropper_jax.sea.make import make_sea
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.site import Case, Site, Storm
from fitting.farm.site.site import water_of

#: Step of the differences relative to the range of a variable.
DIFFERENCE_STEP = 1e-4
#: Relative changes of the site's assumptions: heights of all waves, speed of the current. They follow the variables in
#: every derivative, so that the end of a design reports the cost of an error in them.
ASSUMPTIONS = ("wave height", "current")


@dataclass(frozen=True)
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


def still_scene(site: Site, scene: Scene, storm: Storm) -> Scene:
    """The scene of a load case without its waves."""
    still = {**site.still_changes(storm), **site.break_changes(storm)}
    base = site.prepared(scene).with_values(still)
    table = base.as_written()
    table["sea"] = {k: v for k, v in table["sea"].items() if k not in ("waves", "ramp", "interpolation")}
    return Scene.from_dict(table, base.name)


def still_model(site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm) -> Model:
    """The model of a design in calm water."""
    return build_model(still_scene(site, with_design(site.scene, variables, values), storm))


def still(site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm) -> Still:
    """The model with the derivatives of its leaves with respect to the variables.

    Raises:
        SceneError: a variable that changes the model's shape.
    """
    model = still_model(site, variables, values, storm)
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(model)]
    slopes: dict[int, np.ndarray] = {}
    for k, (distance, *designs) in enumerate(designs_beside(variables, values)):
        ends = [jax.tree.leaves(still_model(site, variables, moved, storm)) for moved in designs]
        if any([jnp.shape(leaf) for leaf in leaves] != shapes for leaves in ends):
            name = variables[k].name
            raise SceneError(f"variable.{k}.name: {name!r} changes the number of parts. Use another one")
        for i, (high, low) in enumerate(zip(*ends, strict=True)):
            slope = (np.asarray(high, float) - np.asarray(low, float)) / distance
            if np.any(slope):
                slopes.setdefault(i, np.zeros((len(variables), *slope.shape)))[k] = slope
    return Still(model, slopes)


def designs_beside(variables: Sequence[Variable], values: np.ndarray) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """For each variable two designs (p,), in which it alone is higher and lower, and their distance."""
    for axis, variable in zip(np.eye(len(variables)), variables, strict=True):
        step = DIFFERENCE_STEP * variable.span
        yield 2 * step, values + step * axis, values - step * axis


def idle(found: Still, variables: Sequence[Variable]) -> list[str]:
    """Names of variables without effect on the model."""
    rows = []
    for k, v in enumerate(variables):
        if not any(np.any(slope[k]) for slope in found.slopes.values()):
            rows.append(v.name)
    return rows


def sea_of(site: Site, scene: Scene, case: Case, ramp: float, begin: float = 0.0) -> Sea:
    """The sea of a case; its waves rise from t = 0 over the ramp [s], with the phase of time `begin` [s]."""
    spec = water_of(site.prepared(scene).with_values(site.changes(case)))
    sea = make_sea(replace(spec, interpolation="none", ramp=ramp))
    waves = sea.waves
    return replace(sea, waves=replace(waves, phase=waves.phase - waves.omega * begin))


def in_waves(model: Model, sea: Sea) -> Model:
    """The calm model in the waves of a sea."""
    waves = jax.tree.map(lambda x: jnp.asarray(x, model.dtype), sea.waves)
    return replace(model, sea=replace(model.sea, waves=waves))


def leaf_names(model: Model) -> list[str]:
    """Names of the leaves of a model."""
    return [jax.tree_util.keystr(key) for key, _ in jax.tree_util.tree_flatten_with_path(model)[0]]


def slopes_of(model: Model, found: Still) -> dict[int, np.ndarray]:
    """Slopes by number of the leaf of a model that has all leaves of the calm one, and others."""
    number = {name: i for i, name in enumerate(leaf_names(model))}
    names = leaf_names(found.model)
    return {number[names[i]]: slope for i, slope in found.slopes.items()}


def leaf_numbers(model: Model, still_: Still) -> dict[int, np.ndarray]:
    """Slopes by number of the leaf of a model in waves, from those of the calm one."""
    found = slopes_of(model, still_)
    if still_.assumed:
        size = np.asarray(model.sea.waves.amplitude)
        count = next(iter(found.values())).shape[0]
        own = found.setdefault(leaf_names(model).index(".sea.waves.amplitude"), np.zeros((count, *size.shape)))
        own[count - len(ASSUMPTIONS)] = size
    return found


def in_assumed(found: Still) -> Still:
    """The slopes with the current's relative change as a further variable, and space for the waves (`leaf_numbers`)."""
    more = len(ASSUMPTIONS)
    slopes = {i: np.concatenate([slope, np.zeros((more, *slope.shape[1:]))]) for i, slope in found.slopes.items()}
    count = next(iter(slopes.values())).shape[0]
    for i, (name, leaf) in enumerate(zip(leaf_names(found.model), jax.tree.leaves(found.model), strict=True)):
        if name in (".sea.current.speed", ".sea.current.velocities"):
            slopes.setdefault(i, np.zeros((count, *np.shape(leaf))))[count - 1] = np.asarray(leaf)
    return Still(found.model, slopes, assumed=True)
