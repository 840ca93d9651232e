"""`dropper fit TRACES.csv... --scene SCENE`: calibrate a scene to measured angles; `DATA.toml`: to any channels."""

from __future__ import annotations

import argparse
import math
import time
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table
from dropper_jax.cli.given import number, output_folder, read_numbers
from dropper_jax.cli.options import (
    add_allow_outside,
    add_effects,
    add_examples,
    add_json,
    add_quiet,
    add_set,
    read_scene,
)
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import OK, failure_of, listing, print_warnings, progress, table
from fitting.cli.fit_file import add_file_options, fit_files, traces_for

if TYPE_CHECKING:
    from dropper_jax.base.errors import Progress
    from dropper_jax.load.scene import Scene
    from fitting.calibration.estimating import Method
    from fitting.calibration.result import FitResult
    from fitting.estimate.loss import Loss
    from fitting.estimate.scene_fit import SceneFit

help = "calibrate a scene to measured angle traces, or to any channels named in a TOML file"

METHODS = ("windows", "shooting", "gradient")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "fit encoder.csv",
        "fit traces.csv --scene my-dropper.toml --free b_l,b_q --held-out 12:16",
    )
    parser.add_argument(
        "traces",
        nargs="+",
        metavar="DATA",
        help="one text file per run: times and angles or points; or one TOML file that names channels",
    )
    parser.add_argument(
        "--scene", help="name of a packaged scene, or a TOML file (default: proposed from the file, in air)"
    )
    add_set(parser)
    add_allow_outside(parser)
    add_effects(parser)
    add_parameters(parser)


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """What is fitted: parameters, their start values, bounds and priors, and the samples."""
    parser.add_argument(
        "--free",
        metavar="NAMES",
        help="parameters, such as b_l,line.0.inertia,release.time (default: those listed in [fit], else damping)",
    )
    parser.add_argument(
        "--fixed", action="store_true", help="without --free and [fit]: keep the lengths and the zero of the angles"
    )
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
        "--own", metavar="NAMES", help="of channels: parameters fitted separately for each run; reports mean and spread"
    )
    parser.add_argument("--from", dest="since", type=number, metavar="T", help="fit only samples from this time on [s]")
    parser.add_argument("--until", type=number, metavar="T", help="fit only samples before this time [s]")
    parser.add_argument("--held-out", metavar="LO:HI,...", help="score these stretches [s] without fitting them")
    parser.add_argument(
        "--rest", metavar="LO:HI,...", help="stretches [s] in which the line is at rest: their poses are fitted too"
    )
    add_method(parser)


def add_method(parser: argparse.ArgumentParser) -> None:
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
    parser.add_argument("--window", type=number, metavar="S", help="length of a window [s] (default: from the motion)")
    parser.add_argument(
        "--dt",
        type=number,
        help="time step [s], at most the samples' interval (default: 1/75 of the shortest link's period)",
    )
    parser.add_argument(
        "--integrator", help="scheme of the windows, such as tsit5 (default: rattle_4 for point masses)"
    )
    add_convention(parser)
    add_file_options(parser)
    parser.add_argument("--huber", type=number, metavar="K", help="robust loss beyond K standard deviations")
    parser.add_argument("--robust", metavar="NAME", help="robust loss by name: huber or student")
    parser.add_argument("--student", action="store_true", help="Student's t loss with 4 degrees, for outliers")
    parser.add_argument(
        "--iterations", type=int, default=40, help="maximum iterations over separate windows (default: 40)"
    )
    parser.add_argument("--static-start", action="store_true", help="release every run at t = 0 as defined in [start]")
    add_judging(parser)


def add_judging(parser: argparse.ArgumentParser) -> None:
    """What judges the result, and where it is written."""
    parser.add_argument("--advice", action="store_true", help="test what else may be wrong: lengths, roll, clock")
    parser.add_argument("--auto-free", action="store_true", help="add free parameters while the fit improves")
    parser.add_argument("--compare-models", action="store_true", help="also fit a ladder of damping laws")
    parser.add_argument(
        "--profile", nargs="?", const="", metavar="NAMES", help="intervals by profile likelihood too (default: of all)"
    )
    parser.add_argument(
        "--bootstrap", nargs="?", const=400, type=int, metavar="DRAWS", help="resample blocks of time (default: 400)"
    )
    parser.add_argument(
        "--accept-misfit",
        action="store_true",
        help="exit code 0 even if the model misses the trace or its law is wrong",
    )
    parser.add_argument("--plot", metavar="DIR", help="write only the pictures of the fit")
    add_out(parser)
    parser.add_argument("--report", metavar="DIR", help="write a report with pictures")
    add_quiet(parser)
    add_json(parser)


