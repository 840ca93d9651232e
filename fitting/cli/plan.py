"""`dropper plan SCENE... --free NAMES`: which release, duration and camera determine the parameters best."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.cli.given import number, read_numbers, split_names
from dropper_jax.cli.options import add_effects, add_examples, add_json, add_quiet, register_effects
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import progress, table

help = "plan an experiment: which release, duration and camera determine the parameters best"

NOT_NUMBERS = "is not a list of numbers; allowed: such as 8,16,48"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "plan dropper-release-a --free b_l,b_q",
        "plan dropper-release-a dropper-release-b --free b_l,b_q --duration 8,16 --noise 0.005,0.01",
    )
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="packaged names or TOML files, released differently")
    parser.add_argument(
        "--free", type=split_names, required=True, metavar="NAMES", help="parameters that the fit would free"
    )
    parser.add_argument(
        "--for", dest="wanted", type=split_names, metavar="NAMES", help="parameters to rank by (default: all)"
    )
    parser.add_argument("--duration", default="8,16,48", metavar="S,...", help="of the traces [s] (default: 8,16,48)")
    parser.add_argument("--noise", default="0.005", metavar="RAD,...", help="of the angles [rad] (default: 0.005)")
    parser.add_argument("--rate", type=number, default=60.0, metavar="HZ", help="frames per second (default: 60)")
    parser.add_argument(
        "--gap-weight",
        type=number,
        metavar="W",
        help="model error of the rig, as a fit reports it (default: the value expected for a correct model)",
    )
    add_out(parser)
    add_quiet(parser)
    add_effects(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    from fitting.calibration.measurement_plan import plan, rows

    register_effects(args)
    found = plan(
        args.scenes,
        args.free,
        durations=read_numbers(args.duration, "--duration", NOT_NUMBERS),
        noises=read_numbers(args.noise, "--noise", NOT_NUMBERS),
        requested=args.wanted,
        gap_weight=args.gap_weight,
        rate=args.rate,
        progress=progress(args.quiet),
    )
    return deliver(
        args,
        {"status": "ok", "plans": found},
        f"{table(rows(found))}\n"
        "standard errors in the parameters' units; times the best: their geometric mean relative to the first row",
    )
