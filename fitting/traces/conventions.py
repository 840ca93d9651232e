"""Angle convention of a trace, given or inferred and always checked with the scene; possible mistakes of its file.

Two facts distinguish conventions. Links between fixed ends must close, which requires the right zero and side. Links
hang: the mean direction of each over the run is near that of the line at rest, which requires the right sign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from dropper_jax import statics
from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.traces.planar import pendulum_period, wrap
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace


class Change(NamedTuple):
    """A mistake in words, its correction, and the change of the angles (k, n) [rad] in the file's convention."""

    mistake: str
    fix: str
    apply: Callable[[np.ndarray], np.ndarray]


def changes(links: int) -> Iterator[Change]:
    """Changes without a number: mirrored links, relative angles, other orders of columns."""
    mirrors = (
        ("has the wrong sign", "reverse the sign of", lambda theta: -theta),
        ("is measured from the link's other end", "add half a turn to", lambda theta: theta + np.pi),
        ("is mirrored", "use half a turn minus the angles of", lambda theta: np.pi - theta),
    )
    for mistake, fix, mirror in mirrors:
        for j in range(links):
            name = f"theta_{j + 1}"
            yield Change(f"{name} {mistake}", f"{fix} {name}", _of_column(j, mirror))
    # a wrong sign of all angles is a matter of the convention
    yield Change("all links are mirrored (seen from behind)", "use half a turn minus all angles", mirrors[2][2])
    if links > 1:
        fix = "add up the angles from theta_1 on"
        yield Change("angles are relative to the link before", fix, lambda theta: np.cumsum(theta, axis=1))
        fix = "name the columns from the first hook on"
        if links > 2:  # with two links they are swapped
            yield Change("columns are in the reverse order", fix, lambda theta: theta[:, ::-1])
        mistake = "columns are in the reverse order, and links measured from their other end"
        yield Change(mistake, fix, lambda theta: theta[:, ::-1] + np.pi)
    for j, k in combinations(range(links), 2):
        names = f"theta_{j + 1} and theta_{k + 1}"
        order = np.arange(links)
        order[[j, k]] = k, j
        yield Change(f"{names} are swapped", f"swap {names}", _with_columns(order))
    if links > 2:
        for by in range(1, links):
            fix = f"theta_1 belongs in column theta_{by + 1}"
            yield Change(f"columns are shifted by {by}", fix, _with_columns(np.roll(np.arange(links), by)))


