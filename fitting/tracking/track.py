"""From a video to angle traces: everything in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.renamed import old_attribute
from fitting.traces.trace import FEWEST, Trace
from fitting.tracking.angles import four_quadrant, scatter, to_trace
from fitting.tracking.calibration import Lens, calibrate, plane_from_board
from fitting.tracking.depth import changing_lengths
from fitting.tracking.detection import Circles, Look, detect_at
from fitting.tracking.flattening import Flat, level_error
from fitting.tracking.following import follow_film
from fitting.tracking.hindsight import Followed, look_again, unblurred
from fitting.tracking.learning import scan
from fitting.tracking.marks import Marks, find_marks
from fitting.tracking.ordering import AmbiguousOrderError
from fitting.tracking.video import COMPLETE, Video

#: A marker that is not seen for longer [s] at the end is lost; one that comes back may have turned round unseen.
LONGEST_GAP = 0.5
#: What marks mean.
WORDS = {"swapped": "swapped", "jumped": "jumped", "length": "off the lengths of their links"}


@dataclass(frozen=True)
class Tracked:
    """What a video holds.

    Attributes:
        trace: angles [rad] and standard errors, empty where a marker was not seen or a frame is marked.
        pixels: (k, n, 2) places in the video's own pixels, bridged where not seen.
        metres: (k, n, 2) right and up of the first frame's node 0 [m]; pixels where no scale was given.
        seen: (k, n).
        look, lens, scaled: what a marker looks like, the lens or None, whether metres are metres.
        first_frame: of the video, that of the trace's first sample.
        fps [1/s]; status: `ok` or `not_converged`, with the reason in `message`.
        marks: frames in which nodes swapped, jumped, or left their links' lengths.
        slant: pan and pitch of the camera [rad] found from the motion, or None where a board told the plane.
        exposure: [s] that the lengths of turning links show, whose effect is taken back; 0 where too short to show.
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
    marks: Marks
    slant: tuple[float, float] | None = None
    exposure: float = 0.0

    __getattr__ = old_attribute

    @property
    def link_lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n - 1,) of the links' measured lengths."""
        length = np.linalg.norm(np.diff(self.metres, axis=1), axis=-1)
        length = np.where(self.seen[:, 1:] & self.seen[:, :-1] & ~self.marks.links, length, np.nan)
        known = [column[np.isfinite(column)] for column in length.T]
        return tuple(np.array([f(c) if len(c) else np.nan for c in known]) for f in (np.mean, np.std))

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
            "marked": self.marks.spans(self.trace.t),
            "marked_frames": int(self.marks.frames.sum()),
            "slant_rad": None if self.slant is None else list(self.slant),
            "exposure_s": self.exposure,
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
        start: places (nodes, 2) [pixel] in the first frame, in order, of markers not seen there as well; default: found
            by which distances stay.
        fps: frames per second where the file is wrong, as for high-speed cameras.
        begin, end: [s] of the video to take; t = 0 is `begin`.

    Raises:
        SceneError: for anything the caller can mend, in one line.
        AmbiguousOrderError: the film allows several orders of the nodes.
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
    if start is not None and np.shape(start) != (nodes, 2):
        raise SceneError(f"--start: {len(start)} places; allowed: {nodes}, one x,y per node")
    say(0.0, "looking for markers")
    look, circles = scan(film, span, nodes, radius, bright, say)
    board_plane = None if plane is None else plane_from_board(plane, lens, board, square)
    say(0.75, "finding out which is which")
    try:
        flat = Flat(film.size, lens, board_plane)
        followed = follow_film(circles, nodes, look.radius, film.fps, flat, first, start)
    except AmbiguousOrderError as error:
        raise AmbiguousOrderError(f"{film.path.name}: {error}", error.orders, error.frame + span[0]) from None
    _look_again(film, span, look, followed)
    followed, offset, message = _kept(unblurred(followed), film.fps)
    marks = find_marks(followed.flat, followed.seen)
    size = len(followed.seen)
    if size < FEWEST:
        raise SceneError(f"{film.path.name}: {message or 'only'} {size} frames; allowed: at least {FEWEST}")
    metres = _metres(followed, scale, distance)
    if level:
        metres = _levelled(metres)
    t = (offset + np.arange(size)) / film.fps
    known = followed.seen[:, 1:] & followed.seen[:, :-1] & ~marks.links
    level_unknown = 0.0
    if lens is not None and not level:
        planes = [None if plane is None else plane_from_board(plane, other, board, square) for other in lens.others]
        others = [replace(followed.map, lens=a, plane=b) for a, b in zip(lens.others, planes, strict=True)]
        level_unknown = level_error(followed.map, others, followed.pixels, followed.seen)
    trace = to_trace(film.path.stem, t, metres, _errors(followed, ~marks.links, level_unknown), known)
    trace = replace(trace, warnings=changing_lengths(followed.flat, known))
    if not message and end is None and span[0] + len(circles) < COMPLETE * film.announced:
        message = f"the video breaks off after {t[-1]:.3g} s of {film.announced / film.fps:.3g} s"
    parameters = followed.map.parameters
    tracked = Tracked(
        trace=trace,
        pixels=followed.pixels,
        metres=metres - metres[0, 0],
        seen=followed.seen,
        look=look,
        lens=lens,
        scaled=not (plane is None and scale is None and distance is None),
        first_frame=span[0] + offset,
        fps=film.fps,
        status="not_converged" if message else "ok",
        message=message,
        warnings=_warnings(film, followed, marks, trace.warnings, t, offset),
        marks=marks,
        slant=None if parameters is None or board_plane is not None else (float(parameters[0]), float(parameters[1])),
        exposure=followed.exposure / film.fps,
    )
    say(1.0, tracked.status)
    return tracked


