"""From a video to angle traces: the complete pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from fitting.films.appearance import scan
from fitting.films.calibration import Lens, calibrate, plane_from_board
from fitting.films.chain_check import LARGEST_ERROR, why_no_chain
from fitting.films.detection import MarkerAppearance
from fitting.films.exposure import remove_blur
from fitting.films.flattening import Flat, central_differences, detected_links, level_error
from fitting.films.following import follow_film
from fitting.films.link_angles import estimate_angle_errors, four_quadrant, to_trace
from fitting.films.marks import Marks, find_marks
from fitting.films.missed_circles import detect_again
from fitting.films.ordering import AmbiguousOrderError
from fitting.films.out_of_plane import changing_lengths, length_statistics
from fitting.films.tracked_chain import TrackedChain
from fitting.films.video import Video
from fitting.traces.trace import FEWEST_SAMPLES, Trace

#: A marker not detected for longer [s] at the end is lost; one that reappears may have turned round unseen.
LONGEST_GAP = 0.5
#: Meaning of the marks.
WORDS = {"swapped": "swapped", "jumped": "jumped", "length": "off the lengths of their links"}
#: Fraction of the announced frames below which a film breaks off: files announce a few too many.
COMPLETE_FILM = 0.95


@dataclass(frozen=True)
class Tracked:
    """Result of tracking a video.

    Attributes:
        trace: angles [rad] and standard errors, empty if a marker was not detected or a frame is marked.
        pixels: (k, n, 2) positions in the video's own pixels, bridged if not detected.
        metres: (k, n, 2) right and up of the first frame's node 0 [m]; pixels if no scale was given.
        detected: (k, n).
        appearance, lens, scaled: appearance of a marker, the lens or None, whether metres are metres.
        first_frame: of the video, that of the trace's first sample.
        fps [1/s]; status: `ok`, `not_converged` (the trace ends early) or `lost` (the circles do not move as the nodes
            of a chain), with the reason in `message`.
        marks: frames in which nodes swapped, jumped, or violated their links' lengths.
        slant: pan and pitch of the camera [rad] found from the motion, or None with a board in the plane.
        exposure: [s] estimated from the lengths of turning links; its effect is corrected. 0 if it is too short.
    """

    trace: Trace
    pixels: np.ndarray
    metres: np.ndarray
    detected: np.ndarray
    appearance: MarkerAppearance
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

    @property
    def link_lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n - 1,) of the links' measured lengths."""
        return length_statistics(self.metres, detected_links(self.detected) & ~self.marks.links)

    def to_json(self) -> dict[str, Any]:
        """The result without its samples."""
        mean, deviation = self.link_lengths
        angle_se_rad = None
        if self.trace.se is not None and np.isfinite(self.trace.se).any():
            angle_se_rad = float(np.nanmedian(self.trace.se))
        found = {
            "schema": 1,
            "status": self.status,
            "frames": len(self.detected),
            "fps": self.fps,
            "nodes": self.detected.shape[1],
            "links": self.detected.shape[1] - 1,
            "bridged": (~self.detected).sum(axis=0).tolist(),
            "longest_gap_s": float(_longest_gaps(self.detected).max() / self.fps),
            "angle_se_rad": angle_se_rad,
            "marker_radius_pixel": self.appearance.radius,
            "link_length_m": None,
            "link_length_deviation": (deviation / mean).tolist(),
            "marked": self.marks.spans(self.trace.t),
            "marked_frames": int(self.marks.frames.sum()),
            "slant_rad": self.slant,
            "exposure_s": self.exposure,
            "reprojection_error_pixel": None,
            "warnings": list(self.warnings),
        }
        if self.scaled:
            found["link_length_m"] = mean.tolist()
        if self.lens is not None:
            found["reprojection_error_pixel"] = self.lens.error
        if self.status != "ok":
            found["error"] = self.message
        return found


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
        level: the first and last marker are at the same height; otherwise the picture's rows are level.
        radius [pixel], bright: of the markers; default: those that stand out most.
        first: end of the chain with node 0: auto (the only end at rest, otherwise the left one), left, right, top.
        start: positions (nodes, 2) [pixel] in the first frame, in order, including hidden markers; default: found from
            constant distances.
        fps: frames per second if the file is wrong, as for high-speed cameras.
        begin, end: [s] of the video to use; t = 0 is `begin`.

    Raises:
        SceneError: for any invalid input, in one line.
        AmbiguousOrderError: the film allows several orders of the nodes.
    """
    _check_options(nodes, start, plane, square, scale, distance)
    say = progress or silent
    film = Video(video, fps)
    lens = None
    if calibration:
        lens = calibrate(calibration, board)
        if lens.size != film.size:
            raise SceneError(f"calibration: pictures of {lens.size} pixels; allowed: {film.size}, those of the video")
    map_by = partial(_map_by_lens, film.size, plane, board, square)
    span = _span(film, begin, end)
    say(0.0, "looking for markers")
    appearance, circles = scan(film, span, nodes, radius, bright, say)
    say(0.75, "finding the order of the nodes")
    try:
        chain = follow_film(circles, nodes, appearance.radius, film.fps, map_by(lens), first, start)
    except AmbiguousOrderError as error:
        raise AmbiguousOrderError(f"{film.path.name}: {error}", error.orders, error.frame + span[0]) from None
    detect_again(chain, film.frames(*span), appearance)
    chain, offset, message = _trim_frames(remove_blur(chain), film.fps)
    frames = len(chain.detected)
    if frames < FEWEST_SAMPLES:
        raise SceneError(f"{film.path.name}: {message or 'only'} {frames} frames; allowed: at least {FEWEST_SAMPLES}")
    t = (offset + np.arange(frames)) / film.fps
    if not message and end is None and span[0] + len(circles) < COMPLETE_FILM * film.announced:
        message = f"the video breaks off after {t[-1]:.3g} s of {film.announced / film.fps:.3g} s"
    metres = _metres(chain, scale, distance)
    row_error = 0.0
    if level:
        metres = _level_chain(metres)
    elif lens is not None:  # the rows of the picture are as level as the lens is known
        others = [replace(map_by(other), parameters=chain.map.parameters) for other in lens.others]
        row_error = level_error(chain.map, others, chain.where_detected(chain.pixels))
    marks = find_marks(chain.flat, chain.detected)
    error = np.where(marks.links, np.nan, _angle_errors(chain, ~marks.links, row_error))
    certain = error <= LARGEST_ERROR
    trace = to_trace(film.path.stem, t, metres, error, certain)
    trace = replace(trace, warnings=changing_lengths(chain.flat, certain))
    status, message = _status(film, chain, marks, error, message)
    slant = None
    if plane is None and chain.map.parameters is not None:
        slant = (float(chain.map.parameters[0]), float(chain.map.parameters[1]))
    tracked = Tracked(
        trace=trace,
        pixels=chain.pixels,
        metres=metres - metres[0, 0],
        detected=chain.detected,
        appearance=appearance,
        lens=lens,
        scaled=not (plane is None and scale is None and distance is None),
        first_frame=span[0] + offset,
        fps=film.fps,
        status=status,
        message=message,
        warnings=_warnings(film, chain, marks, trace.warnings, t, offset, int((error > LARGEST_ERROR).sum())),
        marks=marks,
        slant=slant,
        exposure=chain.exposure / film.fps,
    )
    say(1.0, tracked.status)
    return tracked


def _check_options(
    nodes: int,
    start: Sequence[tuple[float, float]] | None,
    plane: str | Path | None,
    square: float | None,
    scale: float | None,
    distance: float | None,
) -> None:
    """Reject options of `track` that are out of range or exclude one another."""
    if nodes < 2:
        raise SceneError(f"--nodes: {nodes} is too few; allowed: at least 2, both ends of the chain included")
    if sum(x is not None for x in (plane, scale, distance)) > 1:
        raise SceneError("track: more than one of --plane, --scale, --distance; allowed: one of them")
    if plane is not None and square is None:
        raise SceneError("--square: missing; needed: the side of the board's squares in m, because --plane is given")
    if start is not None and np.shape(start) != (nodes, 2):
        raise SceneError(f"--start: {len(start)} positions; allowed: {nodes}, one x,y per node")


def _map_by_lens(
    size: tuple[int, int],
    picture: str | Path | None,
    board: tuple[int, int],
    square: float | None,
    lens: Lens | None,
) -> Flat:
    """The map by a lens, and by the `picture` of a board in the plane of motion as a camera with this lens sees it."""
    if picture is None or square is None:
        return Flat(size, lens)
    return Flat(size, lens, plane_from_board(picture, size, lens, board, square))


def _span(film: Video, begin: float, end: float | None) -> tuple[int, int | None]:
    """The first frame, and the one after the last, None for all, of a film from `begin` to `end` [s]."""
    if begin < 0 or (end is not None and end <= begin):
        raise SceneError(f"--from, --until: {begin:g} to {end} s; allowed: 0 <= from < until")
    if film.announced and begin * film.fps >= film.announced:
        raise SceneError(f"--from: {begin:g} s is after the end; allowed: below {film.announced / film.fps:.3g} s")
    first = round(begin * film.fps)
    if end is None:
        return first, None
    last = round(end * film.fps)
    if last <= first:
        raise SceneError(
            f"--from, --until: no frame is between {begin:g} and {end:g} s; allowed: 1/{film.fps:g} s or more"
        )
    return first, last


def _trim_frames(chain: TrackedChain, fps: float) -> tuple[TrackedChain, int, str]:
    """The frames from the first to the last with a link, the first one's number, and the reason of an early end."""
    detected = chain.detected
    some = detected_links(detected).any(axis=1)
    first = int(np.argmax(some))
    last = len(detected) if some.any() else 0
    # frames up to the last one that shows each node; all of them for one that no frame shows
    until = len(detected) - np.argmax(detected[::-1], axis=0)
    lost = np.flatnonzero((len(detected) - until > LONGEST_GAP * fps) | ~detected.any(axis=0))
    why = ""
    if len(lost):
        worst = int(lost[np.argmin(until[lost])])
        last = int(until[worst]) if detected[:, worst].any() else first
        why = f"marker {worst} is lost after {last / fps:.3g} s;"
    return chain.pick(frames=slice(first, max(first, last))), first, why


