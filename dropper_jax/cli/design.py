"""`dropper design SCENE`: solve for values that give static quantities their required values."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.read import Table
from dropper_jax.cli.given import number, read_named_range
from dropper_jax.cli.options import add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import done_object, failure_of, listing, progress

help = "solve for values of the scene that give static tensions, angles, depths or periods their required values"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "design paper-case-4 --vary line.chain.length=51:52 --target tension.chain.last --value 3730",
        "design my-longline.toml --vary line.west-leg.length=37:39 --target anchor.west-anchor.horizontal --value 2450 "
        "--vary line.east-leg.length=37:39 --target x.west-float --value 0.2",
    )
    parser.add_argument(
        "--vary",
        required=True,
        action="append",
        metavar="PATH=LOW:HIGH",
        help="a value to solve for and its range, such as line.0.EA=1e5:1e7; once for each target",
    )
    parser.add_argument(
        "--target",
        required=True,
        action="append",
        metavar="WHAT",
        help="a quantity of the static pose: tension.LINE.fairlead, .first, .last or .max [N], "
        "anchor.POINT.horizontal [N], anchor.POINT.uplift or line.LINE.fairlead.angle [rad], depth.POINT or "
        "offset.POINT [m], period.1 [s]; as for `dropper sensitivity --of`, no statistic",
    )
    parser.add_argument(
        "--value",
        required=True,
        action="append",
        type=number,
        help="the required value of the target, in the same order",
    )
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    reason = "is not PATH=LOW:HIGH. Use for example line.0.length=4.0:4.5"
    ranges = [read_named_range(text, "--vary", reason) for text in args.vary]
    scene = read_scene(args)

    from dropper_jax.study.design import solve_design

    paths, low, high = zip(*ranges, strict=True)
    found = solve_design(scene, paths, low, high, args.target, args.value, progress(args.quiet))
    values = [{"path": path, "value": value} for path, value in found.values.items()]
    targets = [
        {"target": name, "required": goal, "reached": reached} for name, (goal, reached) in found.targets.items()
    ]
    more: Table = {**values[0], **targets[0], "solves": found.solves, "values": values, "targets": targets}
    text = [(path, f"{value:.9g}") for path, value in found.values.items()]
    text += [(row["target"], "{reached:.9g}, required {required:g}".format(**row)) for row in targets]
    text.append(("static poses", str(found.solves)))
    if found.end_forces is not None and found.end_angles is not None:
        more |= {"end_forces_n": list(found.end_forces), "end_angles_deg": list(found.end_angles)}
        text.append(("forces on the line's end points", "{:.6g} N and {:.6g} N".format(*found.end_forces)))
        text.append(("angles of the line there, upwards", "{:.2f} and {:.2f} deg".format(*found.end_angles)))
    return deliver(args, done_object(scene=scene.name, **more), listing(text), failure_of(found))
