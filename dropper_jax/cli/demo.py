"""`dropper demo`: release the lab dropper of scenario A, with pictures and a short report."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.cli.options import add_json
from dropper_jax.cli.output import print_line, progress
from dropper_jax.cli.run import PICTURES, draw, report, text
from dropper_jax.io import atomic_write

if TYPE_CHECKING:
    from dropper_jax.solution import Solution

name = "demo"
help = "release the lab dropper from the measured pose of scenario A; pictures, animation, report"

SCENE, DT, DURATION = "dropper-release-a", 0.005, 50.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", default="demo", metavar="DIR", help="folder for the results (default: demo)")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)

    from dropper_jax import load_scene, plots, simulate

    solution = simulate(load_scene(SCENE), dt=DT, duration=DURATION, progress=progress())
    print_line("drawing the pictures")
    draw(solution, folder)
    print_line("drawing the animation")
    plots.animate(solution, folder / "animation.gif", progress=progress())
    atomic_write(folder / "report.md", _report(solution))
    code = report(solution, args.json)
    print_line(f"report and pictures are in {folder}")
    return code


def _report(solution: Solution) -> str:
    pictures = "\n".join(f"![{name}]({name}.png)\n" for name in PICTURES)
    return (
        f"# {solution.scene.name}\n\n{solution.scene.description}\n\n"
        f"```\n{text(solution)}\n```\n\n{pictures}\n![animation](animation.gif)\n"
    )
