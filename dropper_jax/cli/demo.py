"""`dropper demo`: release the lab dropper of scenario A, then run the parts of the entry-point group `dropper.demo`.

A part of the demo is a module with `title` and `run_part(folder, progress)`, which writes its files to `folder` and
returns a `DemoPart`. The simulator does not import any part: `fitting` registers the calibration.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.files import atomic_write
from dropper_jax.base.markdown import literal
from dropper_jax.base.read import Table
from dropper_jax.cli.options import add_examples, add_json
from dropper_jax.cli.outputs import PICTURES, add_folder, draw
from dropper_jax.cli.printing import FAILED, OK, print_line, progress
from dropper_jax.cli.run import report
from dropper_jax.cli.run_text import text

if TYPE_CHECKING:
    from dropper_jax.run.simulate import Solution

help = "release the lab dropper and calibrate its damping from synthetic traces; pictures, animation, report"

GROUP = "dropper.demo"
SCENE = "dropper-release-a"
DURATION = 50.0


@dataclass(frozen=True)
class DemoPart:
    """Result of a part of the demo: text for the terminal, Markdown for the report, values for the JSON object."""

    status: str
    text: str
    markdown: str
    values: Table


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "demo",
        "demo --out my-demo --json",
    )
    add_folder(parser, "--out", "folder for the results (default: demo)", Path("demo"))
    add_json(parser)


def run(args: Namespace) -> int:
    folder: Path = args.out
    folder.mkdir(parents=True, exist_ok=True)

    from dropper_jax import plots
    from dropper_jax.load.scene import load_scene
    from dropper_jax.run.simulate import simulate

    solution = simulate(load_scene(SCENE), dt=0.005, duration=DURATION, progress=progress())
    print_line("drawing the pictures")
    draw(solution, folder)
    print_line("drawing the animation")
    plots.animate(solution, folder / "animation.gif", progress=progress())
    parts = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        parts[entry.name] = _part(entry, folder)
    sections = [_section(solution), *(part.markdown for part in parts.values())]
    atomic_write(folder / "report.md", "\n\n".join(sections) + "\n")
    code = report(solution, args.json, {key: part.values for key, part in parts.items()})
    if not args.json:
        for part in parts.values():
            print(f"\n{part.text}")
    print_line(f"report and pictures are in {folder}")
    if code == OK and any(part.status != "ok" for part in parts.values()):
        return FAILED
    return code


def _part(entry: EntryPoint, folder: Path) -> DemoPart:
    module = entry.load()
    print_line(module.title)
    return module.run_part(folder / entry.name, progress())


def _section(solution: Solution) -> str:
    pictures = "\n".join(f"![{name}]({name}.png)\n" for name in PICTURES)
    return (
        f"# {literal(solution.scene.name)}\n\n{literal(solution.scene.description)}\n\n"
        f"```\n{text(solution)}\n```\n\n{pictures}\n![animation](animation.gif)"
    )
