"""`dropper sweep SCENE --vary name=lo:hi:n --out sweep.zarr`: every combination of values, in batches, resumable.

With `--trace FILE.csv` every case has a score against measured angles.
"""

from __future__ import annotations

import os
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import available_cores
from dropper_jax.base.read import ScenePath, Table
from dropper_jax.cli.given import read_numbers, read_spaced, split_names, values_by_name
from dropper_jax.cli.options import add_flag, add_quiet, add_run_values, add_scene, read_scene
from dropper_jax.cli.outputs import add_folder
from dropper_jax.cli.printing import print_line, print_result, print_warnings, progress
from fitting.cli.fit_file import column_names
from fitting.cli.fit_options import add_convention
from fitting.cli.sweep_text import MOST_ROWS, result_table, text

if TYPE_CHECKING:
    import numpy as np

    from dropper_jax.load.scene import Scene
    from fitting.sweep.run import SweepResult
    from fitting.sweep.scores import FittedScore, TraceScores

help = "run a grid of cases in batches and keep the results in a Zarr folder"

#: Options that set a value of the scene.
OVERRIDES = ("integrator", "solver", "dt", "duration", "dtype")
#: Quantities of `fitting.sweep`, which imports JAX.
DEFAULT_QUANTITIES = ("tension_max", "tension_mean", "tension_min", "angle_max", "excursion", "energy_final")
#: Tables of a scene whose values cannot be parameters of a fit.
NOT_FITTED = ("start", "point", "sea")
#: Cases of a device at a time, with a trace.
CHUNK_WITH_TRACE = 8
HOST_COUNT = "xla_force_host_platform_device_count"
SPACINGS = {"linear": "linspace", "log": "geomspace"}
#: Maximum number of values of one path.
MOST_VALUES = 10_000_000
NOT_VALUES = "is not NAME=LO:HI:N; allowed: N >= 1; also NAME=LO:HI:N:log with LO > 0 and NAME=A,B,C"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "sweep dropper-release-a --vary b_l=0.001:0.01:8 --duration 5 --out sweep.zarr",
        "sweep my-longline.toml --vary sea.current.speed=0:1:5 --vary sea.waves.hs=1,2,3 "
        "--duration 60 --quantities tension.west-leg.fairlead.max --out sea.zarr",
    )
    vary = "values of a path, lo:hi:n, lo:hi:n:log or a,b,c (may be given several times)"
    parser.add_argument("--vary", action="append", default=[], metavar="NAME=LO:HI:N", help=vary)
    add_flag(parser, "--paired", "pair values row by row instead of combining them in a grid")
    parser.add_argument("--seeds", type=int, default=0, metavar="K", help="K realisations of a random sea")
    parser.add_argument("--out", required=True, metavar="FOLDER.zarr", help="results; an existing part is resumed")
    add_folder(parser, "--plot", "write a picture of every quantity over the varied inputs")
    parser.add_argument(
        "--quantities",
        type=split_names,
        metavar="NAMES",
        help=f"quantities to save: {', '.join(DEFAULT_QUANTITIES)} (default: all; with --trace none), or by "
        "name as for `dropper sensitivity --of`, such as tension.west-leg.fairlead.max",
    )
    add_flag(parser, "--traces", "also save positions and tensions at every saved time")
    parser.add_argument(
        "--trace", metavar="FILE.csv", help="measured angles: every case runs over their span and gets a score"
    )
    parser.add_argument(
        "--parts", metavar="T1,T2", help="with --trace: end times of head and middle [s] (default: 24 %% and 50 %%)"
    )
    add_flag(parser, "--fit", "with --trace: also fit the varied inputs to it, like `dropper fit`")
    add_convention(parser)
    parser.add_argument(
        "--chunk",
        type=int,
        help="cases of a device at a time (default: 64; of a system of lines 1; on a GPU 16384, 256; with --trace 8)",
    )
    parser.add_argument("--devices", type=int, help="devices of this machine (default: one per core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the chunks")
    add_flag(parser, "--mix-versions", "resume a part made with other versions of JAX or dropper-jax")
    add_run_values(parser, OVERRIDES)
    add_quiet(parser)


