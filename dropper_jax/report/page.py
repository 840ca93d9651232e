"""`dropper view`: a run as one interactive HTML page that works offline.

The page has arrays as base64 float32, colours as in the pictures and the surface of a sea. Its frames resolve the
waves; of a run that is too long for that only a part is shown.
"""

from __future__ import annotations

import base64
import html
import json
import re
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Table
from dropper_jax.plots import figures, tension_colours
from dropper_jax.plots.body_shapes import Bodies
from dropper_jax.plots.run import Run, elevations, readable
from dropper_jax.plots.surroundings import bed_grid
from dropper_jax.plots.time_panels import cycle
from dropper_jax.run.simulate import Solution
from dropper_jax.scene.body import rotation
from dropper_jax.sea.make import make_current
from dropper_jax.sea.spec import SeaSpec

__all__ = ["pair_page", "view_page", "write_view"]

#: Frames of the lines per wave period, between which the page interpolates linearly.
IN_A_WAVE = 8


class ShownSamples(NamedTuple):
    """Shown samples of the run, times of the surface [s], and notes about them."""

    frames: np.ndarray
    surface: np.ndarray
    notes: tuple[str, ...]


def choose_samples(run: Run, most: int) -> ShownSamples:
    """At most `most` evenly spaced samples; in waves at least eight per mean period.

    Only a part of a longer run is shown, around its maximum tension.
    """
    t = run.t
    period = wave_period(run)
    first = 0
    last = len(t) - 1
    notes = []
    span = most * period / IN_A_WAVE
    if 0.0 < span < t[-1] - t[0]:
        peak = t[int(np.argmax(np.nan_to_num(run.max_tension).max(axis=1)))]
        begin = min(max(peak - span / 2, t[0]), t[-1] - span)
        first = int(np.searchsorted(t, begin))
        last = int(np.searchsorted(t, begin + span, side="right")) - 1
        notes.append(f"shown: {t[first]:.4g} to {t[last]:.4g} s of {t[-1]:.4g} s, around the maximum tension")
    frames = np.unique(np.rint(np.linspace(first, last, min(last - first + 1, most))).astype(int))
    gap = float(np.diff(t[frames]).max(initial=0.0))
    if period > 0.0 and gap > 2.0 * period / IN_A_WAVE:
        notes.append(
            f"saved every {gap:.3g} s in waves of {period:.3g} s: the motion of the lines in between is not known"
        )
    duration = t[last] - t[first]
    count = 1 + int(duration > 0.0)
    if period > 0.0 and duration > 0.0:
        # ten frames of the surface per wave period, between which the page interpolates linearly
        count = int(np.clip(np.ceil(duration * 10 / period) + 1, 60, 3750))
    return ShownSamples(frames, np.linspace(t[first], t[last], count), tuple(notes))


def wave_period(run: Run) -> float:
    """Mean period between upward crossings of the surface over the middle of the lines [s]; 0 without waves."""
    if run.scene.sea is None:
        return 0.0
    begin = run.t[0]
    # time over which the mean period of the waves is counted [s], and the number of samples
    times = np.linspace(begin, begin + np.clip(run.t[-1] - begin, 60.0, 600.0), 2400)
    x, y, _ = run.positions.mean(axis=(0, 1))
    eta = elevations(run.scene, np.array([[x, y, 0.0]]), times)[:, 0]
    if np.ptp(eta) > 1e-6:
        return cycle(times, eta)
    return 0.0


#: Maximum number of frames of a page; a longer run is thinned, which keeps the file at a few MB and scrubbing smooth.
MAX_FRAMES = 3000
COLOURS = 33


def write_view(solution: Solution, path: str | Path, other: Solution | None = None) -> Path:
    """Write the page of a solution, or of two side by side, atomically."""
    if other is None:
        return atomic_write(path, view_page(solution))
    return atomic_write(path, pair_page(solution, other))


def pair_page(first: Solution, second: Solution) -> str:
    """Two runs side by side as one page: the same colours for the same tension, one clock and one camera."""
    limits = [tension_colours.tension_limits(readable(solution).tension) for solution in (first, second)]
    shared = (np.min(limits), np.max(limits))
    pages = [html.escape(view_page(solution, shared)) for solution in (first, second)]
    title = html.escape(" and ".join(dict.fromkeys([first.scene.name, second.scene.name])))
    return _fill_page("two.html", TITLE=title, FIRST=pages[0], SECOND=pages[1])


def view_page(solution: Solution, limits: tuple[float, float] | None = None) -> str:
    """The page as text: lines of nodes and links coloured by tension, their fixed ends, and water if the scene has any.

    Times [s], positions [m] and tensions [N] are float32, which is sufficient for display, but not for calculations.

    Args:
        limits: tensions [N] at the ends of the colours; None: the range of the run.
    """
    run = readable(solution)
    # `<` would let a scene's name end the script element
    data = json.dumps(_page_data(run, limits or tension_colours.tension_limits(run.tension)), allow_nan=False)
    data = data.replace("<", "\\u003c")
    return _fill_page(
        "view.html", TITLE=html.escape(run.scene.name), STYLE=_asset("view.css"), DATA=data, SCRIPT=_script()
    )


def _fill_page(name: str, **parts: str) -> str:
    """A page with its marks `/*NAME*/` replaced once: the inserted text may contain such marks."""
    return re.sub(r"/\*([A-Z]+)\*/", lambda mark: parts[mark[1]], _asset(name))


