"""Common output options: `--plot DIR` writes pictures, `--out FILE` the result, `--report DIR` a report with both.

`--plot` also accepts a file FILE.png for the first picture; the result is the JSON object that `--json` prints.
"""

from __future__ import annotations

import json
import tempfile
from argparse import Action, ArgumentParser, Namespace
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write, remove
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.cli.faults import defer_signals
from dropper_jax.cli.given import output_file, output_folder
from dropper_jax.cli.printing import Failure, print_line, print_result, table, with_failure

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.run.simulate import Solution


PICTURES = {
    "snapshot": "snapshot",
    "tension": "tension_history",
    "motion": "motion_history",
    "angles": "angle_traces",
    "phase": "phase_space",
    "spectrum": "amplitude_spectrum",
}
#: Pictures that need motion.
OF_MOTION = ("motion", "bodies", "phase", "spectrum", "response")
#: Pictures of the links of a single line; a system's loads and motions are in its other pictures.
OF_ONE_LINE = ("phase", "response")
#: Additional pictures of a scene with water.
WATER_PICTURES = {
    "surface": "under_surface",
    "response": "response",
    "tension_envelope": "tension_envelope",
}


def save_or_report(solution: Solution, out: Path | None) -> str | None:
    """Save a run; if this fails, save it in the folder for temporary files, and return the error in one line."""
    if out is None:
        return None
    with defer_signals():
        try:
            solution.save(out)
            return None
        except OSError as error:
            reason = f"{error.filename}: {error.strerror}"
        except SceneError as error:
            reason = str(error)
        reason = " ".join(reason.split())
        with suppress(OSError):
            folder = Path(tempfile.mkdtemp(prefix="dropper-"))
            try:
                return f"{reason}; the run was saved to {solution.save(folder / f'{out.stem}.npz')}"
            except (SceneError, OSError):
                remove(folder)
    return f"{reason}; the run could not be saved"


class Output(Action):
    """A file or folder to write, checked while the options are read: `const` makes the path of a text and its label."""

    def __call__(
        self,
        parser: ArgumentParser,
        namespace: Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        label = self.metavar  # an argument that stands for itself has no option string
        if self.option_strings:
            label = self.option_strings[0]
        setattr(namespace, self.dest, self.const(values, label))


def add_folder(parser: ArgumentParser, option: str, about: str, default: Path | None = None) -> None:
    """An option that names a folder to write to."""
    parser.add_argument(option, action=Output, const=output_folder, default=default, metavar="DIR", help=about)


def add_file(
    parser: ArgumentParser, option: str, suffixes: tuple[str, ...], about: str, what: str = "FILE", **more: Any
) -> None:
    """An option, or an argument, that names a file to write."""
    check = partial(output_file, suffixes=suffixes)
    parser.add_argument(option, action=Output, const=check, metavar=what, help=about, **more)


def add_plot(parser: ArgumentParser, what: str) -> None:
    """--plot."""
    about = f"write {what} to a folder (or FILE.png)"
    parser.add_argument("--plot", action=Output, const=plot_folder, metavar="DIR", help=about)


def add_out(parser: ArgumentParser) -> None:
    """--out."""
    add_file(parser, "--out", (".json",), "write the result, what --json prints", "FILE.json")


def plot_folder(text: str, option: str) -> Path:
    """Output of the pictures: a folder, or one file FILE.png; checked before the work starts."""
    if Path(text).suffix.lower() in (".png", ".pdf", ".svg"):
        return output_file(text, option, (".png",))
    if Path(text).suffix and not Path(text).is_dir():
        raise SceneError(f"{option}: {text!r} has no known suffix; allowed: .png, or a folder without suffix")
    return output_folder(text, option)


def is_one_picture(target: Path) -> bool:
    """Whether `--plot` names the file of one picture, not a folder of all."""
    return target.suffix.lower() == ".png"


def picture(target: Path, name: str) -> Path:
    """The file of a picture: in the folder, which is created, or the requested file."""
    if is_one_picture(target):
        return target
    target.mkdir(parents=True, exist_ok=True)
    return target / f"{name}.png"


def deliver(args: Namespace, found: Table, text: str, failure: Failure | None = None) -> int:
    """Print the result and write it to the file of --out, if one was requested; returns the exit code."""
    if args.out is not None:
        atomic_write(args.out, json.dumps(jsonable(with_failure(found, failure)), allow_nan=False, indent=1))
    return print_result(args, found, text, failure)


def weights_table(scene: Scene) -> list[str]:
    """Mass, weight in water and density of the lines, a row for equal lines; empty without water."""
    from dropper_jax.plausibility.line_weights import line_weights, weight_cells

    rows = line_weights(scene)
    if not rows:
        return []
    return ["", table(weight_cells(rows))]


def draw(solution: Solution, target: Path) -> list[Path]:
    """A snapshot to a PNG file, or all pictures to a folder."""
    from dropper_jax import plots
    from dropper_jax.plots.movement import anything_moves
    from dropper_jax.plots.run import readable
    from dropper_jax.scene import whole_lines

    if is_one_picture(target):
        plots.snapshot(solution, target)
        return [target]
    target.mkdir(parents=True, exist_ok=True)
    scene = solution.scene
    pictures = dict(PICTURES)
    if scene.sea:
        pictures |= WATER_PICTURES
    if scene.bodies:
        pictures["bodies"] = "body_motion"
    if scene.branched:
        for name in OF_ONE_LINE:
            pictures.pop(name, None)
    if len(whole_lines(scene)) > 1:  # angles of links of many lines in one picture show nothing
        del pictures["angles"]
    if not anything_moves(readable(solution)):
        still = [name for name in pictures if name in OF_MOTION]
        for name in still:
            del pictures[name]
        print_line(f"pictures: no motion; left out: {', '.join(still)}")
    files = []
    for name, function in pictures.items():
        file = target / f"{name}.png"
        getattr(plots, function)(solution, file)
        files.append(file)
    return files
