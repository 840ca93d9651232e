"""`dropper accuracy SCENE`: run time against accuracy."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.base.table_cells import record_cells
from dropper_jax.cli.given import positive
from dropper_jax.cli.options import add_flag, add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import STOPPED, done_object, print_line, progress, record_table, row_printer

help = "measure errors and times of all integrators over a range of steps, row by row, and advise"
#: Columns of the errors of loads: formats of the values by heading.
LOADS = {
    "accuracy": "{accuracy:.2g}",
    "dt [s]": "{dt:.4g}",
    "mean": "{mean:.2%}",
    "std. dev.": "{deviation:.2%}",
    "wave maxima": "{window_maximum:.2%}",
    "maximum": "{maximum:.2%}",
    "us/step": "{us_per_step:.3g}",
    "status": "{status}",
}
#: Columns of the schemes.
SCHEMES = {
    "scheme": "{label}",
    "solver": "{solver}",
    "dt [s]": "{dt:.4g}",
    "angle [rad]": "{rms_angle_error_rad:.1e}",
    "position [m]": "{rms_position_error_m:.1e}",
    "tension [N]": "{rms_tension_error_n:.1e}",
    "drift [J]": "{energy_drift_j:.1e}",
    "us/step": "{us_per_step:.3g}",
    "s/s": "{wall_s_per_simulated_s:.2g}",
    "status": "{status}",
}


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
        type=positive("s"),
        metavar="S",
        help="equal steps [s] (default: 1/32 to 1/2048; loads by accuracy)",
    )
    parser.add_argument(
        "--span",
        type=positive("s"),
        help="duration of the comparison [s] (default: until a perturbation has grown 100 times, at most 20 s)",
    )
    add_flag(parser, "--quick", "each scheme once, without retries: errors, times, orders and advice")
    add_plot(parser, "the pictures of errors against time, of orders and of damping")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args)

    from dropper_jax.study.accuracy import accuracy
    from dropper_jax.study.schemes import parse

    schemes = None
    if args.integrators:
        names = ",".join(args.integrators).split(",")
        schemes = list(map(parse, names))
    dts = None if args.dts is None else tuple(args.dts)
    say = progress(args.quiet)
    found = accuracy(scene, schemes, dts, args.span, extras=not args.quick, progress=say, each=_row_printer(args.quiet))
    for item in found["refused"]:
        print_line(f"left out: {item['scheme']}: {item['reason']}")
    failure = STOPPED if found.get("status") == STOPPED[0] else None
    if args.plot and failure is None:
        draw(found, picture(args.plot, "accuracy"))
    return deliver(args, done_object(**found), text(found), failure)


def _row_printer(quiet: bool) -> Callable[[Table], None]:
    """A function that prints a row of a scheme or of the loads as soon as it is measured."""
    of_schemes = row_printer(list(SCHEMES), quiet)
    of_loads = row_printer(["loads", *LOADS], quiet)

    def show(row: Table) -> None:
        if "errors" in row:
            of_loads(["", *record_cells(_with_errors(row), LOADS)])
        else:
            of_schemes(record_cells(row, SCHEMES))

    return show


def draw(found: Table, path: Path) -> None:
    """Write the work-precision picture to `path` and the others next to it."""
    from dropper_jax.study.accuracy_pictures import convergence, damping, work_precision

    work_precision(found, path)
    if "convergence" in found:
        convergence(found, path.with_stem(f"{path.stem}-convergence"))
        damping(found, path.with_stem(f"{path.stem}-damping"))


def text(found: Table) -> str:
    """The report as text."""
    parts = []
    if found["reference"]:
        parts.append(_schemes(found))
    if "loads" in found:
        parts.append(_loads(found["loads"]))
    if "numerical_damping" in found:
        parts.append(found["numerical_damping"]["thesis"]["text"])
        held_claims = sum(column(found["euler"], "holds"))
        parts.append(f"Euler's schemes on the pendulums: {held_claims} of {len(found['euler'])} measured claims hold")
    return "\n\n".join(parts)


def _schemes(found: Table) -> str:
    """Errors and times of the schemes, and the advice; of an interrupted comparison the rows so far."""
    head = (
        "{scene}: compared over {horizon_s:.4g} s; perturbations grow at {lyapunov_per_s:.3g} 1/s and reach 100 times "
        "after {trusted_span_s:.4g} s\n\n"
        "reference: {made_by}; its error {error_estimate_rad:.2g} rad, against {checked_by}"
    )
    orders = [f"{label} {order:.2f}" for label, order in found["orders"].items()]
    parts = (
        head.format(scene=found["scene"], **found["reference"]),
        record_table(found["rows"], SCHEMES),
        f"measured orders: {', '.join(orders)}",
        "\n".join(column(found["advice"], "text")),
    )
    return "\n\n".join(parts)


def _loads(found: Table) -> str:
    """Errors of the loads, and the accuracy or the step below which they are small."""
    if not found["rows"]:
        return f"loads: {found['skipped']}"
    finest = found["reference_dt"]
    against = "half of each step" if finest is None else f"steps of {finest:.4g} s"
    head = f"errors of the loads of the worst line, against {against}:"
    rows = record_table(map(_with_errors, found["rows"]), LOADS)
    return "\n".join([head, rows, *column(found["advice"], "text")])


def _with_errors(row: Table) -> Table:
    return row | row["errors"]
