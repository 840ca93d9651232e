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
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import without_keys
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model
from dropper_jax.sea import Sea
from dropper_jax.sea.make import make_sea
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.site import Case, Site, Storm
from fitting.farm.site.site import water_of

#: Step of the differences relative to the range of a variable.
MODEL_DIFFERENCE_STEP = 1e-4
#: Relative changes of the site's assumptions: heights of all waves, speed of the current. They follow the variables in
#: every derivative, so that the end of a design reports the cost of an error in them.
ASSUMPTIONS = ("wave height", "current")
#: Name of the leaf that holds the amplitudes of the waves.
WAVES = ".sea.waves.amplitude"


@dataclass(frozen=True)
class CalmModel:
    """The model of a design in calm water under one current, level and month.

    Attributes:
        model: without waves.
        slopes: by name of the model's leaf, its derivative by the variables and `ASSUMPTIONS` (p + a, ...).
    """

    model: Model
    slopes: dict[str, np.ndarray]


def calm_scene(site: Site, scene: Scene, storm: Storm) -> Scene:
    """The scene of a load case without its waves."""
    still = {**site.still_changes(storm), **site.break_changes(storm)}
    base = site.prepared(scene).with_values(still)
    table = base.as_written()
    table["sea"] = without_keys(table["sea"], ("waves", "ramp", "interpolation"))
    return Scene.from_dict(table, base.name)


def build_calm_model(site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm) -> Model:
    """The model of a design in calm water."""
    return build_model(calm_scene(site, with_design(site.scene, variables, values), storm))


def differentiate_calm_model(site: Site, variables: Sequence[Variable], values: np.ndarray, storm: Storm) -> CalmModel:
    """The model with the derivatives of its leaves with respect to the variables, and to the current's relative change.

    Raises:
        SceneError: a variable that changes the model's shape.
    """
    model = build_calm_model(site, variables, values, storm)
    leaves = named_leaves(model)
    shapes = {name: jnp.shape(leaf) for name, leaf in leaves.items()}
    rows: dict[str, dict[int, np.ndarray]] = {}
    for k, (distance, higher, lower) in enumerate(shifted_designs(variables, values)):
        high = named_leaves(build_calm_model(site, variables, higher, storm))
        low = named_leaves(build_calm_model(site, variables, lower, storm))
        for end in (high, low):
            if {name: jnp.shape(leaf) for name, leaf in end.items()} != shapes:
                raise SceneError(
                    f"variable.{k}.name: {variables[k].name!r} changes the number of parts. Use another one"
                )
        for name in shapes:
            slope = (np.asarray(high[name], float) - np.asarray(low[name], float)) / distance
            if np.any(slope):
                rows.setdefault(name, {})[k] = slope
    last = len(variables) + ASSUMPTIONS.index("current")
    for name in (".sea.current.speed", ".sea.current.velocities"):
        if name in leaves:
            rows.setdefault(name, {})[last] = np.asarray(leaves[name])
    slopes = {}
    for name, own in rows.items():
        slopes[name] = np.zeros((len(variables) + len(ASSUMPTIONS), *shapes[name]))
        slopes[name][list(own)] = list(own.values())
    return CalmModel(model, slopes)


def shifted_designs(
    variables: Sequence[Variable], values: np.ndarray
) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """For each variable two designs (p,), in which it alone is higher and lower, and their distance."""
    for axis, variable in zip(np.eye(len(variables)), variables, strict=True):
        step = MODEL_DIFFERENCE_STEP * variable.span
        yield 2 * step, values + step * axis, values - step * axis


def has_no_effect(found: CalmModel, k: int) -> bool:
    """Whether variable number k has no effect on the model."""
    return not any(np.any(slope[k]) for slope in found.slopes.values())


def sea_of(site: Site, scene: Scene, case: Case, ramp: float | None, begin: float = 0.0) -> Sea:
    """The sea of a case; its waves rise from t = 0 over the ramp [s], if any, with the phase of time `begin` [s]."""
    spec = water_of(site.prepared(scene).with_values(site.changes(case)))
    sea = make_sea(replace(spec, interpolation="none", ramp=ramp))
    waves = sea.waves
    return replace(sea, waves=replace(waves, phase=waves.phase - waves.omega * begin))


def with_waves(model: Model, sea: Sea) -> Model:
    """The calm model in the waves of a sea."""
    waves = jax.tree.map(lambda x: jnp.asarray(x, model.dtype), sea.waves)
    return replace(model, sea=replace(model.sea, waves=waves))


def named_leaves(model: Model) -> dict[str, Array]:
    """Leaves of a model by name, in order."""
    return {jax.tree_util.keystr(key): leaf for key, leaf in jax.tree_util.tree_flatten_with_path(model)[0]}


def numbered_slopes(model: Model, found: CalmModel) -> dict[int, np.ndarray]:
    """Slopes by number of the leaf of a model that has all leaves of the calm one, and others; with those of waves."""
    slopes = dict(found.slopes)
    names = list(named_leaves(model))
    if WAVES in names:
        size = np.asarray(model.sea.waves.amplitude)
        slopes[WAVES] = np.zeros((len(next(iter(slopes.values()))), *size.shape))
        slopes[WAVES][ASSUMPTIONS.index("wave height") - len(ASSUMPTIONS)] = size
    return {names.index(name): slope for name, slope in slopes.items()}
