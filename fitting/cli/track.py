"""`dropper track VIDEO --nodes N`: angle traces from a video of marked nodes."""

from __future__ import annotations

import io
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import cells
from dropper_jax.cli.given import number, output_file, positive, read_numbers
from dropper_jax.cli.options import add_examples, add_json, add_quiet
from dropper_jax.cli.outputs import add_file
from dropper_jax.cli.printing import listing, print_result, print_warnings, progress

if TYPE_CHECKING:
    from fitting.films.ordering import AmbiguousOrderError
    from fitting.films.tracked import Tracked

#: Whether markers are brighter than their rim, by `--marker`.
BRIGHT = {"bright": True, "dark": False}

help = "angle traces from a video of a chain with a circle on every node"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "track my-video.mp4 --nodes 8 --overlay check.png --out traces.csv",
        "track my-video.mp4 --nodes 8 --calibration board-*.jpg --plane plane.jpg --square 0.025",
    )
    parser.add_argument("video", metavar="VIDEO", help="a format that OpenCV reads: MP4, AVI, MOV, ...")
    parser.add_argument(
        "--nodes", type=int, required=True, metavar="N", help="markers, both ends included: 8 for a chain of 7 links"
    )
    add_file(parser, "--out", (".csv",), "angles for `dropper fit` (default: VIDEO's name)", "FILE.csv")
    about = "also write the nodes' positions and whether they were detected"
    add_file(parser, "--positions", (".csv",), about, "FILE.csv")
    about = "contact sheet (.png) or video (.mp4, .avi) to check by eye"
    add_file(parser, "--overlay", (".png", ".avi", ".mp4"), about)
    lens = parser.add_argument_group("lens and scale")
    lens.add_argument("--calibration", nargs="+", default=[], metavar="IMAGE", help="pictures of a chessboard")
    lens.add_argument("--board", default="9x6", metavar="CxR", help="its inner corners (default: 9x6)")
    lens.add_argument("--plane", metavar="IMAGE", help="picture of the board in the plane of motion, with --square")
    lens.add_argument("--square", type=positive("m"), metavar="M", help="side of the board's squares [m]")
    lens.add_argument("--scale", type=positive("m"), metavar="M", help="metres per pixel")
    lens.add_argument("--distance", type=positive("m"), metavar="M", help="distance of the first and last marker [m]")
    lens.add_argument("--level", action="store_true", help="first and last marker are at the same height")
    look = parser.add_argument_group("markers")
    look.add_argument("--radius", type=positive("px"), metavar="PX", help="of the circles [pixel] (default: found)")
    look.add_argument("--marker", choices=("bright", "dark"), help="circles relative to their rim (default: found)")
    look.add_argument("--first", choices=("auto", "left", "right", "top"), default="auto", help="which end is node 0")
    look.add_argument(
        "--start",
        nargs="+",
        metavar="X,Y",
        help="positions of all nodes in the first frame [pixel], in order",
    )
    parser.add_argument("--fps", type=positive("Hz"), help="frames per second, if those of the file are wrong")
    parser.add_argument(
        "--from", dest="begin", type=number, default=0.0, metavar="T", help="use the video from here [s]"
    )
    parser.add_argument("--until", dest="end", type=number, metavar="T", help="use the video up to here [s]")
    add_quiet(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    out = args.out or output_file(f"{Path(args.video).stem}.csv", "--out", (".csv",))

    from fitting.films.ordering import AmbiguousOrderError
    from fitting.films.track import track

    try:
        tracked = track(
            args.video,
            args.nodes,
            calibration=args.calibration,
            board=board_size(args.board),
            square=args.square,
            plane=args.plane,
            scale=args.scale,
            distance=args.distance,
            level=args.level,
            radius=args.radius,
            bright=BRIGHT.get(args.marker),
            first=args.first,
            start=start_positions(args.start),
            fps=args.fps,
            begin=args.begin,
            end=args.end,
            progress=progress(args.quiet),
        )
    except AmbiguousOrderError as error:
        return report_ambiguous(error, args, out.with_name(f"{out.stem}-orders.png"))
    return report(tracked, args, out)


def report(tracked: Tracked, args: Namespace, out: Path) -> int:
    """Write and print what was tracked; a film that was lost has no trace."""
    from fitting.films.overlay import write_overlay
    from fitting.traces.trace_file import write_trace

    found = {**tracked.to_json(), "out": None}
    message = tracked.message
    if tracked.status != "lost":
        print_warnings(tracked.warnings)
        write_trace(out, tracked.trace, notes(tracked))
        if args.positions:
            write_positions(tracked, args.positions)
        found["out"] = str(out)
        message += f"; the earlier part is in {out}"
    if args.overlay:
        write_overlay(tracked, args.video, args.overlay)
    failure = None if tracked.status == "ok" else (tracked.status, message)
    return print_result(args, found, text(tracked, out), failure)


def start_positions(nodes: list[str] | None) -> list[tuple[float, float]] | None:
    """Positions [pixel] of nodes given as `X,Y`."""
    if nodes is None:
        return None
    found = []
    for node in nodes:
        x, y = read_numbers(node, "--start", "is not X,Y; allowed: pixels such as 120,85", count=2)
        found.append((x, y))
    return found


def report_ambiguous(error: AmbiguousOrderError, args: Namespace, picture: Path) -> int:
    """Draw the orders that are compatible with the film; no trace is written."""
    from fitting.films.alternatives import MAX_SHOWN, write_alternatives

    write_alternatives(error, args.video, picture)
    shown = f"the first {MAX_SHOWN}" if len(error.orders) > MAX_SHOWN else "they"
    failure = ("ambiguous_order", f"{error}; {shown} are drawn in {picture}")
    orders = [positions.round(1) for positions in error.orders]
    found = {"frame": error.frame, "orders": orders, "picture": str(picture)}
    return print_result(args, found, f"ambiguous_order: see {picture}", failure)


def notes(tracked: Tracked) -> list[str]:
    """Marked frames, as comments of the trace."""
    found = []
    for span in tracked.marks.spans(tracked.trace.t):
        nodes = " ".join(map(str, span["nodes"]))
        found.append(f"marked {span['from_s']:.9g} to {span['to_s']:.9g} s: nodes {nodes} ({' '.join(span['why'])})")
    return found


def board_size(text: str) -> tuple[int, int]:
    """Columns and rows of `9x6`."""
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal() and min(int(columns), int(rows)) >= 3):
        raise SceneError(f"--board: {text!r} is not COLUMNSxROWS; allowed: inner corners such as 9x6, at least 3")
    return int(columns), int(rows)


