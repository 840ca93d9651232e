"""Options of `dropper fit`: parameters, method, convention of the traces, and their values."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.given import number, positive, positive_integer, read_numbers, split_names
from dropper_jax.cli.options import add_flag, add_json, add_quiet
from dropper_jax.cli.outputs import add_folder, add_out
from fitting.cli.fit_file import add_file_options

if TYPE_CHECKING:
    from fitting.estimate.loss import Loss
    from fitting.windows.method import Method


#: Those of `fitting.windows.method`, which imports JAX.
METHODS = ("windows", "shooting", "gradient")


def add_parameters(parser: ArgumentParser) -> None:
    """What is fitted: parameters, their start values, bounds and priors, and the samples."""
    parser.add_argument(
        "--free",
        type=split_names,
        metavar="NAMES",
        help="parameters, such as b_l,line.0.inertia,release.time (default: those listed in [fit], else damping)",
    )
    add_flag(parser, "--fixed", "without --free and [fit]: keep the lengths and the zero of the angles")
    parser.add_argument(
        "--start", action="append", default=[], metavar="NAME=VALUE", help="start value of a free parameter"
    )
    parser.add_argument(
        "--bounds", action="append", default=[], metavar="NAME=LOW:HIGH", help="bounds of a free parameter"
    )
    parser.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="NAME=MEAN+-SD",
        help="prior of a free parameter, such as line.0.inertia=1.1e-4+-1e-6",
    )
    parser.add_argument(
        "--own",
        type=split_names,
        default=[],
        metavar="NAMES",
        help="of channels: parameters fitted separately for each run; reports mean and spread",
    )
    parser.add_argument("--from", dest="since", type=number, metavar="T", help="fit only samples from this time on [s]")
    parser.add_argument("--until", type=positive("s"), metavar="T", help="fit only samples before this time [s]")
    parser.add_argument("--held-out", metavar="LO:HI,...", help="score these stretches [s] without fitting them")
    parser.add_argument(
        "--rest", metavar="LO:HI,...", help="stretches [s] in which the line is at rest: their poses are fitted too"
    )
    add_method(parser)


def add_method(parser: ArgumentParser) -> None:
    """How it is fitted: estimator, windows, files, loss."""
    parser.add_argument("--method", choices=METHODS, default="shooting", help="estimator (default: shooting)")
    parser.add_argument("--optimizer", metavar="NAME", help="of --method gradient: lbfgs (default), adam or sgd")
    parser.add_argument(
        "--learning-rate",
        type=number,
        metavar="RATE",
        help="of --method gradient: fraction of the predicted distance per step (default: lbfgs 1, adam 0.3, sgd 0.5)",
    )
    parser.add_argument(
        "--steps",
        type=int,
        metavar="N",
        help="of --method gradient: maximum steps over separate windows, and at each gap weight (default: 100)",
    )
    parser.add_argument(
        "--window", type=positive("s"), metavar="S", help="length of a window [s] (default: from the motion)"
    )
    parser.add_argument(
        "--dt",
        type=positive("s"),
        help="time step [s], at most the samples' interval (default: 1/75 of the shortest link's period)",
    )
    parser.add_argument(
        "--integrator", help="scheme of the windows, such as tsit5 (default: rattle_4 for point masses)"
    )
    add_convention(parser)
    add_file_options(parser)
    loss = parser.add_mutually_exclusive_group()
    loss.add_argument("--huber", type=positive(""), metavar="K", help="robust loss beyond K standard deviations")
    loss.add_argument("--robust", metavar="NAME", help="robust loss by name: huber or student")
    loss.add_argument("--student", action="store_true", help="Student's t loss with 4 degrees, for outliers")
    parser.add_argument(
        "--iterations", type=positive_integer, default=40, help="maximum iterations over separate windows (default: 40)"
    )
    add_flag(parser, "--static-start", "release every run at t = 0 as defined in [start]")
    add_judging(parser)


def add_judging(parser: ArgumentParser) -> None:
    """What judges the result, and where it is written."""
    add_flag(parser, "--advice", "test what else may be wrong: lengths, roll, clock")
    add_flag(parser, "--auto-free", "add free parameters while the fit improves")
    add_flag(parser, "--compare-models", "also fit a ladder of damping laws")
    parser.add_argument(
        "--profile",
        type=split_names,
        nargs="?",
        const=[],
        metavar="NAMES",
        help="intervals by profile likelihood too (default: of all)",
    )
    parser.add_argument(
        "--bootstrap",
        nargs="?",
        const=400,
        type=positive_integer,
        metavar="DRAWS",
        help="resample blocks of time (default: 400)",
    )
    add_flag(parser, "--accept-misfit", "exit code 0 even if the model misses the trace or its law is wrong")
    add_folder(parser, "--plot", "write only the pictures of the fit")
    add_out(parser)
    add_folder(parser, "--report", "write a report with pictures")
    add_quiet(parser)
    add_json(parser)


def add_convention(parser: ArgumentParser) -> None:
    """--zero, --sign, --unit, --columns."""
    parser.add_argument("--zero", help="zero direction of the traces' angles: horizontal or down")
    parser.add_argument("--sign", help="1 or -1")
    parser.add_argument("--unit", help="rad or deg")
    parser.add_argument(
        "--columns",
        metavar="NAME=COLUMN,...",
        help="the traces' columns if they have other names, such as time=timestamp,theta_1=angle",
    )


def check_without_scene(args: Namespace) -> None:
    """Reject what only a scene can explain.

    Raises:
        SceneError: channels, or options of a scene.
    """
    if names_toml(args.traces):
        raise SceneError("--scene: missing; channels named in a TOML file need a scene")
    for key in ("set", "static_start", "auto_free", "effects"):
        if getattr(args, key):
            raise SceneError(f"--{key.replace('_', '-')}: only with --scene; the scene of a file is proposed")


def names_toml(files: list[str]) -> bool:
    """Whether a TOML file of channels is among the files."""
    return any(file.lower().endswith(".toml") for file in files)


def chosen_loss(args: Namespace) -> Loss:
    """The loss of --huber, --student and --robust."""
    from fitting.estimate.loss import LEAST_SQUARES, Huber, as_loss

    if args.huber is not None:
        return Huber(args.huber)
    name = "student" if args.student else args.robust
    if name is None:
        return LEAST_SQUARES
    return as_loss(name, "robust")


def chosen_method(args: Namespace) -> Method:
    """The method with its settings.

    Raises:
        SceneError: settings of a descent for another method.
    """
    from fitting.windows.method import Method

    given = {key: getattr(args, key) for key in OF_DESCENT if getattr(args, key) is not None}
    if args.method != "gradient":
        if given:
            name, value = min(given.items())
            raise SceneError(f"{name}: {value!r} is not a setting of method {args.method!r}. Use method gradient")
        return Method(args.method, iterations=args.iterations)
    from fitting.estimate.descent import GradientDescent

    return Method("gradient", iterations=args.iterations, descent=GradientDescent(**given))


#: Beginnings of names of parameters that belong to a file of channels, not to the scene.
OF_DATA = ("start.", "channel.", "camera.")
#: Options of `--method gradient`.
OF_DESCENT = ("optimizer", "learning_rate", "steps")
#: Options of traces that are None if not given.
TRACE_VALUES = (
    "since",
    "until",
    "held_out",
    "window",
    "zero",
    "sign",
    "unit",
    "columns",
    "rest",
    "rate",
    "counts",
    "lengths",
    "mass",
)
#: Options of traces that are on or off.
TRACE_SWITCHES = ("static_start", "fixed", "advice", "auto_free", "compare_models", "accept_misfit", "same_motion")
#: Options without a meaning in a fit to channels, and their values if not given.
OF_TRACES = {
    **dict.fromkeys((*TRACE_VALUES, *OF_DESCENT)),
    **dict.fromkeys(TRACE_SWITCHES, False),
    "method": "shooting",
}


def read_spans(text: str | None, option: str = "--held-out") -> list[tuple[float, float]]:
    """Spans [s] of `lo:hi,lo:hi`."""
    reason = "is not lo:hi; allowed: spans in s such as 40:45,45:50"
    found = []
    for part in filter(None, (text or "").split(",")):
        low, high = read_numbers(part, option, reason, ":", 2)
        found.append((low, high))
    return found


#: Forms of values: their text after the name, the mark between two numbers, and what one without it lacks.
FORMS = {
    "start": ("VALUE", "", ""),
    "bounds": ("LOW:HIGH", ":", "is not a range; allowed: NAME=LOW:HIGH, one end may be omitted"),
    "prior": ("MEAN+-SD", "+-", "has no width; allowed: NAME=MEAN+-SD"),
}


def named_values(option: str, texts: list[str]) -> dict[str, Any]:
    """Numbers of `NAME=VALUE` by name, or pairs of numbers; an omitted end of bounds is None, the scene's own.

    Raises:
        SceneError: a text of another form, or a name that is given twice.
    """
    form, mark, lack = FORMS[option]
    found: dict[str, Any] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise SceneError(f"--{option}: {text!r} has no value; allowed: NAME={form}")
        if name in found:
            raise SceneError(f"--{option}: {name!r} is given twice; allowed: every parameter once")
        if not mark:
            found[name] = _number(option, name, value)
            continue
        parts = value.replace("\u00b1", "+-").split(mark)
        if len(parts) != 2:
            raise SceneError(f"--{option}: {name}={value!r} {lack}")
        ends: list[float | None] = []
        for part in parts:
            end = None
            if option != "bounds" or part.strip():
                end = _number(option, name, part)
            ends.append(end)
        found[name] = tuple(ends)
    return found


def _number(option: str, name: str, text: str) -> float:
    """The finite number that an option gives a parameter."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SceneError(f"--{option}: {name}={text!r} is not a finite number; allowed: NAME={FORMS[option][0]}")
    return value


def check_span(args: Namespace) -> None:
    """Reject an end of the samples before their start."""
    if args.since is not None and args.until is not None and args.since >= args.until:
        raise SceneError(f"--until: {args.until:g} is not after --from {args.since:g}; allowed: > {args.since:g} s")
