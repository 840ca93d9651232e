"""`dropper new KIND FILE`: write a commented scene to edit."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from importlib import resources
from pathlib import Path

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.cli.options import add_examples, add_flag, add_json
from dropper_jax.cli.outputs import add_file
from dropper_jax.cli.printing import done_object, print_result

help = "write a commented scene to edit: a lab dropper, a longline in a storm, a farm with parameters, growing mussels"

#: Kinds of templates, and options of their first run: equal steps miss the snaps of the storm.
KINDS = {"lab": "", "longline": "--accuracy 0.01 ", "farm": "", "mussels": ""}


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(parser, "new lab my-dropper.toml", "new longline my-longline.toml")
    parser.add_argument("kind", choices=KINDS, metavar="KIND", help=f"what the scene describes: {', '.join(KINDS)}")
    add_file(parser, "file", (".toml",), "the new file, .toml")
    add_flag(parser, "--force", "replace an existing file")
    add_json(parser)


def run(args: Namespace) -> int:
    file: Path = args.file
    if file.exists() and not args.force:
        raise SceneError(f"FILE: {str(file)!r} exists. Use another name, or --force to replace it")
    atomic_write(file, template(args.kind))
    found = done_object(kind=args.kind, file=str(file))
    first_run = f"dropper run {file} {KINDS[args.kind]}--plot pictures"
    return print_result(args, found, f"ok: {file}\nnext: dropper check {file}\n      {first_run}")


def template(kind: str) -> str:
    """The text of a template."""
    return (resources.files("dropper_jax") / "data" / "templates" / f"{kind}.toml").read_text(encoding="utf-8")
