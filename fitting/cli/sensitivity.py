"""`dropper sensitivity SCENE --of QUANTITY --to NAMES`: local and global sensitivity of a quantity to parameters."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.given import read_named_range, split_names, values_by_name
from dropper_jax.cli.options import (
    QUANTITY_HELP,
    add_flag,
    add_quiet,
    add_run_values,
    add_scene,
    read_scene,
)
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import done_object, print_warnings, progress

help = "sensitivity of a quantity to parameters: derivatives, Sobol indices, Morris screening"

#: Size of a global study that states none.
DEFAULT_SAMPLES = 64
#: Options that set a value of the scene.
OVERRIDES = ("integrator", "dt", "duration")


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "sensitivity dropper-release-a --duration 1 --of tension.max --to b_l,b_q",
        "sensitivity paper-case-4 --of anchor.anchor.horizontal.start --to line.chain.length,sea.current.speed",
    )
    parser.add_argument("--of", required=True, metavar="QUANTITY", help=QUANTITY_HELP)
    parser.add_argument(
        "--to", type=split_names, required=True, metavar="NAMES", help="parameters, such as b_l,b_q,line.0.mass"
    )
    parser.add_argument("--global", dest="method", choices=("sobol", "morris"), help="indices over ranges instead")
    parser.add_argument(
        "--range",
        action="append",
        default=[],
        metavar="NAME=LO:HI",
        help="range of a parameter (default: +-20 %%)",
    )
    parser.add_argument("--samples", type=int, help=f"size of a global study (default: {DEFAULT_SAMPLES})")
    parser.add_argument("--seed", type=int, help="of a global study (default: 0)")
    add_flag(parser, "--check", "also compute derivatives by reverse mode, and the growth of errors")
    add_plot(parser, "a tornado picture")
    add_out(parser)
    add_run_values(parser, OVERRIDES)
    add_quiet(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args, OVERRIDES)
    check_global_options(args)

    from fitting import sensitivity
    from fitting.sensitivity.texts import global_text, local_text

    problem = sensitivity.study(scene, args.of, args.to)
    say = progress(args.quiet)
    ranges = None
    if args.method:
        ranges = sensitivity.parameter_ranges(problem, values_by_name(map(_read_range, args.range), "--range"))
        samples = DEFAULT_SAMPLES if args.samples is None else args.samples
        found = sensitivity.global_indices(problem.batch, problem.names, ranges, args.method, samples, args.seed or 0)
        text = global_text(found, args.of)
    else:
        found = sensitivity.local_derivatives(problem, say, args.check)
        text = local_text(found)
    if args.plot and found.finite:
        from fitting.sensitivity.tornado import global_picture, local_picture

        if isinstance(found, sensitivity.GlobalIndices):
            global_picture(found, args.of, picture(args.plot, "tornado"))
        else:
            local_picture(found, picture(args.plot, "tornado"))
    verdict = sensitivity.check_step(problem, ranges, say)
    warnings = [*found.warnings, *verdict.warnings]
    print_warnings(warnings)
    failure = verdict.failure
    if not found.finite:
        failure = "not_converged", f"{args.of}: a step of the run failed; see `dropper run`"
    whole = {**done_object(of=args.of), **found.to_json(), "warnings": warnings}
    return deliver(args, whole, text, failure)


def check_global_options(args: Namespace) -> None:
    """Reject options that the method does not use, and samples that are too few."""
    if args.method is None:
        for option, value in (("--range", args.range or None), ("--samples", args.samples), ("--seed", args.seed)):
            if value is not None:
                raise SceneError(f"{option}: requires --global sobol or morris")
    elif args.check:
        raise SceneError(f"--check: derivatives are not part of --global {args.method}. Leave one of them out")
    if args.samples is not None and args.samples < 2:
        raise SceneError(f"--samples: {args.samples}; allowed: a whole number >= 2")


def _read_range(text: str) -> tuple[str, tuple[float, float]]:
    name, low, high = read_named_range(text, "--range", "is not NAME=LO:HI; allowed: such as b_l=0.001:0.004")
    return name, (low, high)