def run(args: Namespace) -> int:
    vary = values_by_name(map(_read_vary, args.vary), "--vary")
    _check_options(args, vary)
    parts = _read_parts(args)
    use_cores(args.devices)
    scene = read_scene(args, OVERRIDES)

    from fitting.sweep import SweepStopped, sweep

    options = _sweep_options(args)
    scores = None
    fitted = None
    try:
        if args.trace:
            scores = _sweep_against_trace(args, scene, vary, parts, options)
            result = scores.sweep
        else:
            result = sweep(scene, vary, args.out, traces=args.traces, **options)
    except SweepStopped as error:
        return print_result(args, {}, failure=("interrupted", str(error)))
    if scores and args.fit:
        fitted = _fit_inputs(args, scene, scores)
    if args.plot:
        _draw_pictures(args.plot, result, scores, fitted)
    return _print_sweep(args, scene, result, scores, fitted)


def _check_options(args: Namespace, vary: Iterable[str]) -> None:
    """Reject options before JAX is imported; `vary` are the varied paths."""
    if args.seeds < 0:
        raise SceneError(f"--seeds: {args.seeds}; allowed: a whole number >= 0")
    out = Path(args.out)
    if out.suffix not in ("", ".zarr") and not out.is_dir():
        raise SceneError(f"--out: {args.out!r} has no known suffix; allowed: .zarr, or a folder without suffix")
    if not out.parent.is_dir():
        raise SceneError(f"--out: the folder {str(out.parent)!r} does not exist; allowed: an existing one")
    for path in vary:
        if args.fit and ScenePath(path).section in NOT_FITTED:
            raise SceneError(f"--fit: {path!r} cannot be fitted; allowed: parameters of the line, such as b_l, b_q")


def _draw_pictures(folder: Path, result: SweepResult, scores: TraceScores | None, fitted: FittedScore | None) -> None:
    """Pictures of a sweep."""
    from fitting.sweep.pictures import draw_sweep
    from fitting.sweep.trace_pictures import draw_against_trace

    if scores:
        draw_against_trace(scores, folder, fitted)
    if not scores or result.plan.quantities:
        draw_sweep(result.path, folder)


def _print_sweep(
    args: Namespace, scene: Scene, result: SweepResult, scores: TraceScores | None, fitted: FittedScore | None
) -> int:
    """Print a sweep, with its scores against a trace and the fit; returns the exit code."""
    warnings = list(result.verdict.warnings)
    if scores:
        warnings = [*scores.warnings, *warnings]
    print_warnings(warnings)
    found = _result_object(scene, result, warnings)
    if scores:
        found["trace"] = scores.to_json()
    if fitted:
        found["trace"]["fit"] = fitted.to_json()
    results = ""
    if not args.json and not args.traces and result.cases <= MOST_ROWS and result.plan.quantities:
        results = result_table(result.path)
    return print_result(args, found, text(found, results), result.verdict.failure)


def _sweep_options(args: Namespace) -> Table:
    """Options of a sweep with and without a trace."""
    quantities = args.quantities
    chunk = args.chunk
    if args.trace:
        quantities = quantities or []
        chunk = CHUNK_WITH_TRACE if chunk is None else chunk
    return {
        "seeds": args.seeds,
        "quantities": quantities,
        "chunk": chunk,
        "scheduler": args.scheduler,
        "mix_versions": args.mix_versions,
        "listed": args.paired,
        "progress": progress(args.quiet),
    }


def _sweep_against_trace(
    args: Namespace, scene: Scene, vary: dict[str, np.ndarray], parts: list[float] | None, options: Table
) -> TraceScores:
    """The sweep with a score of every case against the trace."""
    from fitting.sweep import sweep_against_trace
    from fitting.traces.trace import convention

    return sweep_against_trace(
        scene,
        vary,
        args.trace,
        args.out,
        parts=parts,
        integrator=args.integrator,
        until=args.duration,
        convention=convention(args.zero, args.sign, args.unit),
        columns=column_names(args.columns),
        **options,
    )


