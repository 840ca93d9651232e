"""The same scene with twice as many links."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene

#: Quantities of a link or a node that are divided between its halves; all others are equal.
SHARED = ("N", "kg", "kg/s", "kg/m")
#: Keys of a line per link.
PER_LINK = {"length": 2, "mass": 2, "diameter": 1, "breaking_load": 1}
#: Effects with parameters per joint, whose number grows with the links.
JOINTED = ("joint_friction",)


def twice_the_links(scene: Scene) -> Scene:
    """The scene with each link divided into halves; axial stiffness and internal damping do not change.

    Raises:
        SceneError: unsupported scenes: compound links, a single rigid link, joint friction.
    """
    if any(line.centre_of_mass is not None for line in scene.lines):
        raise SceneError("line.centre_of_mass: compound links have no halves; allowed: lines of simple links")
    if all(line.rigid and line.links == 1 for line in scene.lines):
        raise SceneError("line.links: a single rigid link is the body itself; allowed: lines of several links")
    for name in JOINTED:
        if name in scene.effects:
            raise SceneError(f"effects.{name}: depends on the number of joints. Use a scene without it")
    table = scene.to_dict()
    table["line"] = [_line(line) for line in table["line"]]
    table["effects"] = {name: _effect(name, values) for name, values in table["effects"].items()}
    table["start"] = _start(table["start"])
    for failure in table.get("failure", ()):
        if failure.get("link") is not None:
            failure["link"] = 2 * failure["link"] - 1
    return load_scene(table)


def _line(line: dict[str, Any]) -> dict[str, Any]:
    halves = {key: _halve_value(line[key], parts) for key, parts in PER_LINK.items() if key in line}
    axial = {"axial": {key: _halve_value(value, 1) for key, value in line["axial"].items()}} if "axial" in line else {}
    return {**line, **halves, **axial, "links": 2 * line["links"]}


def _effect(name: str, values: dict[str, Any]) -> dict[str, Any]:
    found = dict(values)
    for key, field in EFFECTS[name].__dataclass_fields__.items():
        shape, unit = field.metadata.get("shape"), field.metadata.get("unit")
        if found.get(key) is None or shape not in ("link", "node"):
            continue
        found[key] = _halve_value(found[key], 2 if unit in SHARED else 1)
    for key in ("node", "nodes"):  # of one line, counted from 1
        if found.get(key) is not None and isinstance(found[key], list | int) and not isinstance(found[key], bool):
            found[key] = (2 * np.asarray(found[key])).tolist()
    return found


def _start(start: dict[str, Any]) -> dict[str, Any]:
    found = dict(start)
    for key in ("polar", "azimuth", "polar_rate", "azimuth_rate"):
        if found.get(key) is not None:
            found[key] = np.repeat(found[key], 2).tolist()
    for key in ("positions", "velocities"):
        if found.get(key) is not None:
            given = np.asarray(found[key], float)
            between = np.insert(given, np.arange(1, len(given)), 0.5 * (given[:-1] + given[1:]), axis=0)
            found[key] = between.tolist()
    if found.get("release_nodes") is not None:
        found["release_nodes"] = [2 * node for node in found["release_nodes"]]
    return found


def _halve_value(value: Plain, parts: int) -> Plain:
    """Value of each half of a link, from a number or a list of one per link."""
    if isinstance(value, bool | str) or value is None:
        return value
    if isinstance(value, list):
        return [_halve_value(x, parts) for x in value for _ in (0, 1)]
    return value / parts
