"""`dropper view RUN [RUN] --out view.html`: a saved run, or two side by side, as an interactive page."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from dropper_jax.cli.options import add_effects, add_examples, add_json, read_run
from dropper_jax.cli.outputs import add_file
from dropper_jax.cli.printing import done_object, print_result

help = "make an interactive 3D page of a saved run"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "view run.npz --out view.html",
        "view before.npz after.npz --out both.html",
    )
    parser.add_argument("run_file", metavar="RUN", help="file written by `dropper run --out`: .npz, .nc or .zarr")
    parser.add_argument("other", metavar="RUN", nargs="?", help="a second run, shown side by side")
    add_file(parser, "--out", (".html", ".htm"), "the page, which works offline", "FILE.html", required=True)
    add_effects(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    out: Path = args.out
    solution = read_run(args.run_file, args)
    other = None if args.other is None else read_run(args.other, args)

    from dropper_jax.report.page import write_view

    write_view(solution, out, other)
    size = out.stat().st_size
    return print_result(
        args,
        done_object(page=str(out), bytes=size, scene=solution.scene.name),
        f"ok: {out}, {size / 1e6:.2f} MB, {solution.scene.name} from {solution.t[0]:g} to {solution.t[-1]:g} s",
    )
