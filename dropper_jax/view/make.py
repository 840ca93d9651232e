"""From a solution to the page: arrays as base64 float32, colours as in the pictures, the surface of a sea."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.files import atomic_write
from dropper_jax.load.surroundings import bed_height
from dropper_jax.plots import style
from dropper_jax.plots.run import Run, readable
from dropper_jax.run.build import build_model
from dropper_jax.run.solution import Solution
from dropper_jax.view.bodies import body_data

#: Frames of a page; a longer run is thinned evenly, so that the file stays a few MB and scrubbing smooth.
FRAMES = 3000
#: Frames and points per side of the water surface, which is larger than the line's data and moves more slowly.
SURFACE_FRAMES, SURFACE_POINTS = 600, 19
#: Half width of the surface in sizes of the line's motion.
SURFACE_REACH = 0.9
#: The same of the bed, and its points per side.
BED_REACH, BED_POINTS = 0.75, 13
COLOURS = 33


def write_view(solution: Solution, path: str | Path) -> Path:
    """Write the page of a solution, whole or not at all."""
    return atomic_write(path, view_page(solution))


def view_page(solution: Solution) -> str:
    """The page as text: lines of nodes and links coloured by tension, their held ends, and water where there is some.

    Times [s], positions [m] and tensions [N] are float32: what the eye sees, not what a calculation needs.
    """
    run = readable(solution)
    # `<` would let a scene's name end the script element
    data = json.dumps(_data(solution, run), allow_nan=False).replace("<", "\\u003c")
    parts = {"TITLE": html.escape(run.name), "STYLE": _part("view.css"), "DATA": data, "SCRIPT": _part("view.js")}
    text = _part("view.html")
    for key, value in parts.items():
        text = text.replace(f"/*{key}*/", value)
    return text


def _part(name: str) -> str:
    return (resources.files("dropper_jax.view") / "page" / name).read_text(encoding="utf-8")


def _data(solution: Solution, run: Run) -> dict[str, Any]:
    kept = _even(len(run.t), FRAMES)
    norm = style.tension_norm(run.tension)
    shades = style.tension_map()(np.linspace(0.0, 1.0, COLOURS))[:, :3]
    return {
        "name": run.name,
        "description": solution.scene.description,
        "how": style.how(run)[0],
        "ok": run.status == "ok",
        "frames": len(kept),
        "nodes": run.positions.shape[1],
        "time": _pack(run.t[kept]),
        "positions": _pack(run.positions[kept]),
        "tension": _pack(run.tension[kept]),
        "range": [float(norm.vmin), float(norm.vmax)],
        "colours": [[round(255 * float(c)) for c in shade] for shade in shades],
        "held": _held(solution, run),
        "first": run.first.tolist(),
        "labels": run.labels,
        "joints": list(run.joints),
        "buoys": [buoy._asdict() for buoy in run.buoys],
        "bodies": body_data(run.bodies, kept),
        "bed": _bed(run),
        "water": _water(solution, run),
    }


def _held(solution: Solution, run: Run) -> list[int]:
    """Nodes that are held: of one line the first, and the last where its point is not free; of a system its points."""
    if run.scene is not None:
        return list(run.held)
    line = solution.scene.lines[0]
    last = run.positions.shape[1] - 1
    return [0] if solution.scene.point(line.end).kind == "free" else [0, last]


def _bed(run: Run) -> dict[str, Any] | None:
    """Places of a grid and the height [m] of the bed over it; None for a single line or without a bed."""
    if run.scene is None:
        return None
    low, high = run.positions.min(axis=(0, 1)), run.positions.max(axis=(0, 1))
    step = _round_step(2 * BED_REACH * max(float((high - low).max()), 1.0) / (BED_POINTS - 1))
    around = np.arange(BED_POINTS) - BED_POINTS // 2
    x, y = (step * (np.rint(m / step) + around) for m in 0.5 * (low + high)[:2])
    grid = np.meshgrid(x, y, indexing="ij")
    z = bed_height(run.scene, np.stack([*grid, np.zeros_like(grid[0])], axis=-1))
    if z is None:
        return None
    return {"points": BED_POINTS, "x": x.tolist(), "y": y.tolist(), "z": z.ravel().tolist()}


def _round_step(least: float) -> float:
    """The least of 1, 2, 5 times a power of ten that is not below `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(n * power for n in (1, 2, 5, 10) if n * power >= least * (1 - 1e-9)))


def _even(count: int, most: int) -> np.ndarray:
    """At most `most` of `count` samples, evenly, the first and the last included."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, most))).astype(int))


def _pack(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def _water(solution: Solution, run: Run) -> dict[str, Any] | None:
    """Depth, a square grid of places and the elevation [m] over it for some of the frames; None without a sea."""
    if solution.scene.sea is None:
        return None
    sea = build_model(solution.scene, "float64").sea
    low, high = run.positions.min(axis=(0, 1)), run.positions.max(axis=(0, 1))
    reach = SURFACE_REACH * max(float((high - low).max()), 1.0)
    x, y = (np.linspace(m - reach, m + reach, SURFACE_POINTS) for m in 0.5 * (low + high)[:2])
    places = np.stack([*(a.ravel() for a in np.meshgrid(x, y, indexing="ij")), np.zeros(x.size * y.size)], axis=-1)
    times = run.t[_even(len(run.t), SURFACE_FRAMES)]
    eta = jax.jit(lambda r, t: jax.lax.map(lambda one: sea.elevation(r, one), t))(
        jnp.asarray(places), jnp.asarray(times)
    )
    return {
        "depth": float(sea.depth),
        "points": SURFACE_POINTS,
        "x": x.tolist(),
        "y": y.tolist(),
        "frames": len(times),
        "time": _pack(times),
        "elevation": _pack(np.asarray(eta)),
    }
