"""`dropper season SITE.toml`: monthly mussel weight, the floats that carry it, and a schedule of minimum handling."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.markdown import bullets
from dropper_jax.base.read import Table
from dropper_jax.cli.options import add_effects, add_examples, add_json, add_quiet, register_effects
from dropper_jax.cli.outputs import add_folder, add_plot, picture
from dropper_jax.cli.printing import listing, print_result, progress

help = "floats that carry the mussels of each month, and the resulting farm geometry"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "season exposed-bay --report season",
        "season site.toml --plot floats.png",
    )
    parser.add_argument("site", metavar="SITE.toml", help="the site, with [season] and [[growth]]")
    add_folder(parser, "--report", "write season.md, season.csv, season.json and season.png")
    add_plot(parser, "floats and depths by month")
    add_effects(parser)
    add_json(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    from fitting.farm.season import plan_season, write_season
    from fitting.farm.season.report import draw_season
    from fitting.farm.site import read_site

    register_effects(args)
    found = plan_season(read_site(args.site), progress(args.quiet))
    if args.plot is not None:
        draw_season(found, picture(args.plot, "season"))
    if args.report is not None:
        write_season(found, args.report)
        found["out"] = str(args.report)
    return print_result(args, found, text(found))


def text(found: Table) -> str:
    """The result as text."""
    about = (
        "floats: {floats} (needed: {least}, at most {most}), {need_n:.0f} N to carry, "
        "backbone {shallowest_m:.2f} to {deepest_m:.2f} m deep"
    )
    pairs = [(row["month"], about.format_map(row)) for row in found["months"]]
    flags = bullets(found["flags"])
    verdict = "the schedule holds" if found["holds"] else "the schedule does not hold"
    last = f"{verdict}; visits: {found['visits']}, floats moved: {found['handled']}"
    return "\n\n".join(filter(None, (listing(pairs), flags, last)))
