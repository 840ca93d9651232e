"""`dropper fit TRACES.csv... --scene SCENE`: calibrate a scene to measured angles; `DATA.toml`: to any channels."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table
from dropper_jax.cli.given import check_once
from dropper_jax.cli.options import add_allow_outside, add_effects, add_examples, add_set, read_scene
from dropper_jax.cli.outputs import deliver
from dropper_jax.cli.printing import OK, failure_of, listing, print_warnings, progress, table
from fitting.cli.fit_file import assumed_text, fit_files, traces_for
from fitting.cli.fit_options import (
    OF_DATA,
    OF_TRACES,
    add_parameters,
    check_span,
    check_without_scene,
    chosen_loss,
    chosen_method,
    named_values,
    names_toml,
    read_spans,
)

if TYPE_CHECKING:
    from dropper_jax.base.progress import Progress
    from dropper_jax.load.scene import Scene
    from fitting.calibration.result import FitResult
    from fitting.estimate.scene_fit import SceneFit

help = "calibrate a scene to measured angle traces, or to any channels named in a TOML file"


def add_arguments(parser: ArgumentParser) -> None:
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


def run(args: Namespace) -> int:
    spans = read_spans(args.held_out)
    check_span(args)
    check_once(args.traces, "DATA")
    shared: Table = {
        "loss": chosen_loss(args),
        "start": named_values("start", args.start),
        "bounds": named_values("bounds", args.bounds),
        "priors": named_values("prior", args.prior),
    }
    scene = None
    if args.scene is None:
        check_without_scene(args)
    else:
        scene = read_scene(args)
    check_intervals(args, scene)
    if scene is not None and names_toml(args.traces):
        return fit_to_channels(args, scene, shared)
    if args.own:
        raise SceneError("--own: only for channels named in a TOML file. Omit it for traces of angles")
    shared["held_out"] = spans
    return report_angles(args, *fit_to_angles(args, scene, shared))


def report_angles(args: Namespace, result: FitResult, found: Table, about: str) -> int:
    """Write and print a fit to angles; `found` and `about`: what was assumed about the files."""
    if args.report:
        from fitting.report.report import write_report

        write_report(result, args.report)
    if args.plot:
        from fitting.report.report import draw_fit

        draw_fit(result, args.plot)
    print_warnings(result.warnings)
    words = "\n\n".join(filter(None, [about, text(result)]))
    code = deliver(args, result.to_json() | found, words, failure_of(result))

    from fitting.calibration.result import ACCEPTABLE

    if args.accept_misfit and result.status in ACCEPTABLE:
        return OK
    return code


def fit_to_angles(args: Namespace, scene: Scene | None, shared: Table) -> tuple[FitResult, Table, str]:
    """The fit to angles with its judgements, and what was assumed about the files, as plain values and as text.

    Args:
        scene: None: proposed from the first file.
        shared: arguments of `fit` for both kinds of data.
    """
    from fitting.calibration.fit import fit, fit_and_free
    from fitting.windows.fit_settings import FitSettings

    traces = []
    found = {}
    about = ""
    unit = None  # traces of foreign files are in radians
    if scene is not None:
        traces, notes = traces_for(args, scene)
        if notes:
            found = {"assumed": notes}
            about = assumed_text(notes)
        else:
            unit = args.unit
    settings = FitSettings(
        window=args.window,
        dt=args.dt,
        integrator=args.integrator,
        rest=read_spans(args.rest, "--rest"),
        static_start=args.static_start,
        zero=args.zero,
        sign=args.sign,
        unit=unit,
        begin=args.since,
        fixed=args.fixed,
        same_motion=args.same_motion,
    )
    shared = {**shared, "method": chosen_method(args), "until": args.until, "settings": settings}
    say = progress(args.quiet)
    if scene is None:
        result, found, about = fit_files(args, shared, say)
    elif args.auto_free:
        result = fit_and_free(traces, scene, args.free, **shared, progress=say)
    else:
        result = fit(traces, scene, args.free, **shared, progress=say)
    add_judgements(result, args, say)
    result.accepted = args.accept_misfit
    return result, found, about


def check_intervals(args: Namespace, scene: Scene | None) -> None:
    """Reject intervals of parameters that are not free, and a bootstrap of one draw, before anything is fitted.

    Args:
        scene: None: proposed from the file, so that its parameters are not known yet.
    """
    from fitting.estimate.bootstrap import check_draws
    from fitting.parameters.names import default_free, default_rig
    from fitting.parameters.targets import RECORDING

    if args.bootstrap is not None:
        check_draws(args.bootstrap)
    if not args.profile or scene is None:
        return
    free = args.free
    if free is None:
        free = default_free(scene)
        if not args.fixed:
            free = [*free, *default_rig(scene)]
    known = [_full_path(scene, name, "free") for name in (*free, *args.own)]
    for name in args.profile:
        if args.same_motion and name.startswith(f"{RECORDING}."):
            continue  # known once the files are read
        own = name
        if not name.startswith(OF_DATA):
            own = name.partition("@")[0]  # without its run
        full = _full_path(scene, own, "profile")
        if not any(f"{full}.".startswith(f"{one}.") or one.startswith(f"{full}.") for one in known):
            raise SceneError(f"profile: {full!r} is not a free parameter; {nearest(full, known)}")


def _full_path(scene: Scene, name: str, option: str) -> str:
    """The full path of a parameter of the scene, or the name of one of the data."""
    from fitting.parameters.names import full_names

    if name.startswith(OF_DATA):
        return name
    return full_names(scene, [name], option)[0]


def add_intervals(result: SceneFit, args: Namespace, say: Progress) -> None:
    """Intervals by --profile and --bootstrap."""
    from fitting.estimate.bootstrap import bootstrap
    from fitting.estimate.profiles import profiles

    if args.profile is not None:
        result.profiles = profiles(result, args.profile, say)
    if args.bootstrap is not None:
        drawn = bootstrap(result, args.bootstrap)
        result.bootstrap = drawn.draws
        if drawn.warning:
            result.warnings.append(drawn.warning)


def add_judgements(result: FitResult, args: Namespace, say: Progress) -> None:
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


def fit_to_channels(args: Namespace, scene: Scene, shared: Table) -> int:
    """Fit to the channels that a TOML file names."""
    if args.plot:
        raise SceneError("--plot: only for traces of angles. Use --report for channels, which draws every run")
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
    result = fit_channels(
        args.traces[0],
        scene,
        args.free,
        own=args.own,
        **shared,
        iterations=args.iterations,
        progress=say,
    )
    add_intervals(result, args, say)
    say(1.0, result.status)
    if args.report:
        from fitting.report.channel_report import write_channel_report

        write_channel_report(result, args.report)
    print_warnings(result.warnings)
    tables = (parameter_rows(result), interval_rows(result), between_rows(result), channel_rows(result))
    parts = [*(table(rows) for rows in tables if len(rows) > 1), listing(channel_summary(result)), result.outcome]
    return deliver(args, result.to_json(), "\n\n".join(parts), failure_of(result))


def text(result: FitResult) -> str:
    """The result as text."""
    from fitting.laws.decision import verdict
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
