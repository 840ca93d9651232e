"""What the 3D page shows around the lines: the seabed, the surface of the water, and arrows of waves and current."""

from __future__ import annotations

import base64

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.plots.run import Run, elevations
from dropper_jax.plots.surroundings import bed_grid
from dropper_jax.sea.make import make_current
from dropper_jax.sea.spec import SeaSpec

#: Half width of the seabed in sizes of the motion of the lines, and number of its positions per side.
BED_REACH = 0.75
BED_POINTS = 13
#: The same of the surface of the water.
SURFACE_REACH = 0.9
SURFACE_POINTS = 19


def _middle_and_size(run: Run) -> tuple[np.ndarray, float]:
    """Middle (2,) of the motion in the plan view, and its largest extent [m], at least 1 m."""
    low = run.positions.min(axis=(0, 1))
    high = run.positions.max(axis=(0, 1))
    return 0.5 * (low + high)[:2], max(float((high - low).max()), 1.0)


def bed_heights(run: Run) -> Table | None:
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


def flow_arrows(sea: SeaSpec, start: float) -> list[Table]:
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


def water_surface(run: Run, depth: float, times: np.ndarray) -> Table:
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
        "time": pack_array(times),
        "elevation": pack_array(np.rint(eta / step), "<i2"),
        "step": step,
    }


def pack_array(values: np.ndarray, kind: str = "<f4") -> str:
    """An array in base64."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