def _of_column(j: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: np.where(np.arange(theta.shape[1]) == j, change(theta), theta)


def _with_columns(order: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: theta[:, order]


def shift(j: int | None, by: float) -> Change:
    """The zero of column j, or of all for None, shifted by -by [rad]."""
    if j is None:
        name = "all columns"
        more = ", or free camera.offset"
    else:
        name = f"theta_{j + 1}"
        more = ""
    fix = f"add {by:.3g} rad to {name}{more}"
    return Change(
        f"the zero of {name} is shifted by {-by:.3g} rad",
        fix,
        lambda theta: np.where((j is None) | (np.arange(theta.shape[1]) == j), theta + by, theta),
    )


def late_columns(links: int, frames: Sequence[int]) -> Iterator[Change]:
    """One column some frames later or earlier than the others."""
    ways = ((1, "late", "up"), (-1, "early", "down"))
    for j, by, (sign, when, where) in product(range(links), frames, ways):
        name = f"theta_{j + 1}"
        move = partial(_shift_frames, by=by * sign)
        yield Change(f"{name} is {by} frames {when}", f"move {name} {where} by {by} rows", _of_column(j, move))


def _shift_frames(theta: np.ndarray, by: int) -> np.ndarray:
    """The angles of `by` frames later, or earlier if negative; NaN where the trace has none."""
    moved = np.full_like(theta, np.nan)
    if by > 0:
        moved[:-by] = theta[by:]
    else:
        moved[-by:] = theta[:by]
    return moved


def units(named: Convention) -> Iterator[Change]:
    """Angles in the unit that is not the stated one."""
    if named.unit == "deg":
        yield Change("the unit is rad", "--unit rad", np.degrees)
    else:
        yield Change("the unit is deg", "--unit deg", np.radians)


#: Misfit [rad], and its ratio, by which another convention must fit better to reject one.
WORSE_MISFIT = 0.3
WORSE_RATIO = 2.0


def settle_convention(
    trace: Trace, model: Model, requested: Convention, distance: Callable[[Trace], float] | None = None
) -> tuple[Trace, list[str]]:
    """The trace in the model's convention, and warnings; `check_scale` comes first.

    Args:
        requested: given by the caller; it takes precedence over the file.
        distance: from the first recording of the same motion, which then decides between conventions that the scene's
            pose does not tell apart, such as the two signs of a hanging chain.

    Raises:
        SceneError: a specified convention that contradicts the scene.
    """
    named = requested.over(trace.convention)
    misfit = _misfits(trace, model, named.unit or "rad")
    allowed = [one for one in misfit if named.over(one) == one]
    best = min(misfit, key=misfit.__getitem__)
    own = min(allowed, key=misfit.__getitem__)
    alike = [one for one in allowed if not _is_worse(misfit[one], misfit[own])]
    source = "the scene's pose"
    if distance is not None and len(alike) > 1:
        own = min(alike, key=lambda one: distance(trace.in_model_convention(one)))
        source = "the first recording"
    if _is_worse(misfit[own], misfit[best]):
        raise SceneError(
            f"{trace.name}: zero={own.zero}, sign={own.sign} is {misfit[own]:.2f} rad from the scene's pose, "
            f"zero={best.zero}, sign={best.sign} only {misfit[best]:.2f}. Use the convention that fits"
        )
    warnings = list(trace.warnings)
    if named.zero is None or (named.sign is None and own.sign != 1):
        warnings.append(f"angles read as zero={own.zero}, sign={own.sign} (inferred from {source})")
    return trace.in_model_convention(own), [f"{trace.name}: {warning}" for warning in warnings]


def _is_worse(misfit: float, other: float) -> bool:
    return misfit > WORSE_RATIO * other and misfit > other + WORSE_MISFIT


def check_scale(trace: Trace, model: Model, requested: Convention) -> None:
    """Reject samples that are too far apart for the shortest link, and angles of another unit than stated.

    Raises:
        SceneError: with what to change.
    """
    _check_sampling(trace, model)
    _check_unit(trace, model, requested.over(trace.convention).unit)


def _check_sampling(trace: Trace, model: Model) -> None:
    # minimum number of samples per period of the shortest link as a pendulum
    samples_per_period = 6
    period = pendulum_period(model.line.length)
    if trace.interval > period / samples_per_period:
        raise SceneError(
            f"{trace.name}: a sample every {trace.interval:g} s is too few per oscillation of {period:.2g} s; "
            f"allowed: at most {period / samples_per_period:.2g} s apart, times in s"
        )


#: Rates above this multiple of sqrt(g/L) are impossible for a pendulum with angles in radians.
FASTEST_RATE = 15.0


def _check_unit(trace: Trace, model: Model, unit: str | None) -> None:
    """Ask for the unit if the nodes move too fast for radians, or move as radians would where degrees are specified.

    In a fall from twice the length of the chain to its lowest point a node reaches v^2/2 = 2 g sum L. The typical frame
    of a motion in radians is slower; degrees make v^2 3300 times larger.
    """
    largest = np.nanmax(np.abs(trace.theta))
    length = np.asarray(model.line.length)
    fastest = FASTEST_RATE * np.sqrt(GRAVITY / float(np.mean(length)))
    if unit != "deg" and _specific_energy(trace, length) > 2 * GRAVITY * float(np.sum(length)):
        if unit is None:
            fix = "Use --unit deg or --unit rad"
        else:
            fix = "The unit is rad. Use --unit deg"
        raise SceneError(f"{trace.name}: theta reaches {largest:.3g} and looks like degrees. {fix}")
    rate = np.abs(np.diff(trace.theta, axis=0) / np.diff(trace.t)[:, None])
    if unit == "deg" and largest < np.pi and np.nanmax(rate) < fastest:
        raise SceneError(
            f"{trace.name}: theta stays within 3.14 and looks like radians, but the unit is deg. Use --unit rad, or "
            "write the angles of such a small swing in radians"
        )


#: Fraction of the shortest link's period over which rates are computed to check the unit: 10 mrad noise is small then.
RATE_PERIODS = 0.05


def _specific_energy(trace: Trace, length: np.ndarray) -> float:
    """Kinetic energy per mass [J/kg] of the nodes in the median frame, with angles read as radians."""
    period = pendulum_period(length)
    apart = max(1, round(RATE_PERIODS * period / trace.interval))
    before = trace.theta[:-apart]
    after = trace.theta[apart:]
    omega = (after - before) / (trace.t[apart:] - trace.t[:-apart])[:, None]
    velocity = np.cumsum(1j * length * omega * np.exp(0.5j * (after + before)), axis=1)
    energy = 0.5 * np.mean(np.abs(velocity) ** 2, axis=1)
    energy = energy[np.isfinite(energy)]
    if len(energy):
        return float(np.median(energy))
    return 0.0


def resting_angles(model: Model) -> np.ndarray:
    """Angles (n,) [rad] of the links at rest, from the horizontal."""
    if not model.end_held:
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
        if model.end_held:
            found[convention] += _closure(model, theta)
    return found


def off_rest(theta: np.ndarray, rest: np.ndarray) -> float:
    """RMS departure [rad] of the links' mean directions from those at rest; links without samples are left out."""
    seen = np.isfinite(theta).any(axis=0)
    mean = np.angle(np.nanmean(np.exp(1j * theta[:, seen]), axis=0))
    return float(np.sqrt(np.mean(wrap(mean - rest[seen]) ** 2)))


def missing_reach(model: Model, theta: np.ndarray) -> np.ndarray:
    """From the end of the links to the second hook (k,) [m], x + i z with z downwards."""
    ends = model.ends(0.0)
    span = np.asarray(ends.end) - np.asarray(ends.start)
    return span[0] - 1j * span[2] - np.exp(1j * theta) @ np.asarray(model.line.length)


def _closure(model: Model, theta: np.ndarray) -> float:
    """RMS change of angles [rad] that closes some poses of the trace, to first order; at most pi."""
    rows = theta[np.isfinite(theta).all(axis=1)]
    miss = np.abs(missing_reach(model, rows[:: max(1, len(rows) // 50)]))
    square = np.sum(miss**2) / max(len(miss), 1) / np.sum(np.asarray(model.line.length) ** 2)
    return min(np.pi, float(np.sqrt(square)))
