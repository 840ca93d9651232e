"""`dropper library`: ropes, chains, floats and crops, or one of them as TOML to paste into a scene."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from operator import itemgetter

from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import as_toml
from dropper_jax.cli.options import add_examples, add_json
from dropper_jax.cli.printing import OK, done_object, listing, print_json, print_result, table

help = "list ropes, chains, floats and crops, or print one as TOML to paste"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "library",
        "library chain-studlink-0.022",
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="print this part, given by family and size: chain-studlink-0.022"
    )
    add_json(parser)


def run(args: Namespace) -> int:
    from dropper_jax.load.library import FAMILIES, PREFIX, crop_values, part, published_crops

    if args.name is None:
        rows = [
            (f"{name}-{f.example:g}", f"{f.size} {f.low:g} to {f.high:g} {f.unit}. {f.source}")
            for name, f in FAMILIES.items()
        ]
        found = [
            {"family": name, "size": f.size, "unit": f.unit, "low": f.low, "high": f.high, "source": f.source}
            for name, f in FAMILIES.items()
        ]
        crops = crop_values()
        published = published_crops()
        text = f"{listing(rows)}\n\n{_crops(crops)}\n\n{_published_table(published)}"
        return print_result(args, done_object(parts=found, crops=crops, published_crops=published), text)
    name = args.name.removeprefix(PREFIX)
    section, values = part(name)
    source = FAMILIES[name.rpartition("-")[0]].source
    if args.json:
        print_json(done_object(section=section, part=values, source=source))
        return OK
    pasted = {**values, "name": name}
    position = {}
    if section == "point":
        position = {"position": [0.0, 0.0, -5.0]}
    print(f"# {source}\n{as_toml({section: [{**pasted, **position}]})}", end="")
    return OK


def _crops(crops: list[Table]) -> str:
    """The numbers of the crops; their sources are in the list above."""
    heads = ("mass [kg/m]", "in water [kg/m]", "displaced diameter [m]", "outer diameter [m]", "cdn", "can")
    keys = ("mass_kg_per_m", "mass_in_water_kg_per_m", "diameter_m", "outer_diameter_m", "cdn", "can", "EI_n_m2")
    rows = ((crop["name"], *cells(itemgetter(*keys)(crop), ".4g"), crop["spread"]) for crop in crops)
    return table([("crop", *heads, "EI [N m^2]", "spread"), *rows])


def _published_table(crops: list[Table]) -> str:
    """Published values, numbered, and their sources."""
    rows: list[tuple[str, ...]] = [
        ("published", "mass [kg/m]", "outer diameter [m]", "cdn", "can", "EI [N m^2]", "like")
    ]
    keys = ("mass", "outer_diameter", "cdn", "can", "EI")
    for i, crop in enumerate(crops, 1):
        rows.append((f"{i}. {crop['crop']}", *cells(itemgetter(*keys)(crop), ".4g"), crop["like"]))
    sources = []
    for i, crop in enumerate(crops, 1):
        sources.append(
            (f"{i}.", "; ".join(filter(None, (crop["source"], f"read: {crop['read']}", crop["conditions"]))))
        )
    return f"{table(rows)}\n\n{listing(sources)}"