def add_convention(parser: argparse.ArgumentParser) -> None:
    """--zero, --sign, --unit, --columns."""
    parser.add_argument("--zero", help="zero direction of the traces' angles: horizontal or down")
    parser.add_argument("--sign", help="1 or -1")
    parser.add_argument("--unit", help="rad or deg")
    parser.add_argument(
        "--columns",
        metavar="NAME=COLUMN,...",
        help="the traces' columns if they have other names, such as time=timestamp,theta_1=angle",
    )


def run(args: argparse.Namespace) -> int:
    spans = held_out_spans(args.held_out)
    free = None if args.free is None else args.free.split(",")
    folder = output_folder(args.report, "--report")
    plot = output_folder(args.plot, "--plot")
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
    _check_numbers(args)
    shared: Table = {
        "loss": chosen_loss(args),
        "start": {key: _number("start", key, text) for key, text in _pairs("start", args.start)},
        "bounds": {key: _bounds(key, text) for key, text in _pairs("bounds", args.bounds)},
        "priors": {key: _prior(key, text) for key, text in _pairs("prior", args.prior)},
    }
    scene = None if args.scene is None else read_scene(args)
    if scene is None:
        check_without_scene(args)
    else:
        check_intervals(args, scene, free)
    if scene is not None and any(name.lower().endswith(".toml") for name in args.traces):
        if plot:
            raise SceneError("--plot: only for traces of angles. Use --report for channels, which draws every run")
        return fit_to_channels(args, scene, free, shared)
    if args.own is not None:
        raise SceneError("--own: only for channels named in a TOML file. Omit it for traces of angles")

    from fitting.calibration.fit import fit, fit_and_free
    from fitting.calibration.preparation import FitSettings
    from fitting.calibration.result import ACCEPTABLE

    traces = []
    found = {}
    about = ""
    if scene is not None:
        traces, notes = traces_for(args, scene)
        if notes:
            found = {"assumed": notes}
            about = "assumed\n" + "\n".join(f"  {note}" for note in notes)
    foreign = scene is None or bool(found)
    settings = FitSettings(
        window=args.window,
        dt=args.dt,
        integrator=args.integrator,
        rest=held_out_spans(args.rest, "--rest"),
        static_start=args.static_start,
        zero=args.zero,
        sign=args.sign,
        unit=None if foreign else args.unit,
        begin=args.since,
        fixed=args.fixed,
        same_motion=args.same_motion,
    )
    shared |= {"method": chosen_method(args), "until": args.until, "held_out": spans, "settings": settings}
    say = progress(args.quiet)
    if scene is None:
        result, found, about = fit_files(args, shared, say)
    else:
        run_fit = fit_and_free if args.auto_free else fit
        result = run_fit(traces, scene, free, **shared, progress=say)
    add_judgements(result, args, say)
    result.accepted = args.accept_misfit
    if folder:
        from fitting.report.report import write_report

        write_report(result, folder)
    if plot:
        from fitting.report.report import draw_fit

        draw_fit(result, plot)
    print_warnings(result.warnings)
    words = "\n\n".join(filter(None, [about, text(result)]))
    code = deliver(args, result.to_json() | found, words, failure_of(result))
    if args.accept_misfit and result.status in ACCEPTABLE:
        return OK
    return code


def check_without_scene(args: argparse.Namespace) -> None:
    """Reject what only a scene can explain.

    Raises:
        SceneError: channels, or options of a scene.
    """
    if any(name.lower().endswith(".toml") for name in args.traces):
        raise SceneError("--scene: missing; channels named in a TOML file need a scene")
    for key in ("set", "static_start", "auto_free", "effects"):
        if getattr(args, key):
            raise SceneError(f"--{key.replace('_', '-')}: only with --scene; the scene of a file is proposed")


