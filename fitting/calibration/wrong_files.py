"""Files that do not belong to the scene, or use another angle convention: the mistake is reported with its fix.

There are two checks before a fit, and one after it (`short_windows`):

1. Between fixed points every frame must close: the links at their measured angles end at the second hook, within the
   noise. Each change that a file may need is tried, and the one that closes the frames is reported.
2. Damping dissipates energy. If the energy of the motion rises, rows are reversed in time or two runs are in one file.
   Short windows do not detect this: without damping a motion also runs backwards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.calibration.spans import Interval
from fitting.parameters.names import DAMPING, free_option
from fitting.traces.conventions import (
    Change,
    changes,
    late_columns,
    missing_reach,
    off_rest,
    resting_angles,
    shift,
    units,
)
from fitting.traces.noise import smooth_stretch
from fitting.traces.planar import energies, wrap
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace

#: RMS change of every angle [rad] that closes the frames, above which a mistake is searched for, and above which frames
#: that no change closes are rejected. Noise is 0.01, lengths wrong by 2 % give 0.02, a marker off by 1 degree less;
#: free parameters explain these.
OPEN_ANGLE = 0.05
REFUSED_ANGLE = 0.1
#: Fraction of the misfit of closure that a reported change may leave.
CLOSING_SHARE = 0.3
#: Minimum number of complete frames for the check, and maximum number that are used.
FEWEST_FRAMES = 10
MOST_FRAMES = 400
#: Frames by which one column may be late.
MOST_LATE_FRAMES = 30
#: Free parameters that move the hooks, the links or the measured angles: with these, frames need not close as given.
GEOMETRY_WORDS = ("length", "position", "camera", "marker", "clock", "scale")
#: Stretches over which a run is averaged, the fraction of them in which the energy of a reversed run rises, and its
#: total growth factor. Kicks raise it once.
STRETCHES = 10
RISING_FRACTION = 0.75
RISE_FACTOR = 1.3


def refuse_wrong_file(trace: Trace, model: Model, requested: Convention, free: Sequence[str] = ()) -> list[str]:
    """Reject a trace between fixed points whose frames do not close; warn if they nearly do.

    Args:
        trace: in the convention of the file.
        requested: the convention given by the caller.
        free: names of the parameters that a fit frees; those of the geometry may close the frames.

    Raises:
        SceneError: the change that closes the frames, or that none does.
    """
    frames = trace.theta[np.isfinite(trace.theta).all(axis=1)]
    if not model.end_held or len(frames) < FEWEST_FRAMES:
        return []
    named = requested.over(trace.convention)
    every = [Convention(zero, int(sign), "rad") for zero, sign in product(ZEROS, SIGNS)]
    allowed = [c for c in every if named.zero in (None, c.zero) and named.sign in (None, c.sign)]
    rows = named.radians * trace.theta
    own = min(allowed, key=lambda c: _opening(model, c.in_model(rows)))
    given = _opening(model, own.in_model(rows))
    if given <= OPEN_ANGLE:
        return []
    moves = any(part in name for name in free for part in GEOMETRY_WORDS)
    plain = [*changes(trace.links), *late_columns(trace.links, range(1, MOST_LATE_FRAMES + 1)), *units(named)]
    tried = [TriedChange(change, at) for at in allowed for change in plain]
    if not moves:  # free parameters may cause the shift of the angles
        tried += [TriedChange(change, at) for at in allowed for change in _closing_shifts(model, rows, at)]
    for at in every:
        if at not in allowed:
            words = f"angles count as zero={at.zero}, sign={at.sign}"
            tried.append(TriedChange(Change(words, f"--zero {at.zero} --sign={at.sign}", lambda theta: theta), at))
    openings = np.array([_opening(model, one.angles(rows)) for one in tried])
    smallest = float(openings.min())
    apart = f"the links at their angles end {given * _reach(model):.2g} m from the second hook"
    if smallest < min(OPEN_ANGLE, CLOSING_SHARE * given):
        # of changes that close equally well, the one with links that hang as at rest
        alike = np.flatnonzero(openings < 1.5 * smallest + 1e-3)
        rest = resting_angles(model)
        best = min(alike, key=lambda i: round(off_rest(tried[i].angles(rows), rest), 2))
        fix = tried[best].change.fix
        remaining = openings[best] * _reach(model)
        words = f"{tried[best].change.mistake}, as it seems: {apart} as given, {remaining:.2g} m without this mistake"
        if given <= REFUSED_ANGLE:  # a camera rolled by 2 degrees opens them as far, and a fit may free its roll
            return [f"{trace.name}: {words}: {fix}, or free what opens them (--auto-free)"]
        raise SceneError(f"{trace.name}: {words}. To correct it: {fix}")
    if given > REFUSED_ANGLE and not moves:
        cause = _open_cause(model, own.in_model(rows), free)
        raise SceneError(f"{trace.name}: {apart} in the median frame; likeliest cause: {cause}")
    return [f"{trace.name}: {apart} in the median frame: check lengths, hooks and the zeros of the angles"]


class TriedChange(NamedTuple):
    """A change of a file, and the convention in which its angles are then counted."""

    change: Change
    convention: Convention

    def angles(self, rows: np.ndarray) -> np.ndarray:
        """The file's angles (k, n) [rad], changed, in the model's convention."""
        return self.convention.in_model(self.change.apply(rows))


def _open_cause(model: Model, theta: np.ndarray, free: Sequence[str]) -> str:
    """Why frames (k, n) do not close that no change of the file closes, and what to try."""
    theta = theta[np.isfinite(theta).all(axis=1)]
    length = np.asarray(model.line.length)
    missing = missing_reach(model, theta)
    off = complex(np.median(missing.real), np.median(missing.imag))
    # [m] by which frames may still be open
    still = OPEN_ANGLE * _reach(model)
    links = np.exp(1j * theta)
    rows = np.concatenate([links.real, links.imag])
    more = np.linalg.lstsq(rows, np.concatenate([missing.real, missing.imag]), rcond=None)[0]
    by_hook = float(np.median(np.abs(missing - off)))
    by_lengths = float(np.median(np.abs(missing - links @ more)))
    # more numbers must close the frames clearly better
    if by_hook < min(still, 2.0 * by_lengths):
        where = f"{-off.real:+.2g} m in x and {off.imag:+.2g} m in z"
        hook = f"point.{int(model.geometry.held_points[-1])}.position"
        paths = (f"{hook}.0", f"{hook}.2")
        return f"the second hook is {where} from its position; free it: {free_option(free, paths)}"
    if by_lengths < still and np.all(np.abs(more) < 0.5 * length):
        right = ", ".join(f"{x:.3g}" for x in length + more)
        return f"wrong lengths ({right} m close them); free them: {free_option(free, ['line.0.length'])}"
    return (
        "a line of other links than the scene's, or the file of another one. Use the file of this scene, or check "
        f"`links` ({len(length)} in the scene), their order and the hooks"
    )


def _opening(model: Model, theta: np.ndarray) -> float:
    """RMS change of every angle [rad] that closes the frames (k, n), by their median frame."""
    theta = theta[np.isfinite(theta).all(axis=1)]
    if len(theta) < FEWEST_FRAMES:
        return np.inf
    size = np.abs(missing_reach(model, theta[:: max(1, len(theta) // MOST_FRAMES)]))
    return float(np.median(size) / _reach(model))


def _reach(model: Model) -> float:
    """Distance [m] from the second hook, in the median frame, for a change of every angle by 1 rad."""
    # the median of a squared deviation in two directions is log(2) of its mean
    return float(np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2)))


def _closing_shifts(model: Model, theta: np.ndarray, at: Convention) -> Iterator[Change]:
    """Shifts of one column, or of all, that close the frames best."""
    angle = at.in_model(theta)
    angle = angle[np.isfinite(angle).all(axis=1)]
    missing = missing_reach(model, angle)
    link = np.asarray(model.line.length) * np.exp(1j * angle)
    for j, reach in [*enumerate(link.T), (None, link.sum(axis=1))]:
        yield shift(j, at.turn * float(np.angle(np.sum((missing + reach) * reach.conj()))))


#: Half width of the smoother of the energy, as a fraction of the shortest link's period.
SMOOTHER_PERIODS = 0.06
#: Minimum energy of a second run over the largest of the file, a tenth of its amplitude: at the end of a long decay
#: rounding of an encoder raises smaller ones.
SECOND_RUN_ENERGY = 0.01


def refuse_rising_energy(trace: Trace, model: Model, spans: Sequence[Interval], period: float) -> None:
    """Reject a trace whose energy rises: two runs in one file, or rows reversed in time.

    Args:
        trace: in the model's convention.
        spans: from, to [s] of the fitted samples.
        period: of the shortest link [s].

    Raises:
        SceneError: the time of the second run, or that the rows are reversed.
    """
    if any(e.name not in ("weight", *DAMPING) for e in model.effects):
        return  # water and springs have energies of their own
    low = spans[0][0]
    high = spans[-1][1]
    motion = smooth_stretch(trace, (low, high), SMOOTHER_PERIODS * period)
    if motion is None:
        return
    t, theta, omega = motion
    rest = resting_angles(model)
    *energy, at_rest = np.asarray(energies(model, np.vstack([theta, rest]), np.vstack([omega, 0 * rest])))
    energy = np.array(energy) - at_rest
    inside = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    t = t[inside]
    energy = energy[inside]
    for at in _breaks(trace):
        before = energy[(t > at - period) & (t < at)]
        after = energy[(t > at) & (t < at + period)]
        # medians: the smoother turns a jump into a transient of a few frames
        if not len(before) or not len(after):
            continue
        if np.median(after) > max(RISE_FACTOR * np.median(before), SECOND_RUN_ENERGY * energy.max()):
            raise SceneError(
                f"{trace.name}: two runs in one file, as it seems: the angles jump at {at:.4g} s, and their energy "
                f"rises from {np.median(before):.3g} to {np.median(after):.3g} J. Use one file per run, or "
                f"--until {at:.4g} for the first one"
            )
    parts = np.array([np.median(part) for part in np.array_split(energy, STRETCHES)])
    rising = float(np.mean(np.diff(parts) > 0))
    if rising >= RISING_FRACTION and parts[-2:].mean() > RISE_FACTOR * parts[:2].mean():
        raise SceneError(
            f"{trace.name}: time is reversed, as it seems: the energy of the motion rises from "
            f"{parts[:2].mean():.3g} to {parts[-2:].mean():.3g} J. Reverse the rows"
        )


#: Frames to either side of a jump, and the multiple of their fastest motion by which angles move where a run starts.
NEAR_FRAMES = 5
JUMP_RATIO = 4.0


def _breaks(trace: Trace) -> np.ndarray:
    """Times [s] at which most links jump, or where frames are missing."""
    move = np.abs(wrap(np.diff(trace.theta, axis=0)))
    around = np.lib.stride_tricks.sliding_window_view(move, 2 * NEAR_FRAMES + 1, axis=0)
    near = np.nanmax(np.delete(around, NEAR_FRAMES, axis=2), axis=2, initial=0.0)
    beyond = move[NEAR_FRAMES:-NEAR_FRAMES] - JUMP_RATIO * near
    beyond[np.isnan(beyond).all(axis=1)] = -1.0  # nothing is known of these frames
    missing = np.diff(trace.t)[NEAR_FRAMES:-NEAR_FRAMES] > 10 * trace.interval
    return trace.t[NEAR_FRAMES + 1 : -NEAR_FRAMES][missing | (np.nanmedian(beyond, axis=1) > 0)]
