"""From a video to angle traces: the complete pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from fitting.films.appearance import scan
from fitting.films.calibration import Lens, calibrate, plane_from_board
from fitting.films.chain_check import LARGEST_ERROR
from fitting.films.detection import Circles
from fitting.films.exposure import remove_blur
from fitting.films.flat_map import Flat
from fitting.films.flattening import level_error
from fitting.films.following import follow_film
from fitting.films.lengths import detected_links
from fitting.films.link_angles import to_trace
from fitting.films.marks import find_marks
from fitting.films.missed_circles import detect_again
from fitting.films.ordering import AmbiguousOrderError
from fitting.films.out_of_plane import changing_lengths
from fitting.films.scaled_chain import chain_angle_errors, level_positions, scale_positions
from fitting.films.track_options import check_first, check_options, check_positive, frame_span
from fitting.films.tracked import Tracked
from fitting.films.tracked_chain import TrackedChain
from fitting.films.tracking_warnings import LONGEST_GAP, tracking_status, tracking_warnings
from fitting.films.video import Video
from fitting.traces.trace import FEWEST_SAMPLES

#: Fraction of the announced frames below which a film breaks off: files announce a few too many.
COMPLETE_FILM = 0.95


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
    check_options(nodes, start, plane, square, scale, distance)
    check_positive({"square": square, "scale": scale, "distance": distance, "radius": radius, "fps": fps})
    check_first(first)
    say = progress or silent
    film = Video(video, fps)
    lens = _lens(film, calibration, board)

    def map_by(lens: Lens | None) -> Flat:
        """The map by a lens, and by the picture of a board in the plane of motion as this lens shows it."""
        if plane is None or square is None:
            return Flat(film.size, lens)
        return Flat(film.size, lens, plane_from_board(plane, film.size, lens, board, square))

    span = frame_span(film, begin, end)
    say(0.0, "looking for markers")
    appearance, circles = scan(film, span, nodes, radius, bright, say)
    say(0.75, "finding the order of the nodes")
    chain = _follow_nodes(film, span[0], circles, nodes, appearance.radius, map_by(lens), first, start)
    detect_again(chain, film.frames(*span), appearance)
    chain, offset, ending = _trim_frames(remove_blur(chain), film)
    t = (offset + np.arange(len(chain.detected))) / film.fps
    if not ending and end is None and span[0] + len(circles) < COMPLETE_FILM * film.announced:
        ending = f"the video breaks off after {t[-1]:.3g} s of {film.announced / film.fps:.3g} s"
    metres = scale_positions(chain, scale, distance)
    row_error = 0.0
    if level:
        metres = level_positions(metres)
    elif lens is not None:  # the rows of the picture are as level as the lens is known
        others = [replace(map_by(other), parameters=chain.map.parameters) for other in lens.others]
        row_error = level_error(chain.map, others, chain.where_detected(chain.pixels))
    marks = find_marks(chain.flat, chain.detected)
    error = np.where(marks.links, np.nan, chain_angle_errors(chain, ~marks.links, row_error))
    certain = error <= LARGEST_ERROR
    depth = changing_lengths(chain.flat, certain)
    status, message = tracking_status(film, chain, marks, error, ending)
    tracked = Tracked(
        trace=replace(to_trace(film.path.stem, t, metres, error, certain), warnings=depth),
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
        warnings=tracking_warnings(film, chain, marks, depth, t, offset, int((error > LARGEST_ERROR).sum())),
        marks=marks,
        slant=_slant(chain.map),
        exposure=chain.exposure / film.fps,
    )
    say(1.0, status)
    return tracked


def _follow_nodes(
    film: Video,
    first_frame: int,
    circles: list[Circles],
    nodes: int,
    radius: float,
    flat: Flat,
    first: str,
    start: Sequence[tuple[float, float]] | None,
) -> TrackedChain:
    """`follow_film`; an error names the film and counts its frames."""
    try:
        return follow_film(circles, nodes, radius, film.fps, flat, first, start)
    except AmbiguousOrderError as error:
        raise AmbiguousOrderError(f"{film.path.name}: {error}", error.orders, error.frame + first_frame) from None


def _lens(film: Video, calibration: Sequence[str | Path], board: tuple[int, int]) -> Lens | None:
    """The lens from pictures of a board, None without any."""
    if not calibration:
        return None
    lens = calibrate(calibration, board)
    if lens.size != film.size:
        raise SceneError(f"calibration: pictures of {lens.size} pixels; allowed: {film.size}, those of the video")
    return lens


def _slant(flat: Flat) -> tuple[float, float] | None:
    """Pan and pitch of the camera [rad] found from the motion; None with a board in the plane."""
    if flat.plane is not None or flat.parameters is None:
        return None
    pan, pitch, *_ = flat.parameters.tolist()
    return pan, pitch


def _trim_frames(chain: TrackedChain, film: Video) -> tuple[TrackedChain, int, str]:
    """The frames from the first to the last with a link, the first one's number, and the reason of an early end.

    Raises:
        SceneError: too few frames.
    """
    detected = chain.detected
    some = detected_links(detected).any(axis=1)
    first = int(np.argmax(some))
    last = len(detected) if some.any() else 0
    # frames up to the last one that shows each node; all of them for one that no frame shows
    until = len(detected) - np.argmax(detected[::-1], axis=0)
    lost = np.flatnonzero((len(detected) - until > LONGEST_GAP * film.fps) | ~detected.any(axis=0))
    why = ""
    if len(lost):
        worst = lost[np.argmin(until[lost])]
        last = int(until[worst]) if detected[:, worst].any() else first
        why = f"marker {worst} is lost after {last / film.fps:.3g} s;"
    if last - first < FEWEST_SAMPLES:
        frames = max(last - first, 0)
        raise SceneError(f"{film.path.name}: {why or 'only'} {frames} frames; allowed: at least {FEWEST_SAMPLES}")
    return chain.pick(frames=slice(first, last)), first, why
