"""Angle convention of a trace (zero, sign, unit): given or inferred, and always checked with the scene.

The model counts the angle theta of a link from the +x axis, positive downwards (-z). The link, from its first to its
second node, is then `L (cos theta, 0, -sin theta)`, and a hanging one has theta = pi/2. An angle a [rad] of a file is

    zero=horizontal    theta = sign a             sign=1: positive downwards
    zero=down          theta = pi/2 - sign a      sign=1: positive towards +x

Two facts distinguish these four. Links between fixed ends must close, which requires the right zero and side. Links
hang: the mean direction of each over the run is near that of the line at rest, which requires the right sign. The unit
follows from the speed of the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from dropper_jax import statics
from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.traces.planar import pendulum_period, wrap
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace

#: Difference [rad] and ratio of two conventions' misfits from which the worse one is rejected. Conventions differ by a
#: quarter or half a turn; the mean direction of a short swing is off rest by less than the difference.
WORSE_MISFIT = 0.3
WORSE_RATIO = 2.0
#: Minimum number of samples per period of the shortest link as a pendulum, for its angles and rates between them.
FEWEST_PER_PERIOD = 6


def settle_convention(
    trace: Trace, model: Model, requested: Convention, distance: Callable[[Trace], float] | None = None
) -> tuple[Trace, list[str]]:
    """The trace in the model's convention, and warnings; `check_scale` comes first.

    Args:
        requested: the convention given by the caller, which takes precedence over that of the file.
        distance: of a trace from the first recording of the same motion [rad]. It decides between conventions that fit
            the scene's pose equally well, such as the two signs of a hanging chain.

    Raises:
        SceneError: a specified convention that contradicts the scene.
    """
    stated = requested.over(trace.convention)
    misfit = _misfits(trace, model, stated.unit or "rad")
    allowed = [one for one in misfit if stated.over(one) == one]
    best = min(misfit, key=misfit.__getitem__)
    chosen = min(allowed, key=misfit.__getitem__)
    alike = [one for one in allowed if not _is_worse(misfit[one], misfit[chosen])]
    source = "the scene's pose"
    if distance is not None and len(alike) > 1:
        chosen = min(alike, key=lambda one: distance(trace.in_model_convention(one)))
        source = "the first recording"
    if _is_worse(misfit[chosen], misfit[best]):
        raise SceneError(
            f"{trace.name}: zero={chosen.zero}, sign={chosen.sign} is {misfit[chosen]:.2f} rad from the scene's pose, "
            f"zero={best.zero}, sign={best.sign} only {misfit[best]:.2f}. Use the convention that fits"
        )
    warnings = list(trace.warnings)
    if stated.zero is None or (stated.sign is None and chosen.sign != 1):
        warnings.append(f"angles read as zero={chosen.zero}, sign={chosen.sign} (inferred from {source})")
    return trace.in_model_convention(chosen), [f"{trace.name}: {warning}" for warning in warnings]


def _is_worse(misfit: float, other: float) -> bool:
    """Whether a misfit [rad] is too much larger than another one."""
    return misfit > WORSE_RATIO * other and misfit > other + WORSE_MISFIT


def check_scale(trace: Trace, model: Model, requested: Convention) -> None:
    """Reject samples that are too far apart for the shortest link, and angles of another unit than stated.

    Raises:
        SceneError: with what to change.
    """
    period = pendulum_period(model.line.length)
    longest = period / FEWEST_PER_PERIOD
    if trace.interval > longest:
        raise SceneError(
            f"{trace.name}: a sample every {trace.interval:g} s is too few per oscillation of {period:.2g} s; "
            f"allowed: at most {longest:.2g} s apart, times in s"
        )
    _check_unit(trace, model, requested.over(trace.convention).unit)


#: Rates above this multiple of sqrt(g/L) are impossible for a pendulum with angles in radians.
FASTEST_RATE = 15.0


def _check_unit(trace: Trace, model: Model, unit: str | None) -> None:
    """Ask for the unit if the nodes move too fast for radians, or move as radians would where degrees are specified.

    In a fall from twice the length of the chain to its lowest point a node reaches v^2/2 = 2 g sum L. The typical frame
    of a motion in radians is slower; degrees make v^2 3300 times larger.
    """
    largest = np.nanmax(np.abs(trace.theta))
    length = np.asarray(model.line.length)
    fastest = FASTEST_RATE * np.sqrt(GRAVITY / np.mean(length))
    if unit != "deg" and _specific_energy(trace, length) > 2 * GRAVITY * np.sum(length):
        fix = "Use --unit deg or --unit rad" if unit is None else "The unit is rad. Use --unit deg"
        raise SceneError(f"{trace.name}: theta reaches {largest:.3g} and looks like degrees. {fix}")
    theta = trace.across_gaps(MAX_GAP_PERIODS * pendulum_period(length))
    rate = np.abs(np.diff(theta, axis=0) / np.diff(trace.t)[:, None])
    if unit == "deg" and largest < np.pi and np.nanmax(rate) < fastest:
        raise SceneError(
            f"{trace.name}: theta stays within 3.14 and looks like radians, but the unit is deg. Use --unit rad, or "
            "write the angles of such a small swing in radians"
        )


#: Fraction of the shortest link's period over which rates are computed to check the unit: 10 mrad noise is small then.
RATE_PERIODS = 0.05
#: Longest gap between known frames of a link, as a fraction of that period, across which their difference is its rate.
MAX_GAP_PERIODS = 0.5


def _specific_energy(trace: Trace, length: np.ndarray) -> float:
    """Kinetic energy per mass [J/kg] of the nodes in the median frame, with angles read as radians."""
    period = pendulum_period(length)
    apart = max(1, round(RATE_PERIODS * period / trace.interval))
    theta = trace.across_gaps(MAX_GAP_PERIODS * period)
    before = theta[:-apart]
    after = theta[apart:]
    omega = (after - before) / (trace.t[apart:] - trace.t[:-apart])[:, None]
    # the end of link j moves relative to its start by d/dt of L exp(i theta)
    relative = 1j * length * omega * np.exp(0.5j * (after + before))
    velocity = np.cumsum(relative, axis=1)
    energy = 0.5 * np.mean(np.abs(velocity) ** 2, axis=1)
    energy = energy[np.isfinite(energy)]
    if len(energy):
        return np.median(energy)
    return 0.0


def resting_angles(model: Model) -> np.ndarray:
    """Angles (n,) [rad] of the links at rest, from the horizontal."""
    if not model.both_ends_fixed:
        return np.full(model.line.links, np.pi / 2)
    pose = statics.equilibrium(model)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    link = np.diff(np.asarray(pose.positions), axis=0)
    return np.arctan2(-link[:, 2], link[:, 0])


def _misfits(trace: Trace, model: Model, unit: str) -> dict[Convention, float]:
    """Misfit [rad] of every convention: deviation of the mean directions from rest, plus the correction that closes."""
    rest = resting_angles(model)
    found = {}
    for zero, sign in product(ZEROS, map(int, SIGNS)):
        convention = Convention(zero, sign, unit)
        theta = trace.in_model_convention(convention).theta
        found[convention] = off_rest(theta, rest)
        if model.both_ends_fixed:
            found[convention] += _closure(model, theta)
    return found


def off_rest(theta: np.ndarray, rest: np.ndarray) -> float:
    """RMS difference [rad] of the links' mean directions from those at rest; links without samples are left out.

    Args:
        theta: angles (k, n) [rad] in the model's convention.
        rest: angles (n,) [rad] at rest.
    """
    seen = np.isfinite(theta).any(axis=0)
    mean = np.angle(np.nanmean(np.exp(1j * theta[:, seen]), axis=0))
    return np.sqrt(np.mean(wrap(mean - rest[seen]) ** 2))


def missing_reach(model: Model, theta: np.ndarray) -> np.ndarray:
    """Vector from the end of the last link to the second hook, as a complex number (k,) [m]: x + i times the depth.

    Args:
        theta: angles (k, n) [rad] in the model's convention.
    """
    ends = model.ends(0.0)
    span = np.asarray(ends.end) - np.asarray(ends.start)
    return span[0] - 1j * span[2] - np.exp(1j * theta) @ np.asarray(model.line.length)


#: Number of poses of a trace whose closure distinguishes conventions.
CLOSED_POSES = 50


def _closure(model: Model, theta: np.ndarray) -> float:
    """RMS change of angles [rad] that closes some poses of the trace, to first order; at most pi."""
    rows = theta[np.isfinite(theta).all(axis=1)]
    every = max(1, len(rows) // CLOSED_POSES)
    miss = np.abs(missing_reach(model, rows[::every]))
    square = np.sum(miss**2) / max(len(miss), 1) / np.sum(np.asarray(model.line.length) ** 2)
    return min(np.pi, np.sqrt(square))
