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

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Table
from dropper_jax.plots import style
from dropper_jax.plots.panels import cycle
from dropper_jax.plots.run import Bodies, Run, readable
from dropper_jax.plots.system import bed_grid
from dropper_jax.run.build import build_model
from dropper_jax.run.simulate import Solution
from dropper_jax.scene.body import rotation
from dropper_jax.sea import Sea

__all__ = ["pair_page", "view_page", "write_view"]

#: Frames of the lines per wave period, between which the page interpolates linearly.
IN_A_WAVE = 8


class Shown(NamedTuple):
    """Shown samples of the run, times of the surface [s], and notes about them."""

    frames: np.ndarray
    surface: np.ndarray
    notes: tuple[str, ...]


def choose_samples(run: Run, sea: Sea | None, most: int) -> Shown:
    """At most `most` evenly spaced samples; in waves at least eight per mean period.

    Only a part of a longer run is shown, around its maximum tension.
    """
    t = run.t
    period = 0.0 if sea is None else wave_period(sea, run)
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
    frames = first + even(last - first + 1, most)
    gap = float(np.diff(t[frames]).max(initial=0.0))
    if period > 0.0 and gap > 2.0 * period / IN_A_WAVE:
        notes.append(
            f"saved every {gap:.3g} s in waves of {period:.3g} s: the motion of the lines in between is not known"
        )
    return Shown(frames, _surface_times(t[first], t[last], period), tuple(notes))


def _surface_times(begin: float, end: float, period: float) -> np.ndarray:
    """Times of the surface [s], ten per wave period."""
    if period == 0.0 or end <= begin:
        return np.linspace(begin, end, 2 if end > begin else 1)
    # frames of the surface per wave period, between which the page interpolates linearly
    count = int(np.ceil((end - begin) * 10 / period)) + 1
    return np.linspace(begin, end, min(max(count, 60), 3750))


def wave_period(sea: Sea, run: Run) -> float:
    """Mean period between upward crossings of the surface over the middle of the lines [s]; 0 without waves."""
    begin = float(run.t[0])
    end = float(run.t[-1])
    # time over which the mean period of the waves is counted [s], and the number of samples
    times = np.linspace(begin, begin + max(min(end - begin, 600.0), 60.0), 2400)
    middle = run.positions.mean(axis=(0, 1))
    eta = np.asarray(elevation(sea, np.array([[middle[0], middle[1], 0.0]]), times))[:, 0]
    if np.ptp(eta) > 1e-6:
        return cycle(times, eta)
    return 0.0


def elevation(sea: Sea, positions: np.ndarray, times: np.ndarray) -> jax.Array:
    """Elevation (q, m) [m] over positions (m, 3) [m] at times (q,) [s]."""
    find = jax.jit(lambda r, t: jax.lax.map(lambda one: sea.elevation(r, one), t))
    return find(jnp.asarray(positions), jnp.asarray(times))


