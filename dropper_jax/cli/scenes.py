"""`dropper scenes`: the packaged scenes, or one scene as TOML."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.references import references_of
from dropper_jax.base.toml_text import as_toml
from dropper_jax.cli.given import positive
from dropper_jax.cli.options import (
    add_allow_outside,
    add_effects,
    add_examples,
    add_flag,
    add_json,
    add_set,
    assignments,
    register_effects,
)
from dropper_jax.cli.outputs import add_file
from dropper_jax.cli.printing import OK, done_object, listing, print_json, print_result, print_warnings
from dropper_jax.load.packaged import (
    find_scene,
    folder_of,
    is_packaged,
    packaged_scene,
    scene_names,
    scene_titles,
    variants_of,
)

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene

help = "list the packaged scenes by group, or print one as TOML to edit"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "scenes",
        "scenes paper-case-1 --set sea.depth=40",
    )
    parser.add_argument(
        "scene", nargs="?", metavar="SCENE", help="print this scene as TOML: a packaged one, or a MoorDyn input"
    )
    add_set(parser)
    add_allow_outside(parser)
    add_effects(parser)
    add_flag(parser, "--expanded", "print it as a plain scene, without parameters, repetitions and arrays")
    add_file(parser, "--moordyn", (".txt", ".dat"), "write the scene as a MoorDyn v2 input instead")
    add_flag(parser, "--force", "allow --moordyn to replace files of waves and current that differ")
    parser.add_argument(
        "--dt",
        type=positive("s"),
        help="time step of MoorDyn [s], whose schemes are explicit (default: that of the scene)",
    )
    parser.add_argument(
        "--reference",
        nargs="?",
        const="",
        metavar="KEY",
        help="print the keys of scenes: all, or this key or section",
    )
    add_flag(parser, "--schema", "print the JSON Schema of scenes, for editors")
    add_json(parser)


def run(args: Namespace) -> int:
    for name in ("dt", "force"):
        if getattr(args, name) and not args.moordyn:
            raise SceneError(f"--{name}: requires --moordyn FILE")
    if args.reference is not None or args.schema:
        return _reference(args)
    if args.scene is not None:
        return _one(args)
    for name in ("set", "moordyn", "expanded"):
        if getattr(args, name):
            raise SceneError(f"--{name}: needs a scene. Use dropper scenes SCENE --{name} ...")
    found = [{"name": scene, "description": packaged_scene(scene)["description"]} for scene in scene_names()]
    return print_result(args, done_object(groups=scene_titles(), scenes=found), _titles())


def _titles() -> str:
    """Titles by group, each with the suffixes of its variants."""
    parts = []
    for group, titles in scene_titles().items():
        pairs = []
        for name, title in titles.items():
            also = ", ".join(variants_of(name))
            if also:
                title = f"{title} (also {also})"
            pairs.append((f"  {name}", title))
        parts.append(f"{group}\n{listing(pairs)}")
    return "\n\n".join(parts)


def _reference(args: Namespace) -> int:
    """Every key of a scene, or the requested ones."""
    if args.scene is not None:
        raise SceneError(f"SCENE: {args.scene!r} cannot be combined with --reference and --schema")

    from dropper_jax.cli.reference import as_text, as_values
    from dropper_jax.load.reference import find, schema, sections

    register_effects(args)
    if args.schema:
        print(json.dumps(schema(), indent=1))
        return OK
    found = find(args.reference) if args.reference else sections()
    return print_result(args, done_object(sections=as_values(found)), as_text(found))


def _one(args: Namespace) -> int:
    """The values of one scene, checked, as TOML or in a MoorDyn file."""
    changes = assignments(args.set)
    with references_of(folder_of(args.scene, args.allow_outside)):
        values, label = find_scene(args.scene)
        table = {"name": label, **values}
        if is_packaged(args.scene) and not (changes or args.moordyn or args.expanded):
            return _show(table, args.json)  # packaged scenes are valid: checking values would import JAX

        from dropper_jax.load.scene import Scene

        register_effects(args)
        scene = Scene.from_dict(values, label)
    if changes:
        scene = scene.with_values(changes)
    if changes or args.expanded:
        table = scene.as_written()
    if args.moordyn:
        return _moordyn(scene, args.moordyn, args)
    return _show(table, args.json)


def _show(table: Table, as_json: bool) -> int:
    if as_json:
        print_json(done_object(name=table["name"], scene=table))
    else:
        print(as_toml(table), end="")
    return OK


def _moordyn(scene: Scene, file: Path, args: Namespace) -> int:
    """The scene as a MoorDyn input; unsupported parts are listed."""
    from dropper_jax.decks.writing.writer import write_moordyn

    lost = write_moordyn(scene, file, dt=args.dt, force=args.force)
    print_warnings(lost)
    return print_result(args, done_object(name=scene.name, file=str(file), not_represented=lost), f"ok: {file}")
