"""`dropper offset SCENE`: restoring force and tension of a mooring over the offset of points."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections import defaultdict

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.cli.given import read_numbers, split_names
from dropper_jax.cli.options import add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import done_object, progress, record_table

help = "restoring force and tension over the horizontal offset of fixed points, all else in equilibrium"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "offset platform-longline --points platform --distance 0:2:0.5",
        "offset edulis-longline --points east-danforth,east-gravity --direction 0:360:30 --distance 0:5:0.5",
    )
    parser.add_argument("--points", required=True, metavar="A,B", help="fixed points that are displaced together")
    parser.add_argument(
        "--direction",
        default="0",
        metavar="LO:HI:STEP",
        help="horizontal directions [deg] from x towards y, or one direction (0)",
    )
    parser.add_argument(
        "--distance", required=True, metavar="LO:HI:STEP", help="distances [m], both ends included, or one distance"
    )
    add_plot(parser, "the curves over the distance")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    directions = _values(args.direction, "--direction")
    distances = _values(args.distance, "--distance")
    if distances[0] < 0.0:
        raise SceneError(f"--distance: {args.distance!r} is below 0; allowed: distances of at least 0 m")
    directions = np.unique(directions % 360.0)
    scene = read_scene(args)

    from dropper_jax.study.offsets import draw_offsets, offset_curves

    points = split_names(args.points)
    rows = offset_curves(scene, points, directions, distances, progress(args.quiet))
    failed = next((row for row in rows if row["status"] != "ok"), None)
    if args.plot:
        draw_offsets(scene.name, rows, picture(args.plot, "offset"))
    failure = None
    if failed is not None:
        text = "{status}: no equilibrium at {distance_m:g} m, {direction_deg:g} deg"
        failure = (failed["status"], text.format(**failed))
    return deliver(args, done_object(scene=scene.name, points=points, rows=rows), _text(rows), failure)


def _values(text: str, option: str) -> np.ndarray:
    """The values of `LO:HI:STEP`, both ends included, or of one number."""
    whole = text if ":" in text else f"{text}:{text}:1"
    reason = "is not LO:HI:STEP. Use for example 0:5:0.5"
    low, high, step = read_numbers(whole, option, reason, ":", 3, given=text)
    if not (np.isfinite([low, high]).all() and low <= high and 0.0 < step < np.inf):
        raise SceneError(f"{option}: {text!r} is an empty range; allowed: LO <= HI, STEP > 0")
    if (high - low) / step >= 10_000:  # a slip of the step would otherwise run for days
        raise SceneError(f"{option}: {text!r} has too many values; allowed: 10000")
    # a step that divides the range up to rounding includes its end
    return low + step * np.arange(int((high - low) / step * (1.0 + 1e-9) + 1e-9) + 1)


COLUMNS = {
    "direction [deg]": "{direction_deg:g}",
    "distance [m]": "{distance_m:g}",
    "restoring [N]": "{restoring_n:.5g}",
    "transverse [N]": "{transverse_n:.5g}",
    "vertical [N]": "{vertical_n:.5g}",
    "tension at points [N]": "{end_tension_n:.5g}",
    "maximum tension [N]": "{max_tension_n:.5g}",
    "in line": "{max_line}",
}


def _text(rows: list[Table]) -> str:
    """A row per direction and distance, without numbers where there is no equilibrium."""
    lines = []
    for row in rows:
        line: Table = defaultdict(lambda: None, row)
        if row["status"] == "ok":
            line["vertical_n"] = row["force_n"][2]
            for key in ("restoring_n", "transverse_n", "vertical_n"):
                line[key] = round(line[key], 6) + 0.0  # adding zero turns -0 into 0
        lines.append(line)
    note = "force of the lines on the displaced points together: against the offset, to the left of it, upwards"
    return f"{record_table(lines, COLUMNS)}\n{note}"
