"""`dropper run SCENE`: simulate a scene."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import RUN_SUFFIXES, unfinished_folder
from dropper_jax.base.read import Table, Values
from dropper_jax.cli.given import AUTO, number, output_file
from dropper_jax.cli.options import (
    RUN_VALUES,
    add_flag,
    add_quiet,
    add_run_values,
    add_scene,
    given_values,
    read_run,
    read_scene,
    recover_leftovers,
    with_step,
)
from dropper_jax.cli.outputs import Output, add_file, add_folder, draw, plot_folder, save_or_report
from dropper_jax.cli.printing import FAILED, INTERRUPTED, OK, print_json, print_line, print_warnings, progress
from dropper_jax.cli.run_text import text

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.run.simulate import Solution

help = "simulate a scene"

#: Suffixes of animations.
FILMS = (".gif", ".mp4")


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "run dropper-release-a --duration 10 --out run.npz --plot pictures",
        "run my-longline.toml --set sea.waves.hs=2.5 --accuracy 0.01 --report report",
        optional=True,
    )
    add_run_values(parser, RUN_VALUES)
    _add_outputs(parser)
    _add_errors(parser)
    add_quiet(parser)


def _add_outputs(parser: ArgumentParser) -> None:
    """Files of the run, and the run that it continues."""
    parser.add_argument(
        "--continue",
        dest="start",
        metavar="FILE",
        help="continue from the end of a saved run, for --duration more seconds (default: the remaining time of an "
        "interrupted run, else as long again); SCENE may be left out",
    )
    about = "save the solution, as .npz, .nc (netCDF, extra io) or .zarr (extra sweep)"
    save_as = partial(output_file, suffixes=RUN_SUFFIXES, folders=(".zarr",))
    parser.add_argument("--out", action=Output, const=save_as, metavar="FILE", help=about)
    add_folder(
        parser,
        "--tables",
        "write angles.csv (what `dropper fit` reads) and tensions.csv, for systems of lines also moordyn.out",
    )
    about = "write all pictures to a folder, or a snapshot to a file"
    parser.add_argument("--plot", action=Output, const=plot_folder, metavar="DIR_OR_FILE", help=about)
    add_folder(parser, "--report", "write report.md, report.json and their pictures")
    add_file(parser, "--animate", FILMS, "write an animation, .gif or (with ffmpeg) .mp4")


def _add_errors(parser: ArgumentParser) -> None:
    """Runs that state the errors of the run."""
    add_flag(
        parser,
        "--errors",
        "loads with their errors: repeats the run finer and with more links, about 6 times the run time",
    )
    companion = parser.add_mutually_exclusive_group()
    companion.add_argument(
        "--no-companion",
        dest="companion",
        action="store_const",
        const=None,
        default="coarser",
        help="leave out the second, coarser run, which states the errors of the first for half more time",
    )
    companion.add_argument(
        "--verify",
        dest="companion",
        action="store_const",
        const="finer",
        help="state the errors from a finer run, for two to three times the time",
    )
    parser.add_argument(
        "--skip",
        metavar="S",
        type=number,
        default=0.0,
        help="time at the start [s] that the loads of --errors leave out",
    )


def run(args: Namespace) -> int:
    before = None if args.start is None else read_run(args.start, args)
    is_automatic = args.dt == AUTO
    if is_automatic:
        args.dt = None
        if args.accuracy is None:
            args.accuracy = 0.01
    if before is None:
        scene = read_scene(args, RUN_VALUES, notes=False)
    else:
        scene = _continued_scene(args, before)
    if is_automatic:
        print_line(f"--dt auto: the steps follow an accuracy of {args.accuracy:g} (--accuracy)")

    from dropper_jax.run.simulate import simulate
    from dropper_jax.run.storage import check_target

    if args.out:
        check_target(args.out)
        recover_leftovers(args.out)
    if args.animate:
        from dropper_jax.plots.animation import check_animation

        check_animation(args.animate)
    folder = unfinished_folder(args.out) if args.out else nullcontext()
    with folder as scratch:
        solution = simulate(
            scene,
            progress=progress(args.quiet),
            errors=args.errors,
            skip=args.skip,
            start=before,
            scratch=scratch,
            companion=args.companion,
        )
        print_warnings(solution.warnings)
        refused = save_or_report(solution, args.out)
        if refused is not None:
            return _report_unsaved(args, solution, refused)
        return _write_outputs(args, solution)


def _report_unsaved(args: Namespace, solution: Solution, refused: str) -> int:
    """Report a run whose file cannot be written."""
    print_line(f"error: {refused}")
    more: Values = {}
    if solution.status == "ok":
        more = {"status": "not_saved", "error": refused}
    report(solution, args.json, more)
    return FAILED


def _write_outputs(args: Namespace, solution: Solution) -> int:
    """Tables and pictures of a run, and its report."""
    from dropper_jax.run.summary import write_angles, write_bodies, write_tensions

    scene = solution.scene
    if args.tables:
        args.tables.mkdir(parents=True, exist_ok=True)
        write_angles(solution, args.tables / "angles.csv")
        write_tensions(solution, args.tables / "tensions.csv")
        if scene.bodies:
            write_bodies(solution, args.tables / "bodies.csv")
        if scene.branched:
            _write_channels(args.scene or "", solution, args.tables / "moordyn.out")
    if args.plot:
        draw(solution, args.plot)
    if args.report:
        _write_report(solution, args.report)
    if args.animate:
        from dropper_jax import plots

        plots.animate(solution, args.animate, progress=progress(args.quiet))
    return report(solution, args.json)


def _write_report(solution: Solution, folder: Path) -> None:
    """The report of a run; of one with too few samples, such as one that failed at its start, the reason for none."""
    from dropper_jax.report.build import report_runs
    from dropper_jax.report.write import write_report

    try:
        found = report_runs({"run": solution})
    except SceneError as error:
        print_line(f"warning: no report: {error}")
    else:
        write_report(found, {"run": solution}, folder)


def _write_channels(source: str, solution: Solution, path: Path) -> None:
    """MoorDyn's table: the channels of a MoorDyn input, else tensions at all ends."""
    from dropper_jax.decks.writing.outputs import channels_of, numbers_of, write_out

    for channel in write_out(solution, path, channels_of(source) or None, skip=True, numbers=numbers_of(source)):
        print_line(f"warning: output {channel!r} is not available from a run; it is left out")


def _continued_scene(args: Namespace, before: Solution) -> Scene:
    """The scene of the run to continue, or that of the command line if given, with the values of the command line."""
    values = {"run.duration": before.further, **given_values(args, RUN_VALUES)}
    if args.scene is None:
        return with_step(before.scene.with_values(values), args)
    return read_scene(args, RUN_VALUES, notes=False).with_values({"run.duration": values["run.duration"]})


def report(solution: Solution, as_json: bool, more: Values | None = None) -> int:
    """Print the result, with `more` keys in the JSON object; returns the exit code."""
    if as_json:
        print_json({**solution.summary(), **_flow(solution), **(more or {})})
    else:
        print(text(solution))
    if solution.failure:
        print_line(f"error: {solution.failure}")
    return {"ok": OK, "interrupted": INTERRUPTED}.get(solution.status, FAILED)


def _flow(solution: Solution) -> Table:
    """Keulegan-Carpenter and Reynolds number and diameter over wavelength, if the scene has water on a line."""
    from dropper_jax.study.flow_regime import regime

    if solution.scene.sea is None or solution.scene.lines[0].diameter is None:
        return {}
    return {"flow": regime(solution)}
