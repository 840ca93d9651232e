"""From a video to angle traces: everything in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from fitting.traces.trace import FEWEST, Trace
from fitting.tracking.angles import place_errors, to_trace
from fitting.tracking.calibration import Lens, Plane, calibrate, plane_from_board, plane_from_scale
from fitting.tracking.detection import Look, detect
from fitting.tracking.identity import Follower
from fitting.tracking.learning import learn
from fitting.tracking.ordering import Chain
from fitting.tracking.video import COMPLETE, Video

#: A marker that is not seen for longer [s] is lost: where it comes back is no longer certain.
LONGEST_GAP = 0.5
#: Change of a link's measured length, as a share of it, from which the pictures are not of a plane motion.
LENGTH_WARNING = 0.03


@dataclass(frozen=True)
class Tracked:
    """What a video holds.

    Attributes:
        trace: angles [rad] and standard errors, empty where a marker was not seen.
        pixels: (k, n, 2) places in the video's own pixels, bridged where not seen.
        metres: (k, n, 2) right and up of the first frame's node 0 [m]; pixels where no scale was given.
        seen: (k, n).
        look, lens, scaled: what a marker looks like, the lens or None, whether metres are metres.
        first_frame: of the video, that of the trace's first sample.
        fps [1/s]; status: `ok` or `not_converged`, with the reason in `message`.
    """

    trace: Trace
    pixels: np.ndarray
    metres: np.ndarray
    seen: np.ndarray
    look: Look
    lens: Lens | None
    scaled: bool
    first_frame: int
    fps: float
    status: str
    message: str
    warnings: tuple[str, ...]

    @property
    def link_lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n - 1,) of the links' measured lengths."""
        length = np.linalg.norm(np.diff(self.metres, axis=1), axis=-1)
        length = np.where(self.seen[:, 1:] & self.seen[:, :-1], length, np.nan)
        return np.nanmean(length, axis=0), np.nanstd(length, axis=0)

    def to_json(self) -> dict[str, Any]:
        """The result without its samples."""
        mean, deviation = self.link_lengths
        gap = _longest_gaps(self.seen)
        found = {
            "schema": 1,
            "status": self.status,
            "frames": len(self.seen),
            "fps": self.fps,
            "nodes": self.seen.shape[1],
            "links": self.seen.shape[1] - 1,
            "bridged": [int(x) for x in (~self.seen).sum(axis=0)],
            "longest_gap_s": float(gap.max() / self.fps),
            "angle_se_rad": float(np.nanmedian(self.trace.se)),
            "marker_radius_pixel": self.look.radius,
            "link_length_m": [float(x) for x in mean] if self.scaled else None,
            "link_length_deviation": [float(x) for x in deviation / mean],
            "reprojection_error_pixel": None if self.lens is None else self.lens.error,
            "warnings": list(self.warnings),
        }
        return found if self.status == "ok" else {**found, "error": self.message}


def track(
    video: str | Path,
    nodes: int,
    *,
    calibration: Sequence[str | Path] = (),
    board: tuple[int, int] = (9, 6),
    square: float | None = None,
    plane: str | Path | None = None,
    scale: float | None = None,
    distance: float | None = None,
    level: bool = False,
    radius: float | None = None,
    bright: bool | None = None,
    first: str = "auto",
    start: Sequence[tuple[float, float]] | None = None,
    fps: float | None = None,
    begin: float = 0.0,
    end: float | None = None,
    progress: Progress | None = None,
) -> Tracked:
    """Follow the markers of a chain through a video.

    Args:
        nodes: markers, both ends included: 8 for the lab dropper of 7 links.
        calibration: pictures of a chessboard with `board` inner corners, taken by the same camera.
        plane, square: a picture of the board in the plane of motion and its square [m]: metres, and no slant.
        scale [m/pixel] or distance [m] between the first and last marker: metres without a board.
        level: the first and last marker are at the same height; else the picture's rows are level.
        radius [pixel], bright: of the markers; default: what stands out most.
        first: end of the chain where node 0 is: auto (the only end at rest, else the left one), left, right, top.
        start: places (nodes, 2) [pixel] in the first frame, in order; default: found by which distances stay.
        fps: frames per second where the file is wrong, as for high-speed cameras.
        begin, end: [s] of the video to take; t = 0 is `begin`.

    Raises:
        SceneError: for anything the caller can mend, in one line.
    """
    if nodes < 2:
        raise SceneError(f"--nodes: {nodes} is too few; allowed: at least 2, both ends of the chain included")
    if sum(x is not None for x in (plane, scale, distance)) > 1:
        raise SceneError("track: more than one of --plane, --scale, --distance; allowed: one of them")
    if plane is not None and square is None:
        raise SceneError("--square: missing; needed: the side of the board's squares in m, since --plane is given")
    say = progress or silent
    film = Video(video, fps)
    lens = calibrate(calibration, board) if calibration else None
    if lens is not None and lens.size != film.size:
        raise SceneError(f"calibration: pictures of {lens.size} pixels; allowed: {film.size}, those of the video")
    span = _span(film, begin, end)
    say(0.0, "looking for markers")
    look, chain, offset = learn(film, span, nodes, lens, radius, bright, first, start)
    straight, error, seen, message = _follow(film, (span[0] + offset, span[1]), look, chain, lens, say)
    if len(straight) < FEWEST:
        raise SceneError(f"{film.path.name}: {message or 'only'} {len(straight)} frames; allowed: at least {FEWEST}")
    flat = _plane(straight, plane, lens, board, square, scale, distance)
    metres = flat.to_metres(straight)
    if level:
        metres = _levelled(metres)
    t = (offset + np.arange(len(straight))) / film.fps
    scatter = place_errors(t, straight, error, seen)
    # errors of places in the units of `metres`: the local scale is that of the links
    local = np.linalg.norm(np.diff(metres, axis=1), axis=-1) / np.linalg.norm(np.diff(straight, axis=1), axis=-1)
    trace = to_trace(film.path.stem, t, metres, scatter * np.median(local), seen)
    taken = span[0] + offset + len(straight)
    if not message and end is None and taken < COMPLETE * film.announced:
        message = f"the video breaks off after {t[-1]:.3g} s of {film.announced / film.fps:.3g} s"
    tracked = Tracked(
        trace=trace,
        pixels=straight if lens is None else lens.bend(straight.reshape(-1, 2)).reshape(straight.shape),
        metres=metres - metres[0, 0],
        seen=seen,
        look=look,
        lens=lens,
        scaled=not (plane is None and scale is None and distance is None),
        first_frame=span[0] + offset,
        fps=film.fps,
        status="not_converged" if message else "ok",
        message=message,
        warnings=_warnings(film, metres, seen, offset),
    )
    say(1.0, tracked.status)
    return tracked


