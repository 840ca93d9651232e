"""The data of the 3D page: a run as plain values, with arrays as base64 float32."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import arc
from dropper_jax.plots import figures, tension_colours
from dropper_jax.plots.body_shapes import Bodies
from dropper_jax.plots.run import Run
from dropper_jax.report.page_samples import choose_samples
from dropper_jax.report.page_surroundings import bed_heights, flow_arrows, pack_array, water_surface
from dropper_jax.scene.body import rotation

#: Maximum number of frames of a page; a longer run is thinned, which keeps the file at a few MB and scrubbing smooth.
MAX_FRAMES = 3000
#: Number of colours of tensions, between which the page interpolates.
COLOURS = 33


def page_data(run: Run, limits: tuple[float, float]) -> Table:
    """The run as plain values, with the ends of the colours [N]; null or empty where it has no water or diameter."""
    scene = run.scene
    shown = choose_samples(run, MAX_FRAMES)
    frames = shown.frames
    shades = tension_colours.tension_map()(np.linspace(0.0, 1.0, COLOURS))[:, :3]
    diameter = None
    if scene.line.diameter is not None:
        diameter = scene.line.diameter.tolist()
    water = None
    flows = []
    if scene.sea is not None:
        water = water_surface(run, scene.sea.depth, shown.surface)
        flows = flow_arrows(scene.sea, run.t[0])
    return {
        "name": scene.name,
        "description": scene.description,
        "how": figures.how(run)[0],
        "ok": run.status == "ok",
        "frames": len(frames),
        "nodes": run.positions.shape[1],
        "time": pack_array(run.t[frames]),
        "positions": pack_array(run.positions[frames]),
        "tension": pack_array(run.tension[frames]),
        "range": list(limits),
        "largest": float(np.max(run.max_tension, initial=limits[1], where=np.isfinite(run.max_tension))),
        "notes": list(shown.notes),
        "diameter": diameter,
        "lines": [{"name": line.name, "node": int(line.nodes[len(line.nodes) // 2])} for line in run.written_lines],
        "colours": np.rint(255 * shades).astype(int).tolist(),
        "held": list(run.fixed_nodes),
        "first": run.first.tolist(),
        "labels": run.labels,
        "parts": part_names(run),
        "joints": list(run.joints),
        "buoys": [buoy._asdict() for buoy in run.buoys],
        "bodies": _body_data(run.bodies, frames),
        "bed": bed_heights(run),
        "water": water,
        "flows": flows,
    }


def part_names(run: Run) -> list[str]:
    """A name for each link: its line as written in the scene, arc length of its middle at the start, and number."""
    names = list(run.labels)
    length = run.lengths
    for line in run.written_lines:
        middles = arc(length[line.links])
        names[line.links] = [f"{line.name}, {s:.1f} m, segment {i}" for i, s in enumerate(middles, start=1)]
    return names


def _body_data(bodies: Bodies | None, frames: np.ndarray) -> Table | None:
    """Plain values of the bodies at the selected frames; None without any.

    `poses` has for each frame and body its reference point [m] and its axes, row by row: 12 numbers, float32.
    """
    if bodies is None or not bodies.shapes:
        return None
    attitude = bodies.attitude[frames]
    axes = np.reshape(list(map(rotation, attitude.reshape(-1, 3))), (*attitude.shape[:2], 9))
    return {
        "names": list(bodies.names),
        "poses": pack_array(np.concatenate([bodies.position[frames], axes], axis=-1)),
        "shapes": [{"body": shape.body, "rings": np.round(shape.rings(), 5).tolist()} for shape in bodies.shapes],
    }
