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
from fitting.parameters.names import free_option
from fitting.traces.conventions import missing_reach, off_rest, resting_angles
from fitting.traces.file_mistakes import Correction, corrections, late_columns, other_unit, shifted_zero
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
    plain = [*corrections(trace.links), *late_columns(trace.links, range(1, MOST_LATE_FRAMES + 1)), *other_unit(named)]
    tried = [TriedChange(change, at) for at in allowed for change in plain]
    if not moves:  # free parameters may cause the shift of the angles
        tried += [TriedChange(change, at) for at in allowed for change in _closing_shifts(model, rows, at)]
    for at in every:
        if at not in allowed:
            words = f"angles count as zero={at.zero}, sign={at.sign}"
            tried.append(TriedChange(Correction(words, f"--zero {at.zero} --sign={at.sign}", lambda theta: theta), at))
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

    change: Correction
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


def _closing_shifts(model: Model, theta: np.ndarray, at: Convention) -> Iterator[Correction]:
    """Shifts of one column, or of all, that close the frames best."""
    angle = at.in_model(theta)
    angle = angle[np.isfinite(angle).all(axis=1)]
    missing = missing_reach(model, angle)
    link = np.asarray(model.line.length) * np.exp(1j * angle)
    for j, reach in [*enumerate(link.T), (None, link.sum(axis=1))]:
        yield shifted_zero(j, at.turn * float(np.angle(np.sum((missing + reach) * reach.conj()))))
