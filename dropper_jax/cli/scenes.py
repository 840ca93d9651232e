"""`dropper scenes`: the packaged scenes, or one scene as TOML."""

from __future__ import annotations

import argparse

from dropper_jax.base.errors import SceneError
from dropper_jax.base.toml_text import as_toml
from dropper_jax.cli.codes import OK
from dropper_jax.cli.options import SET_HELP, add_json, assignments, number, output_file
from dropper_jax.cli.output import listing, print_json, print_line
from dropper_jax.load.packaged import packaged
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import read_toml

name = "scenes"
help = "list the packaged scenes, or print one as TOML to edit"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scene", nargs="?", metavar="SCENE", help="print this scene as TOML: a packaged one, or a MoorDyn input"
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=SET_HELP)
    parser.add_argument("--moordyn", metavar="FILE", help="write the scene as a MoorDyn v2 input instead")
    parser.add_argument("--dt", type=number, help="MoorDyn's time step [s], else the scene's: its schemes are explicit")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    if args.scene is not None:
        return _one(args)
    for option, given in (("--set", args.set), ("--moordyn", args.moordyn), ("--dt", args.dt)):
        if given:
            raise SceneError(f"{option}: needs a scene; allowed: dropper scenes SCENE {option} ...")
    found = {scene: table["description"] for scene, table in packaged().items()}
    if args.json:
        scenes = [{"name": scene, "description": text} for scene, text in found.items()]
        print_json({"schema": 1, "status": "ok", "scenes": scenes})
    else:
        print(listing(list(found.items())))
    return OK


def _one(args: argparse.Namespace) -> int:
    """The values of one scene, checked, as TOML or in a MoorDyn file."""
    from dropper_jax.load.scene import Scene

    table, label = read_toml(args.scene)
    table = {"name": label, **table}
    scene = Scene.from_dict(table)
    if args.set:
        scene = scene.with_values(assignments(args.set))
        table = scene.as_written()
    if args.moordyn:
        return _moordyn(scene, args)
    if args.json:
        from dropper_jax.run.solution import jsonable

        print_json(jsonable({"schema": 1, "status": "ok", "name": table["name"], "scene": table}))
    else:
        print(as_toml(table), end="")
    return OK


def _moordyn(scene: Scene, args: argparse.Namespace) -> int:
    """The scene as a MoorDyn input; what that cannot say is listed."""
    from dropper_jax.moordyn.writing.writer import write_moordyn

    if args.dt is not None and not args.dt > 0:
        raise SceneError(f"--dt: {args.dt:g} is out of range; allowed: > 0 s")
    file = output_file(args.moordyn, "--moordyn", (".txt", ".dat"))
    lost = write_moordyn(scene, file, dt=args.dt)
    for line in lost:
        print_line(f"warning: {line}")
    if args.json:
        print_json({"schema": 1, "status": "ok", "name": scene.name, "file": str(file), "not_represented": lost})
    else:
        print(f"ok: {file}")
    return OK
