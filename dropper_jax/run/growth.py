"""Weights of lines, bare and with mussels, whose thickness and density over depth give mass, diameter and weight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.run.end_links import EndLinks, line_ends
from dropper_jax.scene import LineSlice, LineSpec, WholeLine, grown, line_slices, whole_lines


def overgrown(scene: Scene) -> Scene:
    """The scene with its `[line.growth]` and `[growth]` included in mass and diameter of the links; other scenes are
    unchanged."""
    if scene.season is None and all(line.growth is None for line in scene.lines):
        return scene
    if "_overgrown" in scene.__dict__:  # an equilibrium: solved once for each scene
        return scene.__dict__["_overgrown"]
    bare = _bare(scene)
    z = static_pose(bare, bare_model(bare)).positions[:, 2]
    changes = {}
    for i, (line, where) in enumerate(zip(scene.lines, line_slices(scene), strict=True)):
        layer = _layer(scene, line, z[where.nodes])
        if layer is not None:
            found = grown(line.length, line.mass, line.diameter, *layer, scene.sea.density, scene.sea.gravity)
            changes |= {f"line.{i}.mass": found.mass, f"line.{i}.diameter": found.diameter}
    found = bare.with_values(changes)
    object.__setattr__(scene, "_overgrown", found)
    return found


def _bare(scene: Scene) -> Scene:
    table = scene.to_dict()
    table.pop("growth", None)
    for line in table["line"]:
        line.pop("growth", None)
    return Scene.from_dict(table)


def _layer(scene: Scene, line: LineSpec, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Thickness [m] and density [kg/m^3] on a line's links (n,), whose nodes (n + 1,) rest at z [m]; None if bare."""
    depth = -0.5 * (z[1:] + z[:-1])
    if line.growth is not None:
        return line.growth.over(depth)
    season = scene.season
    if season is None or not season.on(line.name, line.piece_of):
        return None
    return season.layer(line.name, line.piece_of, depth, np.cumsum(line.length) - 0.5 * line.length, line.diameter)


def season_table(scene: Scene, months: Sequence[float] | None = None) -> list[dict[str, Any]]:
    """Mass, diameter and wet weight per metre by month and depth, of each bare rope that `[growth]` grows on.

    The values are without the random factor and without harvest.

    Returns:
        Rows of lines, month, depth_m, thickness_m, diameter_m, mass_kg_per_m, wet_weight_n_per_m.

    Raises:
        SceneError: no `[growth]`, or a month outside its months.
    """
    season = scene.season
    if season is None:
        raise SceneError(
            "growth: missing; needed: [growth] with `lines`, `month`, `months`, `depth`, `thickness` and `density`, "
            "as `dropper new mussels` writes"
        )
    asked = season.months if months is None else months
    for month in asked:
        if not season.months[0] <= month <= season.months[-1]:
            raise SceneError(
                f"--months: {month:g} is out of range; allowed: {season.months[0]:g} to {season.months[-1]:g} months"
            )
    ropes: dict[tuple[float, float], list[str]] = {}
    for line in scene.lines:
        if season.on(line.name, line.piece_of):
            ropes.setdefault((float(line.mass[0] / line.length[0]), float(line.diameter[0])), []).append(line.name)
    metre = np.ones(len(season.depth))
    rows = []
    for (mass, diameter), names in ropes.items():
        for month in asked:
            thickness, density = season.over(season.depth, month)
            found = grown(
                metre, mass * metre, diameter * metre, thickness, density, scene.sea.density, scene.sea.gravity
            )
            rows += [
                {
                    "lines": names,
                    "month": float(month),
                    "depth_m": float(season.depth[i]),
                    "thickness_m": float(thickness[i]),
                    "diameter_m": float(found.diameter[i]),
                    "mass_kg_per_m": float(found.mass[i]),
                    "wet_weight_n_per_m": float(found.wet_weight[i]),
                }
                for i in range(len(metre))
            ]
    return rows


# --- weights in water, and the forces at the ends, which differ from the tension of the end link ---

#: Words in names of lines and types that should not float.
HEAVY = ("chain", "mussel", "dropper", "loop", "sock", "crop")


def wet_weights(scene: Scene) -> np.ndarray:
    """Weight minus buoyancy (n,) [N] of each link under water, from the effects of the scene; mussels included."""
    links = EndLinks(overgrown(scene))
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
    """The same as vectors (k, 2, 3) [N]."""
    links = EndLinks(overgrown(scene), waves=t is not None)
    times = np.zeros(len(positions)) if t is None else t
    found = {}
    for name, first, last, where in _ends(lines):
        ends = ((first, first + 1, where.start, False), (last, last - 1, where.stop - 1, True))
        both = [
            links.force(positions[:, [node, inner]], tension[:, link], link, at_last, times)
            for node, inner, link, at_last in ends
        ]
        found[name] = np.stack(both, axis=1)
    return found


