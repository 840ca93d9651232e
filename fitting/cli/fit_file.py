"""`dropper fit FILE...` without a scene: a scene is proposed, fitted, and written with the command that repeats it."""

from __future__ import annotations

import re
from argparse import ArgumentParser, Namespace
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from dropper_jax.base.read import Table
from dropper_jax.base.records import without_keys
from dropper_jax.cli.given import positive, read_numbers, values_by_name
from dropper_jax.cli.options import add_flag
from dropper_jax.cli.printing import table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from fitting.calibration.result import FitResult
    from fitting.from_file.read_file import FileOptions
    from fitting.traces.trace import Trace

#: Model error that a fit to a file may assume, as a fraction of the motion.
LARGEST_MODEL_ERROR = 0.003
NOT_LENGTHS = "is not a list of lengths; allowed: numbers > 0 m, such as 0.2,0.15"


def add_file_options(parser: ArgumentParser) -> None:
    """--rate, --counts, --same-motion, --lengths, --mass."""
    parser.add_argument(
        "--rate", type=positive("1/s"), metavar="FPS", help="rows per second of a file that counts frames"
    )
    parser.add_argument(
        "--counts", type=positive("counts"), metavar="N", help="counts per turn of an encoder whose angle is in counts"
    )
    add_flag(parser, "--same-motion", "the files are recordings of one motion (default: one run each)")
    parser.add_argument("--lengths", metavar="L1,L2,...", help="lengths [m] of links whose angles alone are measured")
    parser.add_argument(
        "--mass", type=positive("kg"), metavar="KG", help="mass of each link, for damping in kg/s without a scene"
    )


def file_options(args: Namespace) -> FileOptions:
    """What the options state about the files.

    Raises:
        SceneError: a length that is not positive, an unknown unit.
    """
    from fitting.from_file.read_file import FileOptions
    from fitting.traces.trace import RADIANS

    lengths = None
    if args.lengths is not None:
        lengths = tuple(read_numbers(args.lengths, "--lengths", NOT_LENGTHS))
        if not all(0.0 < length < np.inf for length in lengths):
            raise SceneError(f"--lengths: {args.lengths!r} {NOT_LENGTHS}")
    units = [*RADIANS, "counts"]
    if args.unit is not None and args.unit not in units:
        raise SceneError(f"--unit: {args.unit!r} is unknown; allowed: {', '.join(units)}")
    return FileOptions(
        columns=column_names(args.columns),
        unit=args.unit,
        rate=args.rate,
        counts=args.counts,
        lengths=lengths,
        mass=args.mass,
        begin=args.since,
    )


def is_trace_file(file: str, partial: bool) -> bool:
    """Whether a file has the columns of a trace, `t` and `theta_1`, or of any link if `partial`, under these names."""
    from fitting.traces.text_lines import read_lines

    heads = [line for line in read_lines(Path(file))[:100] if not line.lstrip().startswith("#")]
    names = re.split(r"[,;\s]+", heads[0].strip()) if heads else []
    pattern = r"theta_\d+" if partial else "theta_1"
    return "t" in names and any(re.fullmatch(pattern, name) for name in names)


def traces_for(args: Namespace, scene: Scene) -> tuple[list[str | Trace], list[str]]:
    """The files for a scene: those of other programs as traces, and how they were read.

    Raises:
        SceneError: options that only a fit without a scene has, or a unit for files of both kinds.
    """
    from fitting.from_file.read_file import read_measured

    given = file_options(args)
    stated = (args.rate, args.counts, args.columns)
    if args.mass is not None or args.lengths is not None:
        raise SceneError("--mass, --lengths: only without --scene; the scene has them")
    found: list[str | Trace] = []
    notes = []
    for file in args.traces:
        if is_trace_file(file, args.same_motion) and not any(stated):
            found.append(file)
            continue
        measured = read_measured(file, given, scene.lines[0].links)
        found.append(measured.trace)
        notes += [f"{measured.trace.name}: {note}" for note in measured.notes]
    named = [file for file in found if isinstance(file, str)]
    if notes and named and args.unit is not None:
        raise SceneError(f"--unit: not for {named[0]!r} and files of other programs. State it there: # unit=rad or deg")
    return found, notes


