"""Angle convention of a trace: specified by the user or the file, otherwise inferred; always checked with the scene.

Two facts distinguish conventions. Links between fixed ends must close, which requires the right zero and side. Links
hang: the mean direction of each over the run is near that of the line at rest, which requires the right sign.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from dropper_jax import statics
from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.traces.planar import wrap
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace

#: Difference of misfit [rad], and its ratio, by which another convention must fit better to reject the specified one.
WORSE_BY, WORSE_TIMES = 0.3, 2.0
#: Rates above this multiple of sqrt(g/L) are impossible for a pendulum with angles in radians.
FASTEST = 15.0
#: Fraction of the shortest link's period over which rates are computed to check the unit: 10 mrad noise is small then.
UNIT_STEP = 0.05
#: Minimum number of samples per period of the shortest link as a pendulum.
SAMPLES_PER_PERIOD = 6


def settle_convention(trace: Trace, model: Model, requested: Convention) -> tuple[Trace, list[str]]:
    """The trace in the model's convention, and warnings.

    Args:
        requested: given by the caller; it takes precedence over the file.

    Raises:
        SceneError: angles in degrees without a unit, or a specified convention that contradicts the scene.
    """
    named = requested.over(trace.convention)
    check_sampling(trace, model)
    check_unit(trace, model, named)
    scored = _scores(trace, model, named.unit)
    allowed = {
        key: value for key, value in scored.items() if (named.zero in (None, key[0])) and (named.sign in (None, key[1]))
    }
    best, own = min(scored, key=scored.get), min(allowed, key=allowed.get)
    if scored[own] > WORSE_TIMES * scored[best] and scored[own] > scored[best] + WORSE_BY:
        raise SceneError(
            f"{trace.name}: zero={own[0]}, sign={own[1]} is {scored[own]:.2f} rad from the scene's pose, "
            f"zero={best[0]}, sign={best[1]} only {scored[best]:.2f}. Use the convention that fits"
        )
    warnings = [f"{trace.name}: {warning}" for warning in trace.warnings]
    if named.zero is None or (named.sign is None and own[1] != 1):
        warnings.append(f"{trace.name}: angles read as zero={own[0]}, sign={own[1]} (inferred from the scene's pose)")
    return trace.in_model_convention(Convention(own[0], own[1], named.unit or "rad")), warnings


def check_sampling(trace: Trace, model: Model) -> None:
    """Reject samples that are too far apart for the shortest link."""
    period = 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / GRAVITY)
    if trace.interval > period / SAMPLES_PER_PERIOD:
        raise SceneError(
            f"{trace.name}: a sample every {trace.interval:g} s is too few per oscillation of {period:.2g} s; "
            f"allowed: at most {period / SAMPLES_PER_PERIOD:.2g} s apart, times in s"
        )


def check_unit(trace: Trace, model: Model, named: Convention) -> None:
    """Ask for the unit if the nodes move too fast for radians (or, with degrees specified, too slowly for degrees).

    In a fall from twice the length of the chain to its lowest point a node reaches v^2/2 = 2 g sum L. The typical frame
    of a motion in radians is slower; degrees make v^2 3300 times larger.
    """
    largest = np.nanmax(np.abs(trace.theta))
    fastest = FASTEST * np.sqrt(GRAVITY / float(np.mean(np.asarray(model.line.length))))
    if named.unit != "deg" and _specific_energy(trace, model) > 2 * GRAVITY * float(
        np.sum(np.asarray(model.line.length))
    ):
        fix = "Use --unit deg or --unit rad" if named.unit is None else "The unit is rad. Use --unit deg"
        raise SceneError(f"{trace.name}: theta reaches {largest:.3g} and looks like degrees. {fix}")
    rate = np.abs(np.diff(trace.theta, axis=0) / np.diff(trace.t)[:, None])
    if named.unit == "deg" and largest < np.pi and np.nanmax(rate) < fastest:
        raise SceneError(
            f"{trace.name}: theta stays within 3.14 and looks like radians, but the unit is deg; allowed: rad"
        )


def _specific_energy(trace: Trace, model: Model) -> float:
    """Kinetic energy per mass [J/kg] of the nodes in the median frame, with angles read as radians."""
    period = 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / GRAVITY)
    apart = max(1, round(UNIT_STEP * period / trace.interval))
    step = trace.t[apart:] - trace.t[:-apart]
    omega = (trace.theta[apart:] - trace.theta[:-apart]) / step[:, None]
    middle = 0.5 * (trace.theta[apart:] + trace.theta[:-apart])
    velocity = np.cumsum(1j * np.asarray(model.line.length) * omega * np.exp(1j * middle), axis=1)
    energy = 0.5 * np.mean(np.abs(velocity) ** 2, axis=1)
    energy = energy[np.isfinite(energy)]
    return float(np.median(energy)) if len(energy) else 0.0


def resting_angles(model: Model) -> np.ndarray:
    """Angles (n,) [rad] of the links at rest, from the horizontal."""
    if not model.end_held:
        return np.full(model.line.links, np.pi / 2)
    pose = statics.equilibrium(model)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    link = np.diff(np.asarray(pose.positions), axis=0)
    return np.arctan2(-link[:, 2], link[:, 0])


def _scores(trace: Trace, model: Model, unit: str | None) -> dict[tuple[str, int], float]:
    """Misfit [rad] of every convention: deviation of the mean directions from rest, plus the correction that closes."""
    rest = resting_angles(model)
    found = {}
    for zero, sign in product(ZEROS, map(int, SIGNS)):
        theta = trace.in_model_convention(Convention(zero, sign, unit)).theta
        mean = np.arctan2(np.nanmean(np.sin(theta), axis=0), np.nanmean(np.cos(theta), axis=0))
        score = float(np.sqrt(np.mean(np.asarray(wrap(mean - rest)) ** 2)))
        found[zero, sign] = score + (_closure(model, theta) if model.end_held else 0.0)
    return found


def _closure(model: Model, theta: np.ndarray) -> float:
    """RMS change of angles [rad] that closes some poses of the trace, to first order; at most pi."""
    rows = theta[np.isfinite(theta).all(axis=1)]
    rows = rows[:: max(1, len(rows) // 50)]
    if not len(rows):
        return 0.0
    length = np.asarray(model.line.length)
    ends = model.ends(0.0)
    reach = np.stack([np.cos(rows) @ length, -np.sin(rows) @ length], axis=1)
    miss = reach - np.asarray(ends.end - ends.start)[[0, 2]]
    return float(min(np.pi, np.sqrt(np.mean(np.sum(miss**2, axis=1))) / np.sqrt(np.sum(length**2))))