def _status(film: Video, chain: TrackedChain, marks: Marks, error: np.ndarray, ending: str) -> tuple[str, str]:
    """Status of a result and its reason.

    Args:
        error: of the angles (k, n - 1) [rad].
        ending: why the trace ends early; empty if it does not.
    """
    lost = why_no_chain(chain.where_detected(chain.flat), marks, error)
    if lost:
        return "lost", (
            f"{film.path.name}: the circles do not move as the nodes of a chain: {lost}; needed: a marker on each of "
            f"{chain.detected.shape[1]} nodes (--overlay shows what was followed, --radius and --marker describe the "
            "markers)"
        )
    if ending:
        return "not_converged", ending
    return "ok", ""


def _metres(chain: TrackedChain, scale: float | None, distance: float | None) -> np.ndarray:
    """Positions (k, n, 2), right and up, in m if a scale is known, otherwise in pixels."""
    flat = chain.flat * [1.0, -1.0]
    if chain.map.plane is not None:
        scale = chain.map.plane.metres_per_pixel(chain.map.middle)
    if distance is not None:
        scale = distance / float(np.median(np.linalg.norm(flat[:, -1] - flat[:, 0], axis=1)))
    if scale is None:
        return flat
    return flat * scale


def _angle_errors(chain: TrackedChain, used: np.ndarray, level: float) -> np.ndarray:
    """Standard errors (k, n - 1) [rad]: scatter, and the uncertainty of `level` and of the map to the plane."""
    scatter = estimate_angle_errors(chain.where_detected(chain.flat), chain.error, used)
    found = np.hypot(scatter, level)
    flat = chain.map
    if flat.parameters is None or flat.covariance is None:
        return found

    def angles(parameters: np.ndarray) -> np.ndarray:
        return four_quadrant(replace(flat, parameters=parameters)(chain.pixels))

    jacobian = central_differences(angles, flat.parameters, 1e-4)
    return np.sqrt(found**2 + np.einsum("kja,ab,kjb->kj", jacobian, flat.covariance, jacobian))


