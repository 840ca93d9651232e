"""`dropper library`: ropes, chains, floats and crops, or one of them as TOML to paste into a scene."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.read import Table
from dropper_jax.base.records import select_keys
from dropper_jax.base.toml_text import as_toml
from dropper_jax.cli.options import add_examples, add_json
from dropper_jax.cli.printing import done_object, listing, print_result, record_table

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
    if args.name is None:
        return _list(args)

    from dropper_jax.load.library import FAMILIES, PREFIX, part

    name = args.name.removeprefix(PREFIX)
    section, values = part(name)
    source = FAMILIES[name.rpartition("-")[0]].source
    pasted = {**values, "name": name}
    if section == "point":
        pasted["position"] = [0.0, 0.0, -5.0]
    found = done_object(section=section, part=values, source=source)
    return print_result(args, found, f"# {source}\n{as_toml({section: [pasted]}).rstrip()}")


def _list(args: Namespace) -> int:
    """All families of parts, and the crops."""
    from dropper_jax.load.library import FAMILIES, crop_values, published_crops

    rows = []
    found = []
    for name, f in FAMILIES.items():
        rows.append((f"{name}-{f.example:g}", f"{f.size} {f.low:g} to {f.high:g} {f.unit}. {f.source}"))
        found.append({"family": name, **select_keys(vars(f), ("size", "unit", "low", "high", "source"))})
    crops = crop_values()
    published = published_crops()
    text = f"{listing(rows)}\n\n{record_table(crops, CROPS)}\n\n{_published_table(published)}"
    return print_result(args, done_object(parts=found, crops=crops, published_crops=published), text)


#: The numbers of the crops; their sources are in the list above.
CROPS = {
    "crop": "{name}",
    "mass [kg/m]": "{mass_kg_per_m:.4g}",
    "in water [kg/m]": "{mass_in_water_kg_per_m:.4g}",
    "displaced diameter [m]": "{diameter_m:.4g}",
    "outer diameter [m]": "{outer_diameter_m:.4g}",
    "cdn": "{cdn:.4g}",
    "can": "{can:.4g}",
    "EI [N m^2]": "{EI_n_m2:.4g}",
    "spread": "{spread}",
}
#: Published values, numbered.
PUBLISHED = {
    "published": "{number}. {crop}",
    "mass [kg/m]": "{mass:.4g}",
    "outer diameter [m]": "{outer_diameter:.4g}",
    "cdn": "{cdn:.4g}",
    "can": "{can:.4g}",
    "EI [N m^2]": "{EI:.4g}",
    "like": "{like}",
}


def _published_table(crops: list[Table]) -> str:
    """Published values, numbered, and their sources."""
    rows = []
    sources = []
    for i, crop in enumerate(crops, 1):
        rows.append({"number": i, **crop})
        words = (crop["source"], f"read: {crop['read']}", crop["conditions"])
        sources.append((f"{i}.", "; ".join(filter(None, words))))
    return f"{record_table(rows, PUBLISHED)}\n\n{listing(sources)}"
