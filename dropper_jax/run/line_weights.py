"""Weights of lines in water, and the forces at their ends, which differ from the tension of the end link."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.run.end_links import EndLinks, Motion, ends_of, point_loads
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import LineSlice, WholeLine, whole_lines

#: Words in names of lines and types that should not float.
HEAVY = ("chain", "mussel", "dropper", "loop", "sock", "crop")
#: Diameter [m] above which a line is not a rope: fibre ropes of aquaculture, some of which float, are thinner.
THICK = 0.1


def wet_weights(scene: Scene) -> np.ndarray:
    """Weight minus buoyancy (n,) [N] of each link under water, from the effects of the scene; mussels included."""
    links = EndLinks(scene).links
    return links.weight - links.lift


def end_forces(
    scene: Scene,
    positions: np.ndarray,
    tension: np.ndarray,
    lines: Sequence[WholeLine | LineSlice] | None = None,
    t: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Force (k, 2) [N] of every line on its first and its last point, by name (see `run.end_links`).

    The force is the tension of the end link plus the weight of the part of the link that belongs to the point, less its
    buoyancy as far as it is in the water: the tension of a link is that at its middle. At a point on the seabed the bed
    carries this part as far as the line does not lift it. Drag and inertia of this part are left out.

    Args:
        positions: nodes of all lines (k, nodes, 3) [m]; tension: of their links (k, n) [N].
        lines: their indices in these arrays; default: lines as in the scene, pieces between attached points together.
        t: times (k,) [s], for the level and the waves; default: the level at t = 0 without waves.
    """
    vectors = end_force_vectors(scene, positions, tension, whole_lines(scene) if lines is None else lines, t)
    return {name: np.linalg.norm(both, axis=2) for name, both in vectors.items()}


def end_force_vectors(
    scene: Scene,
    positions: np.ndarray,
    tension: np.ndarray,
    lines: Sequence[WholeLine | LineSlice],
    t: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """The forces of `end_forces` as vectors (k, 2, 3) [N]."""
    links = EndLinks(scene, waves=t is not None)
    times = np.zeros(len(positions)) if t is None else t
    found = {}
    for line in lines:
        both = [links.force(end, positions[:, end.nodes], tension, times) for end in ends_of(line)]
        found[line.name] = np.stack(both, axis=1)
    return found


def fixed_point_loads(
    scene: Scene, positions: np.ndarray, tension: np.ndarray, t: float = 0.0
) -> dict[str, np.ndarray]:
    """Force (3,) [N] of all lines on each fixed point in a static configuration, by name (see `run.end_links`).

    Args:
        positions: nodes of all lines (nodes, 3) [m]; tension: of their links (n,) [N].
        t: time [s], for the level.
    """
    times = np.array([t])
    loads = point_loads(Motion(scene, times, positions[None], times, tension[None]), waves=False)
    return {name: load[0] for name, load in loads.items()}


def end_angles(positions: np.ndarray, lines: Sequence[WholeLine | LineSlice]) -> dict[str, np.ndarray]:
    """Angle (k, 2) [deg] above the horizontal of every line as it leaves its first and its last point, by name.

    It is that of the end link: the uplift at the anchor of a single line, negative where a line hangs below its point.

    Args:
        positions: nodes of all lines (k, nodes, 3) [m].
    """
    found = {}
    for line in lines:
        points, inner = np.transpose([end.nodes for end in ends_of(line)])
        with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
            along = positions[:, inner] - positions[:, points]
            found[line.name] = np.degrees(np.arctan2(along[..., 2], np.hypot(along[..., 0], along[..., 1])))
    return found


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
    types = {line.get("name"): str(line.get("type", "")) for line in scene.as_written()["line"]}
    rows: dict[tuple[str, ...], Table] = {}
    for line, bare in zip(whole_lines(grown), whole_lines(scene), strict=True):
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
        has_mussels = bare.spec.growth is not None or scene.season is not None
        row["meant_heavy"] |= thick or has_mussels or any(word in words for word in HEAVY)
    return list(rows.values())


def lines_in_words(names: list[str]) -> str:
    """Names of lines or points: all of up to three, else the first two and the number of the others."""
    if len(names) <= 3:
        return ", ".join(names)
    return f"{names[0]}, {names[1]} and {len(names) - 2} more"


def weight_cells(rows: list[Table]) -> list[tuple[str, ...]]:
    """Rows of `line_weights` as text, with a heading."""
    heads = ("line", "mass [kg/m]", "displaced [kg/m]", "weight in water [N/m]", "density [kg/m^3]")
    keys = ("mass_kg_per_m", "displaced_kg_per_m", "wet_weight_n_per_m", "density_kg_per_m3")
    return [heads, *((lines_in_words(row["lines"]), *cells(itemgetter(*keys)(row), ".4g")) for row in rows)]


def floating_warnings(scene: Scene) -> list[str]:
    """A warning for each group of lines that is lighter than water although it has mussels, is chain or thicker than a
    rope."""
    found = []
    for row in line_weights(scene):
        if row["meant_heavy"] and row["wet_weight_n_per_m"] < 0.0:
            found.append(
                f"{lines_in_words(row['lines'])}: floats: {row['mass_kg_per_m']:.4g} kg/m displace "
                f"{row['displaced_kg_per_m']:.4g} kg/m of water; check mass (in air) and diameter"
            )
    return found
