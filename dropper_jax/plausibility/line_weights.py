"""Weights of lines in water, with their mussels, and warnings of lines that float although they should not."""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from dropper_jax.base.markdown import cells, first_names
from dropper_jax.base.read import Table
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.growth import has_mussels, overgrown
from dropper_jax.quantities.end_links import EndLinks
from dropper_jax.scene import whole_lines

#: Words in names of lines and types that should not float.
HEAVY = ("chain", "mussel", "dropper", "loop", "sock", "crop")
#: Maximum number of lines or points that are named in one message.
MOST_NAMES = 3
#: Diameter [m] above which a line is not a rope: fibre ropes of aquaculture, some of which float, are thinner.
THICK = 0.1


def wet_weights(scene: Scene) -> np.ndarray:
    """Weight minus buoyancy (n,) [N] of each link under water, from the effects of the scene; mussels included."""
    links = EndLinks(scene).links
    return links.weight - links.lift


def line_weights(scene: Scene) -> list[Table]:
    """Mass, displaced mass, weight in water and density per metre, one row for equal lines; [] without a sea.

    Values are means over the lines' length, mussels included.
    """
    sea = scene.sea
    if sea is None:
        return []
    grown = overgrown(scene)
    diameter = displaced_diameter(grown.line, grown)
    if diameter is None:
        return []
    volume = 0.25 * np.pi * diameter**2 * grown.line.length
    weights = wet_weights(grown)
    with_mussels = {line.piece_of or line.name for line in scene.lines if has_mussels(scene, line)}
    types = {line.get("name"): str(line.get("type", "")) for line in scene.as_written()["line"]}
    rows: dict[tuple[str, ...], Table] = {}
    for line in whole_lines(grown):
        length = line.spec.total
        mass = float(np.sum(line.spec.mass) / length)
        displaced = float(sea.density * np.sum(volume[line.links]) / length)
        wet = float(np.sum(weights[line.links]) / length)
        row = {
            "lines": [],
            "mass_kg_per_m": mass,
            "displaced_kg_per_m": displaced,
            "wet_weight_n_per_m": wet,
            "density_kg_per_m3": sea.density * mass / displaced,
            "meant_heavy": False,
        }
        row = rows.setdefault(tuple(f"{value:.6g}" for value in (mass, displaced, wet)), row)
        row["lines"].append(line.name)
        words = f"{line.name} {types.get(line.name, '')}".lower()
        thick = float(np.max(diameter[line.links])) >= THICK
        row["meant_heavy"] |= thick or line.name in with_mussels or any(word in words for word in HEAVY)
    return list(rows.values())


def weight_cells(rows: list[Table]) -> list[tuple[str, ...]]:
    """Rows of `line_weights` as text, with a heading."""
    heads = ("line", "mass [kg/m]", "displaced [kg/m]", "weight in water [N/m]", "density [kg/m^3]")
    keys = ("mass_kg_per_m", "displaced_kg_per_m", "wet_weight_n_per_m", "density_kg_per_m3")
    return [heads, *((first_names(row["lines"], MOST_NAMES), *cells(itemgetter(*keys)(row), ".4g")) for row in rows)]


def floating_warnings(scene: Scene) -> list[str]:
    """A warning for each group of lines that is lighter than water although it has mussels, is chain or thicker than a
    rope."""
    found = []
    for row in line_weights(scene):
        if row["meant_heavy"] and row["wet_weight_n_per_m"] < 0.0:
            found.append(
                f"{first_names(row['lines'], MOST_NAMES)}: floats: {row['mass_kg_per_m']:.4g} kg/m displace "
                f"{row['displaced_kg_per_m']:.4g} kg/m of water; check mass (in air) and diameter"
            )
    return found
