"""Tensions of a mooring whose lines have worn: by the derivative of the equilibrium and by another equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial.force_table import tables_of
from dropper_jax.base.read import Table
from dropper_jax.explain.line_facts import stiffness_of
from dropper_jax.modelling.build import build_model, equilibrium
from dropper_jax.modelling.model_slopes import shift_model
from dropper_jax.scene import whole_lines
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.static_pose import settle

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.model import State

#: Share of the diameter that is left after the wear that is asked about, and of area, mass and stiffness.
WORN_DIAMETER = 0.9


@dataclass(frozen=True)
class Wear:
    """Maximum tension of a line when all lines have lost a tenth of their diameter.

    Attributes:
        tension_n: now.
        by_derivative_n: worn, from the exact derivative of the equilibrium.
        by_equilibrium_n: worn, from another equilibrium; None if none is found.
        use, worn_use: tension over the breaking load, now and worn; None without one.
    """

    name: str
    tension_n: float
    by_derivative_n: float
    by_equilibrium_n: float | None
    use: float | None
    worn_use: float | None


def wear_of_lines(scene: Scene, state: State) -> list[Wear]:
    """Tensions when all lines are worn: area, mass, stiffness, breaking load fall with the square of the diameter."""
    worn = scene.with_values(_worn_values(scene))
    tension = np.asarray(state.tension)
    predicted = tension + _tension_change(scene, worn, state)
    again = equilibrium(worn)
    found = []
    for line in whole_lines(scene):
        links = line.links
        by_equilibrium = None
        worn_use = None
        if again.status == "ok":
            by_equilibrium = float(np.max(again.tension[links]))
            worn_use = _utilisation(again.tension[links], line.spec.breaking_load, WORN_DIAMETER**2)
        found.append(
            Wear(
                name=line.name,
                tension_n=float(np.max(tension[links])),
                by_derivative_n=float(np.max(predicted[links])),
                by_equilibrium_n=by_equilibrium,
                use=_utilisation(tension[links], line.spec.breaking_load, 1.0),
                worn_use=worn_use,
            )
        )
    return found


def _utilisation(tension: np.ndarray, breaking_load: np.ndarray | None, left: float) -> float | None:
    """Maximum tension over the share of the breaking load that is left; None without one."""
    if breaking_load is None:
        return None
    return float(np.max(tension / (breaking_load * left)))


def _worn_values(scene: Scene) -> Table:
    """Values of the worn scene by path."""
    values: Table = {}
    for i, line in enumerate(scene.lines):
        values[f"line.{i}.mass"] = WORN_DIAMETER**2 * line.mass
        if line.tables is None:
            values[f"line.{i}.axial.EA"] = WORN_DIAMETER**2 * stiffness_of(line)
        else:
            worn = [replace(table, tension=WORN_DIAMETER**2 * table.tension) for table in line.tables]
            values[f"line.{i}.axial.tension"] = tables_of(worn)["tension"]
        for key in ("diameter", "outer_diameter"):
            if getattr(line, key) is not None:
                values[f"line.{i}.{key}"] = WORN_DIAMETER * getattr(line, key)
    return values


def _tension_change(scene: Scene, worn: Scene, state: State) -> np.ndarray:
    """Change (n,) [N] of the tensions from the scene to the worn one, by the derivative at the scene's equilibrium."""
    model = build_model(scene)
    loads = release_loads(model, scene.start)
    pairs = zip(jax.tree.leaves(model), jax.tree.leaves(build_model(worn)), strict=True)
    change = {}
    for i, (a, b) in enumerate(pairs):
        if np.any(np.asarray(a) != np.asarray(b)):
            change[i] = np.asarray(b) - np.asarray(a)
    rows = [row[None] for row in change.values()]

    def tension(shift: Array) -> Array:
        return settle(shift_model(model, list(change), rows, shift), state, loads, is_equilibrium=True).tension

    return np.asarray(jax.jvp(tension, (jnp.zeros(1),), (jnp.ones(1),))[1])
