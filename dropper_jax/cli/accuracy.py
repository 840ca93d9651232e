"""`dropper accuracy SCENE`: run time against accuracy."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import cell, cells
from dropper_jax.base.read import Table
from dropper_jax.cli.given import number
from dropper_jax.cli.options import add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import STOPPED, done_object, print_line, progress, row_printer, table

help = "measure errors and times of all integrators over a range of steps, row by row, and advise"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser, "accuracy dropper-release-a --quick", "accuracy paper-case-1 --dts 0.04 0.02 0.01 --plot accuracy"
    )
    parser.add_argument(
        "--integrators",
        nargs="+",
        metavar="NAME[:GAMMA]",
        help="integrators to compare (default: all that can run the scene)",
    )
    parser.add_argument(
        "--dts",
        nargs="+",
        type=number,
        metavar="S",
        help="equal steps [s] (default: 1/32 to 1/2048; loads by accuracy)",
    )
    parser.add_argument(
        "--span", type=number, help="duration of the comparison [s] (default: until chaos amplifies rounding)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="each scheme once, without retries: errors, times, orders and advice"
    )
    add_plot(parser, "the pictures of errors against time, of orders and of damping")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    for option, values in (("--dts", args.dts or ()), ("--span", () if args.span is None else (args.span,))):
        for value in values:
            if not 0 < value < float("inf"):
                raise SceneError(f"{option}: {value:g} is out of range; allowed: a number > 0 s")
    scene = read_scene(args)

    from dropper_jax.study.accuracy import accuracy
    from dropper_jax.study.march import parse

    schemes = [parse(name) for text in args.integrators or () for name in text.split(",")] or None
    dts = None if args.dts is None else tuple(args.dts)
    say = progress(args.quiet)
    found = accuracy(scene, schemes, dts, args.span, not args.quick, say, _row_printer(args.quiet))
    for item in found["refused"]:
        print_line(f"left out: {item['scheme']}: {item['reason']}")
    failure = None
    if found.get("status") == STOPPED[0]:
        failure = STOPPED
    if args.plot and failure is None:
        draw(found, picture(args.plot, "accuracy"))
    return deliver(args, done_object(**found), text(found), failure)


def _row_printer(quiet: bool) -> Callable[[Table], None]:
    """A function that prints a row of a scheme or of the loads as soon as it is measured."""
    of_schemes = row_printer(HEAD, quiet)
    of_loads = row_printer(("loads", *LOADS_HEAD), quiet)

    def show(row: Table) -> None:
        if "errors" in row:
            of_loads(("", *_load_cells(row)))
        else:
            of_schemes(_cells(row))

    return show


def draw(found: Table, path: Path) -> None:
    """Write the work-precision picture to `path` and the others next to it."""
    from dropper_jax.study import accuracy_pictures

    accuracy_pictures.work_precision(found, path)
    for part, key, function in (
        ("convergence", "convergence", accuracy_pictures.convergence),
        ("damping", "numerical_damping", accuracy_pictures.damping),
    ):
        if found.get(key):
            function(found, path.with_stem(f"{path.stem}-{part}"))


def text(found: Table) -> str:
    """The report as text."""
    parts = [_schemes(found)] if found["reference"] else []
    if "loads" in found:
        parts.append(_loads(found["loads"]))
    if "numerical_damping" in found:
        parts.append(found["numerical_damping"]["thesis"]["text"])
        kept = sum(row["holds"] for row in found["euler"])
        parts.append(f"Euler's schemes on the pendulums: {kept} of {len(found['euler'])} measured claims hold")
    return "\n\n".join(parts)


def _schemes(found: Table) -> str:
    """Errors and times of the schemes, and the advice; of an interrupted comparison the rows so far."""
    reference = found["reference"]
    parts = [
        f"{found['scene']}: compared over {reference['horizon_s']:.4g} s; perturbations grow at "
        f"{reference['lyapunov_per_s']:.3g} 1/s and reach 100 times after {reference['trusted_span_s']:.4g} s",
        f"reference: {reference['made_by']}; its error {reference['error_estimate_rad']:.2g} rad, against "
        f"{reference['checked_by']}",
        table([HEAD, *map(_cells, found["rows"])]),
        "measured orders: " + ", ".join(f"{label} {order:.2f}" for label, order in found["orders"].items()),
        "\n".join(item["text"] for item in found["advice"]),
    ]
    return "\n\n".join(parts)


def _loads(found: Table) -> str:
    """Errors of the loads, and the accuracy or the step below which they are small."""
    if not found["rows"]:
        return f"loads: {found['skipped']}"
    rows = [LOADS_HEAD, *map(_load_cells, found["rows"])]
    finest = found["reference_dt"]
    if finest is None:
        against = "half of each step"
    else:
        against = f"steps of {finest:.4g} s"
    head = f"errors of the loads of the worst line, against {against}:"
    return "\n".join([head, table(rows), *(item["text"] for item in found["advice"])])


LOADS_HEAD = ("accuracy", "dt [s]", "mean", "deviation", "wave maxima", "largest", "us/step", "status")


def _load_cells(row: Table) -> tuple[str, ...]:
    names = ("mean", "deviation", "window_maximum", "maximum")
    return (
        cell(row["accuracy"], ".2g"),
        f"{row['dt']:.4g}",
        *cells((row["errors"][name] for name in names), ".2%"),
        f"{row['us_per_step']:.3g}",
        row["status"],
    )


HEAD = (
    "scheme",
    "solver",
    "dt [s]",
    "angle [rad]",
    "position [m]",
    "tension [N]",
    "drift [J]",
    "us/step",
    "s/s",
    "status",
)


def _cells(row: Table) -> tuple[str, ...]:
    keys = ("rms_angle_error_rad", "rms_position_error_m", "rms_tension_error_n", "energy_drift_j")
    return (
        row["label"],
        row["solver"],
        f"{row['dt']:.4g}",
        *cells((row[key] for key in keys), ".1e"),
        cell(row["us_per_step"], ".3g"),
        cell(row["wall_s_per_simulated_s"], ".2g"),
        row["status"],
    )
