"""`dropper scenes`: the packaged scenes."""

from __future__ import annotations

import argparse

from dropper_jax.catalogue import packaged
from dropper_jax.cli.codes import OK
from dropper_jax.cli.options import add_json
from dropper_jax.cli.output import listing, print_json

name = "scenes"
help = "list the packaged scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    found = {scene: table["description"] for scene, table in packaged().items()}
    if args.json:
        scenes = [{"name": scene, "description": text} for scene, text in found.items()]
        print_json({"schema": 1, "status": "ok", "scenes": scenes})
    else:
        print(listing(list(found.items())))
    return OK