def _level_chain(metres: np.ndarray) -> np.ndarray:
    """The positions rotated so that the mean line from the first to the last node is level."""
    span = np.mean(metres[:, -1] - metres[:, 0], axis=0)
    if not np.hypot(*span) > 0:
        return metres
    # nearest level direction: the chain may run from right to left
    c, s = np.copysign(1.0, span[0]) * span / np.hypot(*span)
    return metres @ np.array([[c, -s], [s, c]])


def _longest_gaps(detected: np.ndarray) -> np.ndarray:
    """Longest run of frames without a detection of each node (n,)."""
    seen = np.pad(detected, ((1, 1), (0, 0)), constant_values=True)
    return np.array([np.diff(np.flatnonzero(column)).max() - 1 for column in seen.T])


def _warnings(
    film: Video,
    chain: TrackedChain,
    marks: Marks,
    depth: tuple[str, ...],
    t: np.ndarray,
    offset: int,
    uncertain: int,
) -> tuple[str, ...]:
    """Lines on what the trace lacks and why.

    Args:
        depth: lines on motion out of the plane.
        t: times of the trace [s], which starts at frame `offset`.
        uncertain: number of angles that are left empty because of their errors.
    """
    detected = chain.detected
    found = []
    if offset:
        found.append(f"no link is visible before frame {offset}; the trace starts there")
    if chain.straight:
        found.append("no joint bends; the nodes are ordered as they lie on a line")
    found += depth
    if uncertain:
        found.append(f"{uncertain} angles with standard errors above {LARGEST_ERROR:g} rad left empty")
    gaps = _longest_gaps(detected) / film.fps
    for node in np.flatnonzero((~detected).any(axis=0)):
        long = ""
        if gaps[node] > LONGEST_GAP:
            long = f"; the longest gap is {gaps[node]:.2g} s, turns in it are not counted"
        found.append(f"marker {node} not seen in {(~detected[:, node]).sum()} frames, bridged and left empty{long}")
    for span in marks.spans(t):
        when = " to ".join(dict.fromkeys(f"{span[key]:.4g}" for key in ("from_s", "to_s")))
        nodes = ", ".join(map(str, span["nodes"]))
        why = " and ".join(WORDS[word] for word in span["why"])
        found.append(f"{when} s: nodes {nodes} {why}; marked and left empty")
    return tuple(f"{film.path.name}: {line}" for line in found)
