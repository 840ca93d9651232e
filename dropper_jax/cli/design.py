"""`dropper design SCENE`: solve for the value that gives a required static tension or depth."""

from __future__ import annotations

import argparse

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.options import add_examples, add_scene, done_object, listing, number, read_scene
from dropper_jax.cli.outputs import add_out, deliver, out_file

help = "solve for a value of the scene that gives a required static tension or depth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "design paper-case-4 --vary line.chain.length=51:52 --target tension.chain.last --value 3730",
        "design my-longline.toml --vary line.west-leg.length=37:39 --target anchor.west-anchor.horizontal --value 2200",
    )
    add_scene(parser)
    parser.add_argument(
        "--vary",
        required=True,
        metavar="PATH=LOW:HIGH",
        help="the value to solve for and its range, such as line.0.EA=1e5:1e7",
    )
    parser.add_argument(
        "--target",
        required=True,
        metavar="WHAT",
        help="a quantity of the static pose: tension.LINE.fairlead, .first, .last or .max [N], "
        "anchor.POINT.horizontal [N], depth.POINT or offset.POINT [m]; as for `dropper sensitivity --of`, no statistic",
    )
    parser.add_argument("--value", required=True, type=number, help="the required value of the target")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    path, equals, limits = args.vary.partition("=")
    try:
        low, high = (float(x) for x in limits.split(":"))
    except ValueError:
        raise SceneError(f"--vary: {args.vary!r} is not PATH=LOW:HIGH. Use for example line.0.length=4.0:4.5") from None
    out = out_file(args.out)
    scene = read_scene(args)

    from dropper_jax.study.offsets import solve_design

    found = solve_design(scene, path.strip(), low, high, args.target, args.value)
    values = {"path": found.path, "value": found.value, "target": found.target}
    more = {"required": found.requested, "reached": found.reached, "solves": found.solves}
    text = [
        (found.path, f"{found.value:.9g}"),
        (found.target, f"{found.reached:.9g}, required {found.requested:g}"),
        ("static poses", str(found.solves)),
    ]
    if found.end_forces is not None:
        more["end_forces_n"] = list(found.end_forces)
        text.append(("forces on the line's end points", "{:.6g} N and {:.6g} N".format(*found.end_forces)))
    return deliver(args.json, done_object(scene=scene.name, **values, **more), listing(text), out)