def even(count: int, most: int) -> np.ndarray:
    """At most `most` of `count` samples, evenly spaced, including the first and the last."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, most))).astype(int))


#: Maximum number of frames of a page; a longer run is thinned, which keeps the file at a few MB and scrubbing smooth.
FRAMES = 3000
COLOURS = 33


def write_view(solution: Solution, path: str | Path, other: Solution | None = None) -> Path:
    """Write the page of a solution, or of two side by side, atomically."""
    return atomic_write(path, view_page(solution) if other is None else pair_page(solution, other))


def pair_page(first: Solution, second: Solution) -> str:
    """Two runs side by side as one page: the same colours for the same tension, one clock and one camera."""
    both = [readable(solution) for solution in (first, second)]
    lowest, highest = zip(*(style.tension_limits(run.tension) for run in both), strict=True)
    shared = min(lowest), max(highest)
    pages = [html.escape(view_page(solution, shared)) for solution in (first, second)]
    title = html.escape(" and ".join(dict.fromkeys(run.scene.name for run in both)))
    return _fill_page("two.html", TITLE=title, FIRST=pages[0], SECOND=pages[1])


def view_page(solution: Solution, limits: tuple[float, float] | None = None) -> str:
    """The page as text: lines of nodes and links coloured by tension, their fixed ends, and water if the scene has any.

    Times [s], positions [m] and tensions [N] are float32, which is sufficient for display, but not for calculations.

    Args:
        limits: tensions [N] at the ends of the colours; None: the range of the run.
    """
    run = readable(solution)
    # `<` would let a scene's name end the script element
    data = json.dumps(_data(solution, run, limits), allow_nan=False).replace("<", "\\u003c")
    return _fill_page(
        "view.html", TITLE=html.escape(run.scene.name), STYLE=_part("view.css"), DATA=data, SCRIPT=_script()
    )


def _fill_page(name: str, **parts: str) -> str:
    """A page with its marks `/*NAME*/` replaced once: the inserted text may contain such marks."""
    pieces = re.split(r"/\*([A-Z]+)\*/", _part(name))
    return "".join(parts[piece] if i % 2 else piece for i, piece in enumerate(pieces))


def _script() -> str:
    """The program of the page: its files in the order of their dependencies."""
    head, body = _part("view.js").split("// --- samples between frames", 1)
    return "\n".join(
        [head, _part("pick.js"), _part("solid.js"), _part("pair.js"), "// --- samples between frames" + body]
    )


def _part(name: str) -> str:
    return (resources.files("dropper_jax.report") / "assets" / name).read_text(encoding="utf-8")


def _data(solution: Solution, run: Run, limits: tuple[float, float] | None) -> Table:
    scene = solution.scene
    sea = None
    if scene.sea is not None:
        sea = build_model(scene, "float64").sea
    part = choose_samples(run, sea, FRAMES)
    kept = part.frames
    low, high = limits or style.tension_limits(run.tension)
    shades = style.tension_map()(np.linspace(0.0, 1.0, COLOURS))[:, :3]
    water = None
    flows = []
    if sea is not None:
        water = _water(sea, run, part.surface)
        flows = _flows(solution, sea)
    return {
        "name": run.scene.name,
        "description": scene.description,
        "how": style.how(run)[0],
        "ok": run.status == "ok",
        "frames": len(kept),
        "nodes": run.positions.shape[1],
        "time": _pack(run.t[kept]),
        "positions": _pack(run.positions[kept]),
        "tension": _pack(run.tension[kept]),
        "range": [low, high],
        "largest": float(np.max(run.max_tension, initial=high, where=np.isfinite(run.max_tension))),
        "notes": list(part.notes),
        "diameter": None if scene.line.diameter is None else scene.line.diameter.tolist(),
        "lines": [{"name": line.name, "node": int(line.nodes[len(line.nodes) // 2])} for line in run.written_lines],
        "colours": np.rint(255 * shades).astype(int).tolist(),
        "held": list(run.fixed_nodes),
        "first": run.first.tolist(),
        "labels": run.labels,
        "parts": part_names(run),
        "joints": list(run.joints),
        "buoys": [buoy._asdict() for buoy in run.buoys],
        "bodies": body_data(run.bodies, kept),
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


#: Half width of the seabed in the unit of the configuration's size.
BED_REACH = 0.75


def _bed_grid(run: Run) -> Table | None:
    """Positions of a grid and the height [m] of the seabed there; None without a seabed."""
    # points of the seabed per side
    bed_points = 13
    low = run.positions.min(axis=(0, 1))
    high = run.positions.max(axis=(0, 1))
    step = _round_step(2 * BED_REACH * max(float((high - low).max()), 1.0) / (bed_points - 1))
    around = np.arange(bed_points) - bed_points // 2
    x, y = (step * (np.rint(m / step) + around) for m in 0.5 * (low + high)[:2])
    _, z = bed_grid(run, x, y)
    if z is None:
        return None
    return {"points": bed_points, "x": x.tolist(), "y": y.tolist(), "z": z.ravel().tolist()}


def _round_step(lower: float) -> float:
    """The smallest number of the series 1, 2, 5 times a power of ten that is not below `lower`."""
    power = 10.0 ** np.floor(np.log10(lower))
    return float(next(n * power for n in (1, 2, 5, 10) if n * power >= lower * (1 - 1e-9)))


def _flows(solution: Solution, sea: Sea) -> list[Table]:
    """Waves and current for their arrows: the direction of travel [rad] at the surface, and a text with their size."""
    spec = solution.scene.sea
    found = []
    if spec is not None and spec.waves is not None:
        waves = spec.waves
        many = np.ndim(waves.amplitude) > 0
        if many:
            hs = 4.0 * np.sqrt(0.5 * np.sum(np.square(waves.amplitude)))
        else:
            hs = waves.hs
        given = {"Hs": hs, "Tp": waves.tp, "H": waves.height, "amplitude": waves.amplitude, "T": waves.period}
        unit = {"Tp": "s", "T": "s"}
        sizes = [f"{name} {x:.3g} {unit.get(name, 'm')}" for name, x in given.items() if np.ndim(x) == 0 and x]
        course = np.angle(np.exp(1j * np.asarray(waves.direction, float)).mean())
        found.append({"text": ", ".join(["waves", *sizes]), "direction": float(course), "colour": "#0072b2"})
    if sea.current is not None:
        u, v, _ = np.asarray(sea.current.velocity(jnp.zeros(1), jnp.asarray(solution.t[0]), sea.depth))[0]
        if u or v:
            text = f"current {np.hypot(u, v):.2g} m/s at the surface"
            found.append({"text": text, "direction": float(np.arctan2(v, u)), "colour": "#009e73"})
    return found


def _pack(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


#: Half width of the surface in sizes of the motion of the line.
SURFACE_REACH = 0.9


def _water(sea: Sea, run: Run, times: np.ndarray) -> Table:
    """Depth, a square grid of positions and the elevation there at times [s], in whole steps of `step` [m]."""
    # points per side of the water surface
    surface_points = 19
    low = run.positions.min(axis=(0, 1))
    high = run.positions.max(axis=(0, 1))
    reach = SURFACE_REACH * max(float((high - low).max()), 1.0)
    x, y = (np.linspace(m - reach, m + reach, surface_points) for m in 0.5 * (low + high)[:2])
    positions = np.stack([*(a.ravel() for a in np.meshgrid(x, y, indexing="ij")), np.zeros(x.size * y.size)], axis=-1)
    eta = np.asarray(elevation(sea, positions, times))
    step = max(float(np.abs(eta).max()), 1e-9) / 32767
    return {
        "depth": float(sea.depth),
        "points": surface_points,
        "x": x.tolist(),
        "y": y.tolist(),
        "frames": len(times),
        "time": _pack(times),
        "elevation": base64.b64encode(np.rint(eta / step).astype("<i2").tobytes()).decode(),
        "step": step,
    }


def body_data(bodies: Bodies | None, kept: np.ndarray) -> Table | None:
    """Plain values of the bodies at the selected frames; None without any.

    `poses` has for each frame and body its reference point [m] and its axes, row by row: 12 numbers, float32.
    """
    if bodies is None or not bodies.shapes:
        return None
    count = len(bodies.names)
    poses = np.empty((len(kept), count, 12), "<f4")
    poses[..., :3] = bodies.position[kept]
    for k, frame in enumerate(kept):
        for i in range(count):
            poses[k, i, 3:] = rotation(bodies.attitude[frame, i]).ravel()
    rings = [np.round(shape.rings(), 5) for shape in bodies.shapes]
    return {
        "names": list(bodies.names),
        "poses": base64.b64encode(np.ascontiguousarray(poses).tobytes()).decode(),
        "shapes": [
            {"body": shape.body, "rings": ring.tolist()} for shape, ring in zip(bodies.shapes, rings, strict=True)
        ],
    }