def fixed_point_loads(
    scene: Scene, positions: np.ndarray, tension: np.ndarray, t: float | None = None
) -> dict[str, np.ndarray]:
    """Force (3,) [N] of all lines on each fixed point in a static configuration, by name (see `run.end_links`).

    Args:
        positions: nodes of all lines (nodes, 3) [m]; tension: of their links (n,) [N].
        t: time [s], for the level.
    """
    links = EndLinks(overgrown(scene), waves=False)
    times = np.array([0.0 if t is None else t])
    loads = {point.name: np.zeros(3) for point in scene.points if not point.is_free}
    for end in line_ends(scene):
        if end.point in loads:
            nodes = positions[None, [end.node, end.inner]]
            loads[end.point] = (
                loads[end.point] + links.force(nodes, tension[None, end.link], end.link, end.last, times)[0]
            )
    return loads


def end_angles(positions: np.ndarray, lines: Sequence[WholeLine | LineSlice]) -> dict[str, np.ndarray]:
    """Angle (k, 2) [deg] above the horizontal of every line as it leaves its first and its last point, by name.

    It is that of the end link: the uplift at the anchor of a single line, negative where a line hangs below its point.

    Args:
        positions: nodes of all lines (k, nodes, 3) [m].
    """
    found = {}
    for name, first, last, _ in _ends(lines):
        with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
            along = positions[:, [first + 1, last - 1]] - positions[:, [first, last]]
            found[name] = np.degrees(np.arctan2(along[..., 2], np.hypot(along[..., 0], along[..., 1])))
    return found


def _ends(lines: Sequence[WholeLine | LineSlice]) -> Iterator[tuple[str, int, int, slice]]:
    """Name, first and last node, and links of each line."""
    for line in lines:
        nodes = line.nodes
        if isinstance(nodes, slice):
            first = nodes.start
            last = nodes.stop - 1
        else:
            first = int(nodes[0])
            last = int(nodes[-1])
        yield line.name, first, last, line.links


def line_weights(scene: Scene) -> list[dict[str, Any]]:
    """Mass, displaced mass, weight in water and density per metre, one row for equal lines; [] without a sea.

    Values are means over the lines' length, mussels included.
    """
    if scene.sea is None:
        return []
    bare = scene
    scene = overgrown(scene)
    diameter = displaced_diameter(scene.line, scene)
    if diameter is None:
        return []
    volume = 0.25 * np.pi * diameter**2 * scene.line.length
    weights = wet_weights(scene)
    types = {line.get("name"): str(line.get("type", "")) for line in bare.as_written()["line"]}
    rows: dict[tuple[float, ...], dict[str, Any]] = {}
    for line, own in zip(whole_lines(scene), whole_lines(bare), strict=True):
        length = line.spec.total
        mass = float(np.sum(line.spec.mass))
        displaced = scene.sea.density * float(np.sum(volume[line.links]))
        wet = float(np.sum(weights[line.links]))
        key = tuple(float(f"{value / length:.6g}") for value in (mass, displaced, wet))
        row = {
            "lines": [],
            "mass_kg_per_m": mass / length,
            "displaced_kg_per_m": displaced / length,
            "wet_weight_n_per_m": wet / length,
            "density_kg_per_m3": scene.sea.density * mass / displaced,
            "meant_heavy": False,
        }
        row = rows.setdefault(key, row)
        row["lines"].append(line.name)
        words = f"{line.name} {types.get(line.name, '')}".lower()
        # diameter [m] above which a line is not a rope: fibre ropes of aquaculture, some of which float, are thinner
        thick = float(np.max(diameter[line.links])) >= 0.1
        grown = own.spec.growth is not None or bare.season is not None
        row["meant_heavy"] |= thick or grown or any(word in words for word in HEAVY)
    return list(rows.values())


def lines_in_words(names: list[str]) -> str:
    if len(names) <= 3:
        return ", ".join(names)
    return f"{names[0]}, {names[1]} and {len(names) - 2} more"


def weight_cells(rows: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of `line_weights` as text, with a heading."""
    heads = ("line", "mass [kg/m]", "displaced [kg/m]", "weight in water [N/m]", "density [kg/m^3]")
    keys = ("mass_kg_per_m", "displaced_kg_per_m", "wet_weight_n_per_m", "density_kg_per_m3")
    return [heads, *((lines_in_words(row["lines"]), *(f"{row[key]:.4g}" for key in keys)) for row in rows)]


def floating_warnings(scene: Scene) -> list[str]:
    """A warning for each group of lines that is lighter than water although it has mussels, is chain or thicker than a
    rope."""
    return [
        f"{lines_in_words(row['lines'])}: floats: {row['mass_kg_per_m']:.4g} kg/m displace "
        f"{row['displaced_kg_per_m']:.4g} kg/m of water; check mass (in air) and diameter"
        for row in line_weights(scene)
        if row["meant_heavy"] and row["wet_weight_n_per_m"] < 0.0
    ]
