"""The data of the 3D page: a run as plain values, with arrays as base64 float32.

Frames of the lines resolve the waves; of a run that is too long for that only a part is shown.
"""

from __future__ import annotations

import base64
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import arc
from dropper_jax.plots import figures, tension_colours
from dropper_jax.plots.body_shapes import Bodies
from dropper_jax.plots.run import Run, elevations
from dropper_jax.plots.surroundings import bed_grid
from dropper_jax.plots.time_panels import cycle
from dropper_jax.scene.body import rotation
from dropper_jax.sea.make import make_current
from dropper_jax.sea.spec import SeaSpec

#: Frames of the lines, and of the surface, per wave period, between which the page interpolates linearly.
IN_A_WAVE = 8
SURFACE_IN_A_WAVE = 10
#: Minimum and maximum number of frames of the surface.
SURFACE_FRAMES = (60, 3750)
#: Time over which the mean period of waves is counted: minimum and maximum [s], and number of samples.
COUNTED_TIME = (60.0, 600.0)
COUNTED_SAMPLES = 2400
#: Maximum number of frames of a page; a longer run is thinned, which keeps the file at a few MB and scrubbing smooth.
MAX_FRAMES = 3000
#: Number of colours of tensions, between which the page interpolates.
COLOURS = 33
#: Half width of the seabed in sizes of the motion of the lines, and number of its positions per side.
BED_REACH = 0.75
BED_POINTS = 13
#: The same of the surface of the water.
SURFACE_REACH = 0.9
SURFACE_POINTS = 19


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
        middles = arc(length[line.links])
        names[line.links] = [f"{line.name}, {s:.1f} m, segment {i}" for i, s in enumerate(middles, start=1)]
    return names


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
        count = int(np.clip(np.ceil(duration * SURFACE_IN_A_WAVE / period) + 1, *SURFACE_FRAMES))
    return ShownSamples(frames, np.linspace(t[first], t[last], count), tuple(notes))


def wave_period(run: Run) -> float:
    """Mean period between upward crossings of the surface over the middle of the lines [s]; 0 without waves."""
    if run.scene.sea is None:
        return 0.0
    begin = run.t[0]
    times = np.linspace(begin, begin + np.clip(run.t[-1] - begin, *COUNTED_TIME), COUNTED_SAMPLES)
    x, y, _ = run.positions.mean(axis=(0, 1))
    eta = elevations(run.scene, np.array([[x, y, 0.0]]), times)[:, 0]
    if np.ptp(eta) > 1e-6:
        return cycle(times, eta)
    return 0.0


def _middle_and_size(run: Run) -> tuple[np.ndarray, float]:
    """Middle (2,) of the motion in the plan view, and its largest extent [m], at least 1 m."""
    low = run.positions.min(axis=(0, 1))
    high = run.positions.max(axis=(0, 1))
    return 0.5 * (low + high)[:2], max(float((high - low).max()), 1.0)


def _bed_grid(run: Run) -> Table | None:
    """Positions of a grid and the height [m] of the seabed there; None without a seabed."""
    middle, size = _middle_and_size(run)
    step = _round_step(2 * BED_REACH * size / (BED_POINTS - 1))
    around = np.arange(BED_POINTS) - BED_POINTS // 2
    x, y = step * (np.rint(middle / step)[:, None] + around)
    _, z = bed_grid(run, x, y)
    if z is None:
        return None
    return {"points": BED_POINTS, "x": x.tolist(), "y": y.tolist(), "z": z.ravel().tolist()}


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


def _water(run: Run, depth: float, times: np.ndarray) -> Table:
    """Depth, a square grid of positions and the elevation there at times [s], in whole steps of `step` [m]."""
    middle, size = _middle_and_size(run)
    x, y = middle[:, None] + SURFACE_REACH * size * np.linspace(-1.0, 1.0, SURFACE_POINTS)
    positions = np.stack(np.meshgrid(x, y, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)
    eta = elevations(run.scene, positions, times)
    step = max(float(np.abs(eta).max()), 1e-9) / 32767
    return {
        "depth": float(depth),
        "points": SURFACE_POINTS,
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


def _pack(values: np.ndarray, kind: str = "<f4") -> str:
    """An array in base64."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
