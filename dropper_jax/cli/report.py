"""`dropper report RUN... --report DIR`: loads, fatigue, motion and contact of saved runs, extremes over seeds."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import fields

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.records import without_none
from dropper_jax.cli.given import check_once, number
from dropper_jax.cli.options import add_effects, add_examples, add_json, read_run
from dropper_jax.cli.outputs import add_folder
from dropper_jax.cli.printing import FAILED, OK, print_line, print_result
from dropper_jax.evaluation.settings import Settings, option_of

help = "report on saved runs: tensions, anchors, snaps, fatigue, motion, contact, extremes over seeds"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "report run.npz --report report",
        "report seed-1.npz seed-2.npz seed-3.npz --skip 60 --storm 10800",
    )
    parser.add_argument(
        "runs", nargs="+", metavar="RUN", help="files written by `dropper run --out`: .npz, .nc or .zarr"
    )
    add_folder(parser, "--report", "write report.md, report.json and pictures")
    add_folder(parser, "--vtk", "write the first run as a series of .vtp files for ParaView")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth saved time for --vtk (default: 1)")
    for field in fields(Settings):
        about = "{meaning} [{unit}]".format(**field.metadata)
        if field.default is not None:
            about += f" (default: {field.default:g})"
        parser.add_argument(option_of(field), dest=f"setting_{field.name}", type=number, metavar="X", help=about)
    add_effects(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    given = {f.name: getattr(args, f"setting_{f.name}") for f in fields(Settings)}
    settings = Settings(**without_none(given))
    if args.every < 1:
        raise SceneError(f"--every: {args.every} is out of range; allowed: a whole number >= 1")
    check_once(args.runs, "RUN")
    solutions = {file: read_run(file, args) for file in args.runs}

    from dropper_jax.report.build import report_runs
    from dropper_jax.report.text import report_markdown
    from dropper_jax.report.vtk import write_vtk
    from dropper_jax.report.write import write_report

    found: Table = report_runs(solutions, settings)
    failures = [f"{file}: {solution.failure}" for file, solution in solutions.items() if solution.failure]
    if failures:
        found["error"] = "; ".join(failures)
    if args.report:
        print_line(f"report: {write_report(found, solutions, args.report, settings)}")
    if args.vtk:
        print_line(f"ParaView: {write_vtk(next(iter(solutions.values())), args.vtk, args.every)}")
    print_result(args, found, report_markdown(found, [{} for _ in solutions]))
    for failure in failures:
        print_line(f"error: {failure}")
    return FAILED if failures else OK