def chosen_loss(args: argparse.Namespace) -> Loss:
    """The loss of --huber, --student and --robust."""
    from fitting.estimate.loss import LEAST_SQUARES, Huber, as_loss

    name = "student" if args.student else args.robust
    if name is not None:
        return as_loss(name, "robust")
    if args.huber is None:
        return LEAST_SQUARES
    return Huber(args.huber)


def chosen_method(args: argparse.Namespace) -> Method:
    """The method with its settings.

    Raises:
        SceneError: settings of a descent for another method.
    """
    from fitting.calibration.estimating import Method

    given = {key: getattr(args, key) for key in OF_DESCENT if getattr(args, key) is not None}
    if args.method != "gradient":
        for name, value in sorted(given.items()):
            raise SceneError(f"{name}: {value!r} is not a setting of method {args.method!r}. Use method gradient")
        return Method(args.method, iterations=args.iterations)
    from fitting.estimate.descent import GradientDescent

    return Method("gradient", iterations=args.iterations, descent=GradientDescent(**given))


def check_intervals(args: argparse.Namespace, scene: Scene, free: list[str] | None) -> None:
    """Reject intervals of parameters that are not free, and a bootstrap of one draw, before anything is fitted."""
    from fitting.estimate.scene_fit import check_draws
    from fitting.parameters.names import default_free, default_rig, full_names

    if args.bootstrap is not None:
        check_draws(args.bootstrap)
    if not args.profile:
        return
    own = [] if args.own is None else args.own.split(",")
    if free is None:
        by_default = [*default_free(scene), *([] if args.fixed else default_rig(scene))]
    else:
        by_default = free
    names = [*by_default, *own]
    known = [name if name.startswith(OF_DATA) else full_names(scene, [name])[0] for name in names]
    for name in args.profile.split(","):
        if name.startswith(OF_DATA):
            full = name
        else:
            full = full_names(scene, [name.partition("@")[0]], "profile")[0]
        if not any(f"{full}.".startswith(f"{one}.") or one.startswith(f"{full}.") for one in known):
            raise SceneError(f"profile: {full!r} is not a free parameter; {nearest(full, known)}")


def add_intervals(result: SceneFit, args: argparse.Namespace, say: Progress) -> None:
    """Intervals by --profile and --bootstrap."""
    from fitting.estimate.scene_fit import bootstrap, profiles

    if args.profile is not None:
        names = args.profile.split(",") if args.profile else ()
        result.profiles = profiles(result, names, say)
    if args.bootstrap is not None:
        drawn = bootstrap(result, args.bootstrap)
        result.bootstrap = drawn.draws
        result.warnings += filter(None, [drawn.warning])


def add_judgements(result: FitResult, args: argparse.Namespace, say: Progress) -> None:
    """What else may be wrong, intervals, and the comparison of laws, as requested."""
    from fitting.calibration.advice import advise
    from fitting.calibration.comparison import compare

    if args.advice and not args.auto_free:
        result.add_advice(advise(result))
    add_intervals(result, args, say)
    if args.compare_models:
        started = time.perf_counter()
        result.comparison = compare(result, progress=say)
        result.seconds["run"] += time.perf_counter() - started
    say(1.0, result.status)


#: Beginnings of names of parameters that belong to a file of channels, not to the scene.
OF_DATA = ("start.", "channel.", "camera.")
#: Options of `--method gradient`.
OF_DESCENT = ("optimizer", "learning_rate", "steps")
#: Options without a meaning in a fit to channels, and their values if not given.
OF_TRACES = {
    **dict.fromkeys(
        (
            *("since", "until", "held_out", "window", "zero", "sign", "unit", "columns", "rest"),
            *OF_DESCENT,
        )
    ),
    **dict.fromkeys(("rate", "counts", "lengths", "mass")),
    **dict.fromkeys(
        (*("static_start", "fixed", "advice", "auto_free", "compare_models", "accept_misfit"), "same_motion"), False
    ),
    "method": "shooting",
}