def write_positions(tracked: Tracked, path: Path) -> Path:
    """Time, positions and whether each node was detected: t, x_0, z_0, seen_0, ...; other positions are bridged.

    The last column shows whether the frame is marked: nodes swapped, jumped or violated the lengths of their links.
    """
    import numpy as np

    from dropper_jax.base.files import atomic_write

    times = tracked.trace.t
    nodes = tracked.detected.shape[1]
    names = [f"{stem}_{k}" for k in range(nodes) for stem in ("x", "z", "seen")]
    values = np.dstack([tracked.metres, tracked.detected]).reshape(len(times), -1)
    text = io.StringIO()
    unit = "m" if tracked.scaled else "pixel"
    text.write(f"# unit={unit}, x=right, z=up, zero=node 0 in the first frame\n")
    text.write(",".join(["t", *names, "marked"]) + "\n")
    rows = np.column_stack([times, values, tracked.marks.frames])
    np.savetxt(text, rows, fmt=["%.9g", *["%.7g", "%.7g", "%d"] * nodes, "%d"], delimiter=",")
    return atomic_write(path, text.getvalue())


def text(tracked: Tracked, out: Path) -> str:
    """The result as text."""
    found = tracked.to_json()
    bridged = sum(found["bridged"])
    not_detected = "none"
    if bridged:
        not_detected = f"{bridged} samples, longest gap {found['longest_gap_s']:.2g} s"
    marked = f"{found['marked_frames']}, left empty" if found["marked_frames"] else "none"
    seconds = tracked.trace.t[-1] - tracked.trace.t[0]
    pairs = [
        ("frames", f"{found['frames']} at {found['fps']:g} Hz, {seconds:.3g} s"),
        ("markers", "{nodes} of radius {marker_radius_pixel:.3g} pixel, {links} links".format_map(found)),
        ("not detected", not_detected),
        ("marked frames", marked),
    ]
    if found["angle_se_rad"] is not None:
        pairs.append(("angles", f"standard error {found['angle_se_rad']:.2g} rad (median)"))
    if tracked.lens is not None:
        pairs.insert(0, ("lens", f"{tracked.lens.pictures} pictures, error {tracked.lens.error:.2g} pixel"))
    if tracked.scaled:
        pairs.append(("links", ", ".join(cells(found["link_length_m"], ".4f")) + " m"))
    outcome = "no angles are written" if tracked.status == "lost" else f"angles in {out}"
    return "\n".join([listing(pairs), "", f"{found['status']}: {outcome}"])