def _span(film: Video, begin: float, end: float | None) -> tuple[int, int | None]:
    if begin < 0 or (end is not None and end <= begin):
        raise SceneError(f"--begin, --end: {begin:g} to {end} s; allowed: 0 <= begin < end")
    if film.announced and begin * film.fps >= film.announced:
        raise SceneError(f"--begin: {begin:g} s is after the end; allowed: below {film.announced / film.fps:.3g} s")
    return round(begin * film.fps), None if end is None else round(end * film.fps)


def _look_again(film: Video, span: tuple[int, int | None], look: Look, followed: Followed) -> None:
    """Look in the frames themselves for markers whose circles were not found at first, half hidden ones above all."""
    if followed.seen.all():
        return
    frames = enumerate(film.frames(*span))

    def looked(i: int, guesses: np.ndarray) -> Circles:
        image = next(image for number, image in frames if number == i)
        return detect_at(image, look, guesses)

    look_again(followed, looked)


def _kept(followed: Followed, fps: float) -> tuple[Followed, int, str]:
    """The frames from the first to the last that hold a link, the first one's number, and why it ended early, if so."""
    seen = followed.seen
    some = np.flatnonzero((seen[:, 1:] & seen[:, :-1]).any(axis=1))
    first, last = (int(some[0]), len(seen)) if len(some) else (0, 0)
    until = len(seen) - np.argmax(seen[::-1], axis=0)
    gone = np.flatnonzero((len(seen) - until > LONGEST_GAP * fps) | ~seen.any(axis=0))
    why = ""
    if len(gone):
        worst = int(gone[np.argmin(until[gone])])
        last = int(until[worst]) if seen[:, worst].any() else first
        why = f"marker {worst} is lost after {last / fps:.3g} s;"
    part = slice(first, max(first, last))
    arrays = {name: getattr(followed, name)[part] for name in ("flat", "pixels", "error", "seen")}
    return replace(followed, **arrays), first, why


def _metres(followed: Followed, scale: float | None, distance: float | None) -> np.ndarray:
    """Places (k, n, 2), right and up, in m where a scale is known and pixels where not."""
    flat = followed.flat * [1.0, -1.0]
    if followed.map.plane is not None:
        scale = followed.map.metres_per_pixel()
    if distance is not None:
        scale = distance / float(np.median(np.linalg.norm(flat[:, -1] - flat[:, 0], axis=1)))
    return flat * (1.0 if scale is None else scale)


def _errors(followed: Followed, used: np.ndarray, level: float) -> np.ndarray:
    """Standard errors (k, n - 1) [rad]: scatter, and what `level` and the map to the plane of motion leave open."""
    found = np.hypot(scatter(followed.flat, followed.error, followed.seen, used), level)
    flat = followed.map
    if flat.covariance is None:
        return found
    step = 1e-4
    slopes = []
    for d in step * np.eye(len(flat.parameters)):
        low, high = (four_quadrant(replace(flat, parameters=flat.parameters + s)(followed.pixels)) for s in (-d, d))
        slopes.append((high - low) / (2 * step))
    jacobian = np.stack(slopes, axis=-1)
    return np.sqrt(found**2 + np.einsum("kja,ab,kjb->kj", jacobian, flat.covariance, jacobian))


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


def _warnings(
    film: Video, followed: Followed, marks: Marks, depth: tuple[str, ...], t: np.ndarray, offset: int
) -> tuple[str, ...]:
    name, seen, found = film.path.name, followed.seen, []
    if offset:
        found.append(f"{name}: no link shows before frame {offset}; the trace begins there")
    if followed.straight:
        found.append(f"{name}: no joint bends; the nodes are taken in the order in which they lie on a line")
    found += [f"{name}: {line}" for line in depth]
    gaps = _longest_gaps(seen) / film.fps
    for node in np.flatnonzero((~seen).any(axis=0)):
        long = (
            f"; the longest gap is {gaps[node]:.2g} s, turns in it are not counted" if gaps[node] > LONGEST_GAP else ""
        )
        found.append(f"{name}: marker {node} not seen in {(~seen[:, node]).sum()} frames, bridged and left empty{long}")
    for span in marks.spans(t):
        nodes, why = ", ".join(map(str, span["nodes"])), " and ".join(WORDS[word] for word in span["why"])
        when = (
            f"{span['from_s']:.4g} s"
            if span["from_s"] == span["to_s"]
            else f"{span['from_s']:.4g} to {span['to_s']:.4g} s"
        )
        found.append(f"{name}: {when}: nodes {nodes} {why}; marked and left empty")
    return tuple(found)
