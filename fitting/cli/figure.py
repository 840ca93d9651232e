"""`dropper figure NAME... --plot DIR`: the sources' figures, from runs of their scenes; without a name, a list."""

from __future__ import annotations

import argparse

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.codes import FAILED, OK
from dropper_jax.cli.options import add_json, add_quiet
from dropper_jax.cli.output import done_object, failure_object, listing, print_line, print_result, progress
from dropper_jax.cli.outputs import picture, plot_folder

name = "figure"
help = "draw the paper's Figures 6 to 19 and the thesis' 8.20 and 8.27: runs their scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="paper-6 to paper-19, thesis-8.20, thesis-8.27, all; none: lists them"
    )
    parser.add_argument("--plot", default=".", metavar="DIR", help="folder for the pictures (default: this one)")
    parser.add_argument("--traces", metavar="FILE.csv", help="measured angles to lay over the thesis' figures")
    add_quiet(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    target = plot_folder(args.plot)

    from dropper_jax.effects import register_installed
    from dropper_jax.study.source_figures import FIGURES, draw_figure, figure_of, scene_of

    register_installed()
    if not args.names:
        found = {figure.name: figure.caption for figure in FIGURES.values()}
        print_result(args.json, done_object(figures=found), listing(list(found.items())))
        return OK
    chosen = list(FIGURES.values()) if "all" in args.names else [figure_of(name) for name in dict.fromkeys(args.names)]
    if len(chosen) > 1 and target.suffix:
        raise SceneError(f"--plot: {args.plot!r} is one file for {len(chosen)} figures; allowed: a folder")
    measured = _measured(args.traces) if args.traces else None

    from dropper_jax.run.simulate import simulate

    runs, files = {}, []
    for figure in chosen:
        key = (figure.scene, figure.values, figure.duration)
        if figure.duration and key not in runs:
            runs[key] = simulate(scene_of(figure), progress=progress(args.quiet))
        solution = runs.get(key)
        if solution is not None and solution.failure:
            print_line(f"error: {figure.name}: {solution.failure}")
            if args.json:
                print_result(True, failure_object(solution.status, solution.failure), "")
            return FAILED
        files += draw_figure(figure, solution, picture(target, figure.name), measured)
    print_result(args.json, done_object(files=[str(file) for file in files]), "\n".join(map(str, files)))
    return OK


def _measured(file: str) -> tuple:
    """Times [s] and angles [rad] from the horizontal, positive downwards."""
    from fitting.traces.trace import read_trace

    trace = read_trace(file)
    return trace.t, trace.in_model_convention(trace.convention).theta
