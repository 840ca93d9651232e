"""Files that do not belong to a scene between two fixed points: their frames do not close.

The links at their measured angles must end at the second hook, within the noise. Otherwise every correction that a file
may need is tried, and the one that closes the frames is reported. This check comes before a fit; `rising_energy` is
another one, and `file_diagnosis` follows a fit that does not explain the trace.

The opening of a frame is the distance from the last link's end to the second hook, as the RMS change of every angle
[rad] that closes it.
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

#: Opening [rad] above which a mistake is searched for. Noise gives 0.01, lengths wrong by 2 % give 0.02, a marker off
#: by 1 degree less; free parameters explain these.
OPEN_ANGLE = 0.05
#: Opening [rad] above which frames that no correction closes are rejected.
REFUSED_ANGLE = 0.1
#: Fraction of the opening that a reported correction may leave.
CLOSING_SHARE = 0.3
#: Openings up to this multiple of the smallest one, and this much larger [rad], count as equally small.
ALIKE_RATIO = 1.5
ALIKE_ANGLE = 1e-3
#: Minimum number of complete frames for the check, and maximum number that are used.
FEWEST_FRAMES = 10
MOST_FRAMES = 400
#: Maximum number of frames by which one column may be late.
MOST_LATE_FRAMES = 30
#: Words in the paths of free parameters that move the hooks, the links or the measured angles: with these, frames need
#: not close as given.
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
    if not model.both_ends_fixed or len(_complete(trace.theta)) < FEWEST_FRAMES:
        return []
    stated = requested.over(trace.convention)
    every = [Convention(zero, int(sign), "rad") for zero, sign in product(ZEROS, SIGNS)]
    allowed = [c for c in every if stated.zero in (None, c.zero) and stated.sign in (None, c.sign)]
    rows = stated.radians * trace.theta
    own = min(allowed, key=lambda c: _opening(model, c.in_model(rows)))
    given = _opening(model, own.in_model(rows))
    if given <= OPEN_ANGLE:
        return []
    moves = any(part in name for name in free for part in GEOMETRY_WORDS)
    tried = [TriedCorrection(one, at) for at in allowed for one in _plain_corrections(trace, stated)]
    if not moves:  # free parameters may cause the shift of the angles
        tried += [TriedCorrection(one, at) for at in allowed for one in _closing_shifts(model, rows, at)]
    tried += [_other_convention(at) for at in every if at not in allowed]
    apart = f"the links at their angles end {given * _reach(model):.2g} m from the second hook"
    openings = np.array([_opening(model, one.angles(rows)) for one in tried])
    if openings.min() < min(OPEN_ANGLE, CLOSING_SHARE * given):
        number = _best_correction(model, tried, openings, rows)
        best = tried[number].correction
        left = openings[number] * _reach(model)
        words = f"{best.mistake}, as it seems: {apart} as given, {left:.2g} m without this mistake"
        if given <= REFUSED_ANGLE:  # a camera rolled by 2 degrees opens them as far, and a fit may free its roll
            return [f"{trace.name}: {words}: {best.fix}, or free what opens them (--auto-free)"]
        raise SceneError(f"{trace.name}: {words}. To correct it: {best.fix}")
    if given > REFUSED_ANGLE and not moves:
        cause = _open_cause(model, own.in_model(rows), free)
        raise SceneError(f"{trace.name}: {apart} in the median frame; likeliest cause: {cause}")
    return [f"{trace.name}: {apart} in the median frame: check lengths, hooks and the zeros of the angles"]


def _other_convention(at: Convention) -> TriedCorrection:
    """Angles that count by another convention than the one that is stated."""
    words = f"angles count as zero={at.zero}, sign={at.sign}"
    option = f"--zero {at.zero} --sign={at.sign}"
    return TriedCorrection(Correction(words, option, lambda theta: theta), at)


def _plain_corrections(trace: Trace, stated: Convention) -> list[Correction]:
    """Corrections that do not depend on the angles."""
    late = late_columns(trace.links, range(1, MOST_LATE_FRAMES + 1))
    return [*corrections(trace.links), *late, *other_unit(stated)]


def _best_correction(model: Model, tried: Sequence[TriedCorrection], openings: np.ndarray, rows: np.ndarray) -> int:
    """Number of the correction that closes the frames best; of equally good ones, that whose links hang as at rest."""
    alike = np.flatnonzero(openings < ALIKE_RATIO * openings.min() + ALIKE_ANGLE)
    rest = resting_angles(model)
    return min(alike, key=lambda i: round(off_rest(tried[i].angles(rows), rest), 2))


class TriedCorrection(NamedTuple):
    """A correction of a file, and the convention in which its angles are then counted."""

    correction: Correction
    convention: Convention

    def angles(self, rows: np.ndarray) -> np.ndarray:
        """The file's angles (k, n) [rad], corrected, in the model's convention."""
        return self.convention.in_model(self.correction.apply(rows))


def _open_cause(model: Model, theta: np.ndarray, free: Sequence[str]) -> str:
    """Why frames (k, n) do not close that no change of the file closes, and what to try."""
    theta = _complete(theta)
    length = np.asarray(model.line.length)
    missing = missing_reach(model, theta)
    off = complex(np.median(missing.real), np.median(missing.imag))
    still_open = OPEN_ANGLE * _reach(model)  # [m]
    links = np.exp(1j * theta)
    rows = np.concatenate([links.real, links.imag])
    more = np.linalg.lstsq(rows, np.concatenate([missing.real, missing.imag]), rcond=None)[0]
    by_hook = np.median(np.abs(missing - off))
    by_lengths = np.median(np.abs(missing - links @ more))
    # there are more lengths than coordinates of the hook: they must close the frames clearly better
    if by_hook < min(still_open, 2.0 * by_lengths):
        where = f"{-off.real:+.2g} m in x and {off.imag:+.2g} m in z"
        hook = f"point.{model.geometry.held_points[-1]}.position"
        paths = (f"{hook}.0", f"{hook}.2")
        return f"the second hook is {where} from its position; free it: {free_option(free, paths)}"
    if by_lengths < still_open and np.all(np.abs(more) < 0.5 * length):
        right = ", ".join(f"{x:.3g}" for x in length + more)
        return f"wrong lengths ({right} m close them); free them: {free_option(free, ['line.0.length'])}"
    return (
        "a line of other links than the scene's, or the file of another one. Use the file of this scene, or check "
        f"`links` ({len(length)} in the scene), their order and the hooks"
    )


def _complete(theta: np.ndarray) -> np.ndarray:
    """The frames (k, n) in which every angle is known."""
    return theta[np.isfinite(theta).all(axis=1)]


def _opening(model: Model, theta: np.ndarray) -> float:
    """RMS change of every angle [rad] that closes the frames (k, n), by their median frame."""
    theta = _complete(theta)
    if len(theta) < FEWEST_FRAMES:
        return np.inf
    size = np.abs(missing_reach(model, theta[:: max(1, len(theta) // MOST_FRAMES)]))
    return np.median(size) / _reach(model)


def _reach(model: Model) -> float:
    """Distance [m] from the second hook, in the median frame, for a change of every angle by 1 rad."""
    # the median of a squared deviation in two directions is log(2) of its mean
    return np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2))


def _closing_shifts(model: Model, theta: np.ndarray, at: Convention) -> Iterator[Correction]:
    """Shifts of one column, or of all, that close the frames best."""
    angle = _complete(at.in_model(theta))
    missing = missing_reach(model, angle)
    link = np.asarray(model.line.length) * np.exp(1j * angle)
    for j, reach in [*enumerate(link.T), (None, link.sum(axis=1))]:
        yield shifted_zero(j, at.turn * np.angle(np.sum((missing + reach) * reach.conj())))
