"""How a trace counts its angles: named by the user or the file, else guessed; always checked against the scene.

Two facts tell conventions apart. Links between held ends must close, which only the right zero and side do; and links
hang: the mean direction of each over the run is near that of the resting line, which only the right sign does.
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

#: A named convention is refused when another one fits better by this much [rad] and by this factor.
WORSE_BY, WORSE_TIMES = 0.3, 2.0
#: Rates beyond this many sqrt(g/L) are no motion of a pendulum in radians.
FASTEST = 15.0
#: Part of the shortest link's period over which rates are taken to judge the unit: noise of 10 mrad is small over it.
UNIT_STEP = 0.05
#: Samples needed in a period of the shortest link as a pendulum.
SAMPLES_PER_PERIOD = 6


def settle_convention(trace: Trace, model: Model, requested: Convention) -> tuple[Trace, list[str]]:
    """The trace in the model's convention, and warnings.

    Args:
        requested: what the caller names; it comes before what the file names.

    Raises:
        SceneError: units of degrees that nobody named, or a named convention that the scene contradicts.
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
            f"zero={best[0]}, sign={best[1]} only {scored[best]:.2f}; allowed: the convention that fits"
        )
    warnings = [f"{trace.name}: {warning}" for warning in trace.warnings]
    if named.zero is None or (named.sign is None and own[1] != 1):
        warnings.append(f"{trace.name}: angles taken as zero={own[0]}, sign={own[1]} (guessed from the scene's pose)")
    return trace.in_model_convention(Convention(own[0], own[1], named.unit or "rad")), warnings


def check_sampling(trace: Trace, model: Model) -> None:
    """Refuse samples that are too far apart for the shortest link."""
    period = 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / GRAVITY)
    if trace.interval > period / SAMPLES_PER_PERIOD:
        raise SceneError(
            f"{trace.name}: a sample every {trace.interval:g} s is too few per oscillation of {period:.2g} s; "
            f"allowed: at most {period / SAMPLES_PER_PERIOD:.2g} s apart, times in s"
        )


def check_unit(trace: Trace, model: Model, named: Convention) -> None:
    """Ask about the unit where the nodes move as only degrees make them (or, named degrees, as only radians).

    In a fall from twice the length of the chain to its lowest point a node reaches v^2/2 = 2 g sum L. The typical frame
    of a motion in radians is slower; degrees make v^2 3300 times larger.
    """
    largest = np.nanmax(np.abs(trace.theta))
    fastest = FASTEST * np.sqrt(GRAVITY / float(np.mean(np.asarray(model.line.length))))
    if named.unit != "deg" and _specific_energy(trace, model) > 2 * GRAVITY * float(
        np.sum(np.asarray(model.line.length))
    ):
        fix = "name the unit: deg or rad" if named.unit is None else "the unit is rad; allowed: --unit deg"
        raise SceneError(f"{trace.name}: theta reaches {largest:.3g} and looks like degrees; {fix}")
    rate = np.abs(np.diff(trace.theta, axis=0) / np.diff(trace.t)[:, None])
    if named.unit == "deg" and largest < np.pi and np.nanmax(rate) < fastest:
        raise SceneError(
            f"{trace.name}: theta stays within 3.14 and looks like radians, but the unit is deg; allowed: rad"
        )


def _specific_energy(trace: Trace, model: Model) -> float:
    """Kinetic energy over mass [J/kg] of the nodes in the median frame, the angles taken for radians."""
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
    """Misfit [rad] of every convention: departure of the mean directions from rest, plus what closing them takes."""
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