def _span(film: Video, begin: float, end: float | None) -> tuple[int, int | None]:
    if begin < 0 or (end is not None and end <= begin):
        raise SceneError(f"--begin, --end: {begin:g} to {end} s; allowed: 0 <= begin < end")
    if film.announced and begin * film.fps >= film.announced:
        raise SceneError(f"--begin: {begin:g} s is after the end; allowed: below {film.announced / film.fps:.3g} s")
    return round(begin * film.fps), None if end is None else round(end * film.fps)


def _follow(
    film: Video, span: tuple[int, int | None], look: Look, chain: Chain, lens: Lens | None, say: Progress
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Straight places (k, n, 2), their fit errors, seen (k, n), and why it ended early, if it did."""
    follower, places, errors, seen = Follower(chain), [], [], []
    total = (span[1] or film.announced or 0) - span[0]
    for i, image in enumerate(film.frames(*span)):
        guess = follower.expected()
        circles = detect(image, look, guess if lens is None else lens.bend(guess))
        if lens is not None:
            circles = replace(circles, centre=lens.straighten(circles.centre))
        found = follower.advance(circles)
        places.append(follower.past[0])
        errors.append(np.where(found >= 0, circles.error[found] if len(circles) else np.nan, np.nan))
        seen.append(found >= 0)
        worst = int(np.argmax(follower.lost))
        if follower.lost[worst] > LONGEST_GAP * film.fps:
            kept = i + 1 - int(follower.lost[worst])
            why = f"marker {worst} is lost after {kept / film.fps:.3g} s;"
            return np.array(places[:kept]).reshape(kept, -1, 2), np.array(errors[:kept]), np.array(seen[:kept]), why
        if total > 0:
            say(0.99 * min(1.0, (i + 1) / total), f"frame {span[0] + i + 1}")
    return np.array(places), np.array(errors), np.array(seen), ""


def _plane(
    straight: np.ndarray,
    picture: str | Path | None,
    lens: Lens | None,
    board: tuple[int, int],
    square: float | None,
    scale: float | None,
    distance: float | None,
) -> Plane:
    if picture is not None:
        return plane_from_board(picture, lens, board, square)
    if distance is not None:
        scale = distance / float(np.median(np.linalg.norm(straight[:, -1] - straight[:, 0], axis=1)))
    return plane_from_scale(1.0 if scale is None else scale)


def _levelled(metres: np.ndarray) -> np.ndarray:
    """The places turned so that the mean line from the first to the last node is level."""
    span = np.mean(metres[:, -1] - metres[:, 0], axis=0)
    if not np.hypot(*span) > 0:
        return metres
    c, s = span / np.hypot(*span)
    # nearest level direction: the chain may run from right to left
    c, s = (c, s) if c > 0 else (-c, -s)
    return metres @ np.array([[c, -s], [s, c]])


def _longest_gaps(seen: np.ndarray) -> np.ndarray:
    """Longest run of frames in which each node is not seen (n,)."""
    run = longest = np.zeros(seen.shape[1], int)
    for row in seen:
        run = np.where(row, 0, run + 1)
        longest = np.maximum(longest, run)
    return longest


def _warnings(film: Video, metres: np.ndarray, seen: np.ndarray, offset: int) -> tuple[str, ...]:
    found = []
    if offset:
        found.append(f"{film.path.name}: not all markers show before frame {offset}; the trace begins there")
    length = np.linalg.norm(np.diff(metres, axis=1), axis=-1)
    length = np.where(seen[:, 1:] & seen[:, :-1], length, np.nan)
    change = np.nanstd(length, axis=0) / np.nanmean(length, axis=0)
    if np.nanmax(change) > LENGTH_WARNING:
        worst, size = int(np.nanargmax(change)) + 1, 100 * float(np.nanmax(change))
        found.append(
            f"{film.path.name}: link {worst} changes its length by {size:.2g} %: motion out of the plane, "
            "a slanting camera (--plane) or an uncalibrated lens (--calibration)"
        )
    for node in np.flatnonzero((~seen).any(axis=0)):
        found.append(
            f"{film.path.name}: marker {node} not seen in {(~seen[:, node]).sum()} frames, bridged and left empty"
        )
    return tuple(found)