def _result_object(scene: Scene, result: SweepResult, warnings: list[str]) -> Table:
    """The result as plain values."""
    failed = sum(count for status, count in result.counts.items() if status not in ("ok", "pending"))
    return {
        "schema": 1,
        "status": result.verdict.status,
        "scene": scene.name,
        "out": str(result.path),
        "cases": result.cases,
        "resumed": result.resumed,
        "failed": failed,
        "counts": result.counts,
        "steps_per_case": result.steps,
        "compile_s": result.compile_s,
        "run_s": result.run_s,
        "steps_per_s": result.steps_per_s,
        "warnings": warnings,
    }


def _read_parts(args: Namespace) -> list[float] | None:
    """Times of `--parts`; options that need a trace are rejected without one."""
    for option in ("parts", "fit", "zero", "sign", "unit", "columns"):
        if getattr(args, option) and not args.trace:
            raise SceneError(f"--{option}: requires --trace FILE.csv")
    if args.parts is None:
        return None
    return read_numbers(args.parts, "--parts", "is not T1,T2; allowed: two times in s, such as 12,25")


def _fit_inputs(args: Namespace, scene: Scene, scores: TraceScores) -> FittedScore:
    """The fit of the varied inputs to the same trace, and one run at its values."""
    from fitting.calibration.fit import fit
    from fitting.sweep.scores import FittedScore
    from fitting.windows.fit_settings import FitSettings

    settings = FitSettings(zero=args.zero, sign=args.sign, unit=args.unit, columns=column_names(args.columns))
    say = progress(args.quiet)
    result = fit(args.trace, scene, list(scores.paths), until=args.duration, settings=settings, progress=say)
    print_warnings(result.warnings)
    return FittedScore.of(scores, result.status, result.values, result.uncertainty.std_error)


def use_cores(count: int | None) -> None:
    """One host device per core, unless the environment sets the number; JAX must not have been initialised."""
    if HOST_COUNT in os.environ.get("XLA_FLAGS", ""):
        return
    if count is not None and count < 1:
        raise SceneError(f"--devices: {count}; allowed: a whole number >= 1")
    import jax

    try:
        jax.config.update("jax_num_cpu_devices", count or available_cores())
    except RuntimeError:  # JAX is already initialised in this process: the existing devices are used
        print_line("warning: JAX is already initialised; the number of devices is unchanged")


def _read_vary(option: str) -> tuple[str, np.ndarray]:
    """Path and values of `NAME=LO:HI:N[:log]`, or of `NAME=A,B,C`, of which whole numbers stay whole."""
    import numpy as np

    path, _, text = option.partition("=")
    path = path.strip()
    if not path:
        raise SceneError(f"--vary: {option!r} {NOT_VALUES}")
    if ":" not in text:
        numbers = read_numbers(text, "--vary", NOT_VALUES, given=option)
        whole = all(word.strip().lstrip("+-").isdecimal() for word in text.split(","))
        if whole:
            return path, np.array(numbers, int)
        return path, np.array(numbers, float)
    limits, _, spacing = text.rpartition(":")
    if spacing not in SPACINGS:
        limits = text
        spacing = "linear"
    low, high, count = read_spaced(limits, "--vary", NOT_VALUES, option)
    if count > MOST_VALUES:
        raise SceneError(f"--vary: {path} has {count} values; allowed: at most {MOST_VALUES}")
    if spacing == "log" and low * high <= 0.0:
        raise SceneError(f"--vary: {option!r} {NOT_VALUES}")
    values = getattr(np, SPACINGS[spacing])(low, high, count)
    # a parameter may be a count, which takes whole numbers only
    if ScenePath(path).section == "parameters" and np.array_equal(values, np.round(values)):
        values = values.astype(int)
    return path, values