def fit_to_channels(args: argparse.Namespace, scene: Scene, free: list[str] | None, shared: Table) -> int:
    """Fit to the channels that a TOML file names."""
    for key, default in OF_TRACES.items():
        if getattr(args, key) != default:
            raise SceneError(
                f"--{key.replace('_', '-').replace('since', 'from')}: only for traces of angles. Omit it for channels"
            )
    if len(args.traces) > 1:
        raise SceneError(f"DATA: {len(args.traces)} files; allowed: one TOML file, which lists its runs")

    from fitting.channels.fit import fit_channels
    from fitting.report.channel_tables import between_rows, channel_rows, channel_summary
    from fitting.report.tables import interval_rows, parameter_rows

    changed = {"run.dt": args.dt, "run.integrator": args.integrator}
    scene = scene.with_values({key: value for key, value in changed.items() if value is not None})
    say = progress(args.quiet)
    own = []
    if args.own is not None:
        own = args.own.split(",")
    result = fit_channels(
        args.traces[0],
        scene,
        free,
        own=own,
        **shared,
        iterations=args.iterations,
        progress=say,
    )
    add_intervals(result, args, say)
    say(1.0, result.status)
    if args.report:
        from fitting.report.report import write_channel_report

        write_channel_report(result, args.report)
    print_warnings(result.warnings)
    tables = (parameter_rows(result), interval_rows(result), between_rows(result), channel_rows(result))
    parts = [*(table(rows) for rows in tables if len(rows) > 1), listing(channel_summary(result)), result.outcome]
    return deliver(args, result.to_json(), "\n\n".join(parts), failure_of(result))


def held_out_spans(text: str | None, option: str = "--held-out") -> list[tuple[float, float]]:
    """Spans [s] of `lo:hi,lo:hi`."""
    reason = "is not lo:hi; allowed: spans in s such as 40:45,45:50"
    parts = filter(None, (text or "").split(","))
    return [tuple(read_numbers(part, option, reason, ":", 2)) for part in parts]


def _pairs(option: str, texts: list[str]) -> list[tuple[str, str]]:
    """Names and texts of several `NAME=TEXT`."""
    found = []
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise SceneError(f"--{option}: {text!r} has no value; allowed: NAME={ALLOWED[option]}")
        if name in [known for known, _ in found]:
            raise SceneError(f"--{option}: {name!r} is given twice; allowed: every parameter once")
        found.append((name, value))
    return found


#: Form of the text after the name.
ALLOWED = {"start": "VALUE", "bounds": "LOW:HIGH", "prior": "MEAN+-SD"}


def _number(option: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SceneError(f"--{option}: {name}={text!r} is not a finite number; allowed: NAME={ALLOWED[option]}")
    return value


def _bounds(name: str, text: str) -> tuple[float | None, float | None]:
    """Ends of `LOW:HIGH`; an omitted one keeps the value declared by the scene's fields."""
    low, colon, high = text.partition(":")
    if not colon:
        raise SceneError(f"--bounds: {name}={text!r} is not a range; allowed: NAME=LOW:HIGH, one end may be omitted")
    return tuple(_number("bounds", name, end) if end.strip() else None for end in (low, high))


def _prior(name: str, text: str) -> tuple[float, float]:
    mean, sign, width = text.replace("\u00b1", "+-").partition("+-")
    if not sign:
        raise SceneError(f"--prior: {name}={text!r} has no width; allowed: NAME=MEAN+-SD")
    return _number("prior", name, mean), _number("prior", name, width)


def _check_numbers(args: argparse.Namespace) -> None:
    for key in ("until", "window", "dt", "huber", "iterations", "bootstrap"):
        value = getattr(args, key)
        if value is not None and not value > 0:
            unit = " s" if key in ("until", "window", "dt") else ""
            raise SceneError(f"--{key}: {value:g} is not positive; allowed: > 0{unit}")


def text(result: FitResult) -> str:
    """The result as text."""
    from fitting.calibration.decision import verdict
    from fitting.report.tables import (
        advice_rows,
        comparison_rows,
        interval_rows,
        law_rows,
        parameter_rows,
        recording_rows,
        summary,
    )

    parts = [table(parameter_rows(result)), listing(summary(result))]
    if result.recordings:
        parts.append(table(recording_rows(result.recordings)))
    if len(rows := interval_rows(result)) > 1:
        parts.append(table(rows))
    if result.freed:
        parts.append("freed: " + "; ".join(candidate.name for candidate in result.freed))
    if result.advice:
        parts += [table(law_rows(result.laws)), table(advice_rows(result.advice))]
    if result.comparison:
        parts += [table(comparison_rows(result.comparison)), f"law: {verdict(result.comparison)}"]
    # the reason of a failure follows as the error line
    return "\n\n".join([*parts, result.status])
