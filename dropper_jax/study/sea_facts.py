"""Properties of the sea of a scene: waves by the valid theories, breaking, current."""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.load.sea_warnings import SHALLOW_HEIGHT, mean_period, steepest_sea
from dropper_jax.sea import Sea
from dropper_jax.sea.make import finite_wave, make_current, make_sea
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import SteadyWave, fitting_theory, highest, second_harmonic
from dropper_jax.sea.waves import Waves


def sea_facts(scene: Scene) -> Table:
    """Facts about the water of a scene: {depth_m, waves, current}; the last two may be None.

    Raises:
        ValueError: the scene has no sea.
    """
    spec = scene.sea
    if spec is None:
        raise ValueError(f"scene {scene.name!r} has no [sea]. Use a scene with water")
    return {"depth_m": spec.depth, "waves": _waves(spec), "current": _current(spec)}


def _waves(spec: SeaSpec) -> Table | None:
    if spec.waves is None:
        return None
    wave = finite_wave(spec)
    if wave is not None:
        return _steady(wave)
    sea = make_sea(replace(spec, interpolation="none"))
    if sea.waves.size == 1:
        return _linear(sea.waves, spec.depth)
    return _irregular(sea, spec)


def _regular(theory: str, height: float, length: float, period: float, depth: float, **more: float) -> Table:
    """Facts of regular waves; `more` has those that one theory alone gives, or gives more accurately."""
    limit = highest(length, depth)
    return {
        "kind": "regular",
        "theory": theory,
        "height_m": height,
        "period_s": period,
        "length_m": length,
        "celerity_m_per_s": length / period,
        "depth_over_length": depth / length,
        "steepness": height / length,
        "ursell": height * length**2 / depth**3,
        "second_harmonic": second_harmonic(height, length, depth),
        "highest_m": limit,
        "share_of_highest": height / limit,
        "fitting_theory": fitting_theory(height, length, depth),
        **more,
    }


def _steady(wave: SteadyWave) -> Table:
    return _regular(
        wave.theory,
        wave.height,
        wave.length,
        wave.period,
        wave.depth,
        celerity_m_per_s=wave.celerity,
        crest_m=wave.crest,
        trough_m=wave.crest - wave.height,
        mean_eulerian_m_per_s=wave.eulerian,
        mean_transport_m_per_s=wave.transport,
        crest_speed_m_per_s=float(wave.velocity(np.zeros(1), np.array([wave.crest]))[0, 0]),
        harmonics=wave.order,
        error=wave.error,
    )


def _linear(waves: Waves, depth: float) -> Table:
    a, k, omega = (float(x[0]) for x in (waves.amplitude, waves.wave_number, waves.omega))
    return _regular("linear", 2.0 * a, 2.0 * np.pi / k, 2.0 * np.pi / omega, depth, crest_m=a, trough_m=-a)


def _irregular(sea: Sea, spec: SeaSpec) -> Table:
    """Hs, mean period `Tz = 2 pi sqrt(m0/m2)`, and the limits of depth and of steepness."""
    hs = float(sea.waves.significant_height)
    tz = mean_period(sea)
    limits = {"depth": SHALLOW_HEIGHT * spec.depth, "steepness": steepest_sea(tz, spec.gravity)}
    limit, breaking = min(limits.items(), key=itemgetter(1))
    return {
        "kind": "irregular",
        "theory": "linear",
        "components": int(sea.waves.size),
        "significant_height_m": hs,
        "mean_period_s": tz,
        "peak_period_s": float(sea.waves.peak_period),
        "hs_over_depth": hs / spec.depth,
        "steepness": 2.0 * np.pi * hs / (spec.gravity * tz**2),
        "breaking_hs_m": breaking,
        "breaking_by": limit,
        "share_of_breaking": hs / breaking,
    }


def _current(spec: SeaSpec) -> Table | None:
    if spec.current is None:
        return None
    heights = np.array([0.0, -0.5 * spec.depth, -0.95 * spec.depth])
    x, y, *_ = np.asarray(make_current(spec.current).profile(jnp.asarray(heights), jnp.asarray(spec.depth))).T
    values = {"speed_m_per_s": np.hypot(x, y), "direction_rad": np.arctan2(y, x)}
    return {"kind": spec.current.kind, "heights_m": heights, **values}
