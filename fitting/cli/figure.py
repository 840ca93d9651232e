"""`dropper figure NAME... --plot DIR`: figures of the sources, from runs of their scenes; without a name, a list."""

from __future__ import annotations

import argparse

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.options import (
    FAILED,
    add_examples,
    add_json,
    add_quiet,
    done_object,
    failure_object,
    listing,
    print_line,
    print_result,
    progress,
)
from dropper_jax.cli.outputs import picture, plot_folder

help = "draw the paper's and the thesis' figures that show a simulation: runs their scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "figure",
        "figure paper-6 --plot figures",
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="source and number, such as paper-6 or thesis-8.27, or all; none: lists them",
    )
    parser.add_argument("--plot", default=".", metavar="DIR", help="folder for the pictures (default: this one)")
    parser.add_argument("--traces", metavar="FILE.csv", help="measured angles to draw on the thesis' figures")
    add_quiet(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    target = plot_folder(args.plot)

    from dropper_jax.effects import register_installed
    from dropper_jax.study.figure_table import Run, cases_of, figure_of, figures, scene_of
    from dropper_jax.study.source_figures import draw_figure

    register_installed()
    known = figures()
    if not args.names:
        found = {figure.name: figure.caption for figure in known.values()}
        return print_result(args.json, done_object(figures=found), listing(list(found.items())))
    chosen = list(known.values()) if "all" in args.names else [figure_of(name) for name in dict.fromkeys(args.names)]
    if len(chosen) > 1 and target.suffix:
        raise SceneError(f"--plot: {args.plot!r} is one file for {len(chosen)} figures. Use a folder")
    measured = _read_measured(args.traces) if args.traces else None

    from dropper_jax.run.simulate import simulate

    runs, files, failed = {}, [], []
    for figure in chosen:
        cases = cases_of(figure)
        for case in cases:
            if case.key not in runs:
                runs[case.key] = simulate(scene_of(*case.key), progress=progress(args.quiet))
        drawn = [Run(case.label, runs[case.key]) for case in cases]
        failed += [f"{figure.name}: {run.solution.failure}" for run in drawn if run.solution.failure]
        if not any(run.solution.failure for run in drawn):
            files += draw_figure(figure, drawn, picture(target, figure.name), measured)
    names = [str(file) for file in files]
    if failed:
        for text in failed:
            print_line(f"error: {text}")
        if args.json:
            status = next(run.status for run in runs.values() if run.failure)
            print_result(True, failure_object(status, failed[0]) | {"files": names}, "")
        return FAILED
    return print_result(args.json, done_object(files=names), "\n".join(names))


def _read_measured(file: str) -> tuple:
    """Times [s] and angles [rad] from the horizontal, positive downwards."""
    from fitting.traces.trace import read_trace

    trace = read_trace(file)
    return trace.t, trace.in_model_convention(trace.convention).theta
