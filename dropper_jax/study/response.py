"""Response of a scene's first link to regular waves over their period."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model
from dropper_jax.plots import figures, style
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.sea import Sea
from dropper_jax.study.curves import marks, save_titled, series

#: Fraction of a run, at its end, for the evaluation of the response.
EVALUATED_SHARE = 1.0 / 3.0
#: Increase of the wave height for the additional curve.
HIGHER_WAVES = 1.1


def responses(
    scene: Scene, periods: Sequence[float] | np.ndarray, more: bool = True, progress: Progress = silent
) -> list[Table]:
    """Response of a scene's first link in regular waves of these periods [s], over whole periods at the end of runs.

    Args:
        more: also with waves that are 10 % higher.

    Returns:
        {period_s, status, mean_rad, amplitude_rad, phase_rad, wet, amplitude_10_percent_more} per period: mean and
        first harmonic of the angle from the vertical in the plane of the waves, its phase relative to the elevation at
        the fixed point (0 in phase, -pi/2 a quarter period behind), mean wet fraction of the far end, and the relative
        change of the amplitude at 1.1 times the height, only with `more`.

    Raises:
        SceneError: no regular waves of a period, or runs shorter than three periods.
    """
    waves = None if scene.sea is None else scene.sea.waves
    if waves is None or waves.kind != "regular" or waves.period is None:
        raise SceneError("sea.waves: a response needs regular waves with a period; allowed: kind 'regular', `period`")
    least = max(periods) / EVALUATED_SHARE
    if scene.run.duration < least:
        raise SceneError(
            f"run.duration: {scene.run.duration:g} s is too short for these periods; allowed: >= {least:g} s"
        )
    key = "height" if waves.amplitude is None else "amplitude"
    higher = {f"sea.waves.{key}": HIGHER_WAVES * np.max(getattr(waves, key))}
    found = []
    for i, period in enumerate(map(float, periods)):
        progress(i / len(periods), f"period {period:g} s")
        values = {"sea.waves.period": period}
        row = {"period_s": period, **_response(simulate(scene.with_values(values)), period)}
        if more:
            other = _response(simulate(scene.with_values({**values, **higher})), period)
            row["amplitude_10_percent_more"] = other["amplitude_rad"] / row["amplitude_rad"] - 1.0
        found.append(row)
    progress(1.0, "")
    return found


def _response(solution: Solution, period: float) -> Table:
    """Mean, first harmonic and wet fraction of a run in waves of a period [s], over whole periods at its end."""
    model = build_model(solution.scene, "float64")
    sea = model.sea
    if sea is None or model.line.diameter is None:
        raise SceneError("line.0.diameter: missing; a response needs it, > 0 m")
    span = np.floor(EVALUATED_SHARE * solution.t[-1] / period) * period
    last = solution.t > solution.t[-1] - span
    t = solution.t[last]
    nodes = solution.positions[last]
    course = float(sea.waves.direction)
    link = nodes[:, 1] - nodes[:, 0]
    angle = np.arctan2(link[:, :2] @ [np.cos(course), np.sin(course)], -link[:, 2])
    below_wave = jnp.asarray(nodes[:1, 0] * [1.0, 1.0, 0.0])
    elevation = np.asarray(_elevations(sea, below_wave, jnp.asarray(t)))
    wave = np.exp(-2j * np.pi * t / period)
    swing = 2 * np.mean((angle - angle.mean()) * wave)
    surface = 2 * np.mean(elevation * wave)
    # the wet fraction rises smoothly over the height of the link and its diameter
    height = float(model.line.diameter[0]) + np.abs(link[:, 2])
    share = np.clip(0.5 + (elevation - nodes[:, 1, 2]) / height, 0.0, 1.0)
    return {
        "status": solution.status,
        "mean_rad": angle.mean(),
        "amplitude_rad": abs(swing),
        "phase_rad": np.angle(swing / surface),
        "wet": np.mean(share * share * (3.0 - 2.0 * share)),
    }


@cached_jit()
def _elevations(sea: Sea, position: Array, t: Array) -> Array:
    """Elevations (k,) [m] of the surface above a position (1, 3) [m] at times t (k,) [s]."""
    return jax.vmap(lambda time: sea.elevation(position, time)[0])(t)


@style.plot_style()
def draw_responses(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Amplitude, mean and phase of the first link over the waves' period, and its amplitude in waves 10 % higher."""
    figure = figures.new_figure(7.5, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    period = series(rows, "period_s")
    amplitude = series(rows, "amplitude_rad")
    curves = {"amplitude": amplitude, "mean": series(rows, "mean_rad"), "phase": np.unwrap(series(rows, "phase_rad"))}
    for axes, (label, values) in zip(panels, curves.items(), strict=True):
        axes.plot(period, values, label="as in the scene", **marks(0))
        axes.set_ylabel(f"{label} [rad]")
    if all(row.get("amplitude_10_percent_more") is not None for row in rows):
        higher = amplitude * (1.0 + series(rows, "amplitude_10_percent_more"))
        panels[0].plot(period, higher, label="waves 10 % higher", **marks(1))
        figures.legend_above(panels[0], 2, borderaxespad=0.2)
    panels[-1].set_xlabel("period of the waves [s]")
    figure.align_ylabels()
    return save_titled(figure, f"{name}: angle of the first link in regular waves", path)
