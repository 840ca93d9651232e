"""`dropper growth SCENE`: mussels on its lines, by month and depth."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.markdown import first_names
from dropper_jax.cli.given import number
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import done_object, record_table

help = "mussels of a scene by month and depth: mass, diameter, wet weight"

COLUMNS = {
    "line": "{line}",
    "month": "{month:g}",
    "depth [m]": "{depth_m:g}",
    "layer [m]": "{thickness_m:.4g}",
    "diameter [m]": "{diameter_m:.4g}",
    "mass [kg/m]": "{mass_kg_per_m:.4g}",
    "wet weight [N/m]": "{wet_weight_n_per_m:.4g}",
}


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "growth my-mussels.toml --months 6 12", "growth my-mussels.toml --plot growth.png")
    parser.add_argument(
        "--months", nargs="+", type=number, metavar="MONTH", help="months (default: those of the scene)"
    )
    add_plot(parser, "layer and wet weight over depth")
    add_out(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args)

    from dropper_jax.modelling.growth import season_table

    rows = season_table(scene, args.months)
    text = record_table(({"line": first_names(row["lines"], 1), **row} for row in rows), COLUMNS)
    if args.plot:
        from dropper_jax.study.mussels_picture import draw_mussels

        draw_mussels(scene.name, rows, picture(args.plot, "growth"))
    return deliver(args, done_object(scene=scene.name, growth=rows), text)