def column_names(text: str | None) -> dict[str, str] | None:
    """Columns of a file by name, of `time=timestamp,theta_1=angle`."""
    if text is None:
        return None
    return values_by_name(map(_column_name, text.split(",")), "--columns")


def _column_name(text: str) -> tuple[str, str]:
    """Name and column of `theta_1=angle`."""
    name, _, column = (word.strip() for word in text.partition("="))
    if not (name and column):
        raise SceneError(f"--columns: {text!r} is not NAME=COLUMN; allowed: time=COLUMN,theta_1=COLUMN,...")
    return name, column


def fit_files(args: Namespace, shared: Table, say: Progress) -> tuple[FitResult, Table, str]:
    """Fit files without a scene: the result, and what was assumed and found as plain values and as text."""
    from dropper_jax.load.scene import Scene
    from fitting.calibration.fit import fit, free_laws
    from fitting.from_file.fitted_values import fitted_values, value_rows
    from fitting.from_file.output import unused, write_case
    from fitting.from_file.propose_scene import propose_scene
    from fitting.from_file.read_file import read_measured

    given = file_options(args)
    if args.held_out is None:  # a stretch that is held out may lie after --until
        given = replace(given, end=args.until)
    measured = [read_measured(file, given) for file in args.traces]
    if len({one.trace.links for one in measured}) > 1:
        counts = ", ".join(f"{one.trace.name} {one.trace.links}" for one in measured)
        raise SceneError(f"the files show different numbers of links: {counts}. Fit each rig alone")
    plain = propose_scene(measured[0], given)

    def fit_plain() -> FitResult:
        scene = Scene.from_dict(plain, measured[0].trace.name)
        found = fit([one.trace for one in measured], scene, args.free, **shared, progress=say)
        return free_laws(found, shared["method"], shared["loss"], progress=say)

    result = fit_plain()
    assumed = [f"{one.trace.name}: {note}" for one in measured for note in one.notes]
    if result.status == "misfit" and (error := model_error_of(result)) is not None and args.free is None:
        # bearings depart from any model by a small angle, which hides the law: dry friction is then free without a test
        plain["effects"]["joint_friction"] = {"dry": 1e-4 * (given.mass or 1.0), "axis": [0.0, 1.0, 0.0]}
        plain["fit"] |= {"free": [*plain["fit"]["free"], "dry"], "model_error": error}
        assumed.append(
            f"the residuals exceed the noise: the rig departs by {error:g} rad from this model, and has dry friction"
        )
        result = fit_plain()
    folder = args.report or unused(Path(), f"{measured[0].trace.name}-fit")
    options = ["--same-motion"] if args.same_motion else []
    command = write_case(Path(folder), measured, plain, options)
    values = fitted_values(result, measured[0], args.mass)
    assumed.append(model_note(measured[0].trace.links, args.mass))
    text = "\n\n".join([assumed_text(assumed), table(value_rows(values)), f"repeat with: {command}"])
    found = {one.name: without_keys(asdict(one), ["name"]) for one in values}
    return result, {"assumed": assumed, "found": found, "repeat": command}, text


def assumed_text(notes: list[str]) -> str:
    """How the files were read, as text."""
    return "assumed\n" + "\n".join(f"  {note}" for note in notes)


def model_error_of(result: FitResult) -> float | None:
    """The model error [rad] that explains a misfit; None where it is not small compared with the motion."""
    motion = min(float(np.nanstd(column)) for trace in result.traces for column in trace.theta.T)
    error = float(f"{result.rms:.2g}")
    if error < LARGEST_MODEL_ERROR * motion and not result.wrong_file:
        return error
    return None


def model_note(links: int, mass: float | None) -> str:
    """What the proposed scene assumes, in words."""
    what = "one pendulum of an effective length"
    if links > 1:
        what = f"{links} massless links with masses at their ends"
    scale = "a mass of 1 kg: damping is per mass" if mass is None else f"masses of {mass:g} kg"
    return f"model: {what}, in air, linear and quadratic drag, gravity 9.81 m/s^2; {scale}"