#: The line of `view.js` before which the other files of the program belong.
SAMPLES = "// --- samples between frames"


def _script() -> str:
    """The program of the page: its files in the order of their dependencies."""
    head, body = _asset("view.js").split(SAMPLES, 1)
    return "\n".join([head, _asset("pick.js"), _asset("solid.js"), _asset("pair.js"), SAMPLES + body])


def _asset(name: str) -> str:
    """A file of the page."""
    return (resources.files("dropper_jax.report") / "assets" / name).read_text(encoding="utf-8")


def _page_data(run: Run, limits: tuple[float, float]) -> Table:
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
        water = _water(run, scene.sea.depth, shown.surface)
        flows = _flows(scene.sea, run.t[0])
    return {
        "name": scene.name,
        "description": scene.description,
        "how": figures.how(run)[0],
        "ok": run.status == "ok",
        "frames": len(frames),
        "nodes": run.positions.shape[1],
        "time": _pack(run.t[frames]),
        "positions": _pack(run.positions[frames]),
        "tension": _pack(run.tension[frames]),
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
        "bed": _bed_grid(run),
        "water": water,
        "flows": flows,
    }


def part_names(run: Run) -> list[str]:
    """A name for each link: its line as written in the scene, arc length of its middle at the start, and number."""
    names = list(run.labels)
    length = run.lengths
    for line in run.written_lines:
        own = length[line.links]
        middle = np.cumsum(own) - 0.5 * own
        names[line.links] = [f"{line.name}, {s:.1f} m, segment {i}" for i, s in enumerate(middle, start=1)]
    return names


def _middle_and_size(run: Run) -> tuple[np.ndarray, float]:
    """Middle (2,) of the motion in the plan view, and its largest extent [m], at least 1 m."""
    low = run.positions.min(axis=(0, 1))
    high = run.positions.max(axis=(0, 1))
    return 0.5 * (low + high)[:2], max(float((high - low).max()), 1.0)


#: Half width of the seabed in the unit of the configuration's size.
BED_REACH = 0.75


def _bed_grid(run: Run) -> Table | None:
    """Positions of a grid and the height [m] of the seabed there; None without a seabed."""
    # points of the seabed per side
    bed_points = 13
    middle, size = _middle_and_size(run)
    step = _round_step(2 * BED_REACH * size / (bed_points - 1))
    around = np.arange(bed_points) - bed_points // 2
    x, y = step * (np.rint(middle / step)[:, None] + around)
    _, z = bed_grid(run, x, y)
    if z is None:
        return None
    return {"points": bed_points, "x": x.tolist(), "y": y.tolist(), "z": z.ravel().tolist()}


def _round_step(lower: float) -> float:
    """The smallest number of the series 1, 2, 5 times a power of ten that is not below `lower`."""
    power = 10.0 ** np.floor(np.log10(lower))
    return float(next(n * power for n in (1, 2, 5, 10) if n * power >= lower * (1 - 1e-9)))


def _flows(sea: SeaSpec, start: float) -> list[Table]:
    """Waves and current for their arrows: the direction of travel [rad] at the surface, and a text with their size."""
    found = []
    waves = sea.waves
    if waves is not None:
        hs = waves.hs
        if np.ndim(waves.amplitude) > 0:
            hs = 4.0 * np.sqrt(0.5 * np.sum(np.square(waves.amplitude)))
        given = {"Hs": hs, "Tp": waves.tp, "H": waves.height, "amplitude": waves.amplitude, "T": waves.period}
        unit = {"Tp": "s", "T": "s"}
        sizes = [f"{name} {x:.3g} {unit.get(name, 'm')}" for name, x in given.items() if np.ndim(x) == 0 and x]
        course = np.angle(np.exp(1j * np.asarray(waves.direction, float)).mean())
        found.append({"text": ", ".join(["waves", *sizes]), "direction": float(course), "colour": "#0072b2"})
    if sea.current is not None:
        current = make_current(sea.current)
        u, v, _ = np.asarray(current.velocity(jnp.zeros(1), jnp.asarray(start), sea.depth))[0]
        if u or v:
            text = f"current {np.hypot(u, v):.2g} m/s at the surface"
            found.append({"text": text, "direction": float(np.arctan2(v, u)), "colour": "#009e73"})
    return found


def _pack(values: np.ndarray, kind: str = "<f4") -> str:
    """An array in base64."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()


#: Half width of the surface in sizes of the motion of the line.
SURFACE_REACH = 0.9


def _water(run: Run, depth: float, times: np.ndarray) -> Table:
    """Depth, a square grid of positions and the elevation there at times [s], in whole steps of `step` [m]."""
    # points per side of the water surface
    surface_points = 19
    middle, size = _middle_and_size(run)
    x, y = middle[:, None] + SURFACE_REACH * size * np.linspace(-1.0, 1.0, surface_points)
    positions = np.stack(np.meshgrid(x, y, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)
    eta = elevations(run.scene, positions, times)
    step = max(float(np.abs(eta).max()), 1e-9) / 32767
    return {
        "depth": float(depth),
        "points": surface_points,
        "x": x.tolist(),
        "y": y.tolist(),
        "frames": len(times),
        "time": _pack(times),
        "elevation": _pack(np.rint(eta / step), "<i2"),
        "step": step,
    }


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
        "poses": _pack(np.concatenate([bodies.position[frames], axes], axis=-1)),
        "shapes": [{"body": shape.body, "rings": np.round(shape.rings(), 5).tolist()} for shape in bodies.shapes],
    }
