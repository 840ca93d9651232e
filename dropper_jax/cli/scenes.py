"""`dropper scenes`: the packaged scenes, or one scene as TOML."""

from __future__ import annotations

import argparse

from dropper_jax.catalogue import packaged, read_toml
from dropper_jax.cli.codes import OK
from dropper_jax.cli.options import add_json
from dropper_jax.cli.output import listing, print_json
from dropper_jax.toml_text import as_toml

name = "scenes"
help = "list the packaged scenes, or print one as TOML to edit"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scene", nargs="?", metavar="SCENE", help="print this scene as TOML: a packaged one, or a MoorDyn input"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    if args.scene is not None:
        return _one(args)
    found = {scene: table["description"] for scene, table in packaged().items()}
    if args.json:
        scenes = [{"name": scene, "description": text} for scene, text in found.items()]
        print_json({"schema": 1, "status": "ok", "scenes": scenes})
    else:
        print(listing(list(found.items())))
    return OK


def _one(args: argparse.Namespace) -> int:
    """The values of one scene, checked."""
    from dropper_jax.scene import Scene

    table, label = read_toml(args.scene)
    table = {"name": label, **table}
    Scene.from_dict(table)
    if args.json:
        print_json({"schema": 1, "status": "ok", "name": table["name"], "scene": table})
    else:
        print(as_toml(table), end="")
    return OK
