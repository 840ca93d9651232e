"""The scene: a declarative description in SI units, validated here so that nothing has to be checked later."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.catalogue import read_toml, scene_names
from dropper_jax.effects import EFFECTS
from dropper_jax.errors import SceneError
from dropper_jax.failure import FailureSpec
from dropper_jax.given_pose import check_pose, given_pose
from dropper_jax.integrators import check_names
from dropper_jax.line_types import expand
from dropper_jax.scene_paths import get, put
from dropper_jax.schema import check_keys, plain, read_fields, read_list, read_table, read_text, refuse
from dropper_jax.sea.checks import check_water
from dropper_jax.sea.growth import check_growth
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sections import (
    BuoySpec,
    LineSpec,
    PointSpec,
    RunSpec,
    StartSpec,
    as_table,
    joined,
)
from dropper_jax.system_checks import check_bed, check_ends, check_system, check_system_effects
from dropper_jax.written import Written

__all__ = ["Scene", "load_scene", "scene_names"]

SECTIONS = ("name", "description", "run", "point", "line", "buoy", "effects", "start", "sea", "failure", "notes")


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A validated scene.

    Attributes:
        name, description: for people.
        points, lines: what is held and what hangs between.
        effects: values of all fields of each effect, in the order of the registry; None where left out.
        start: pose and velocities at t = 0.
        run: default time step, duration, integrator, solver and precision.
        sea: the water, or None.
        buoys: upright cylinders at free points.
        failures: where lines break, at a load or a time.
        notes: what a file that the scene was read from says and the scene does not; warnings of every run.
        written: line types, sections and attached points as they were written; None without any.
    """

    name: str
    description: str
    points: tuple[PointSpec, ...]
    lines: tuple[LineSpec, ...]
    effects: dict[str, dict[str, Any]]
    start: StartSpec
    run: RunSpec
    sea: SeaSpec | None = None
    buoys: tuple[BuoySpec, ...] = ()
    failures: tuple[FailureSpec, ...] = ()
    notes: tuple[str, ...] = ()
    written: Written | None = None

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], name: str = "scene") -> Scene:
        """A scene from plain values; `name` where the table has none.

        Raises:
            SceneError: one line with the path, the value and what is allowed.
        """
        given = read_table(table, "scene")
        table = expand(given)
        check_keys(table, SECTIONS, "")
        points = tuple(PointSpec.read(item, f"point.{i}") for i, item in _items(table, "point"))
        lines = tuple(LineSpec.read(item, f"line.{i}") for i, item in _items(table, "line"))
        buoys = tuple(BuoySpec.read(item, f"buoy.{i}") for i, item in enumerate(_list(table, "buoy")))
        _check_points(points)
        branched = _branched(points, lines, buoys)
        if branched:
            check_system(points, lines, buoys)
        else:
            _check_line(lines[0], points)
        held = branched or _point(points, lines[0].end).kind == "fixed"
        if "run" not in table:
            raise SceneError("run: missing; needed: a table with `dt` and `duration`")
        scene = cls(
            name=read_text(table.get("name", name), "name"),
            description=read_text(table.get("description", ""), "description"),
            points=points,
            lines=lines,
            buoys=buoys,
            effects=_read_effects(table.get("effects", {}), sum(line.links for line in lines)),
            start=StartSpec.read(table.get("start", {}), "start", lines[0], held, branched),
            run=RunSpec.read(table["run"], "run"),
            sea=SeaSpec.read(table["sea"], "sea") if "sea" in table else None,
            failures=tuple(
                FailureSpec.read(item, f"failure.{i}", lines) for i, item in enumerate(_list(table, "failure"))
            ),
            notes=tuple(
                read_text(note, f"notes.{i}") for i, note in enumerate(_list(table, "notes", "a list of texts"))
            ),
            written=Written.of(given, table),
        )
        check_names(scene.run.integrator, scene.run.solver)
        if branched:
            check_system_effects(scene)
        for effect, values in scene.effects.items():
            if EFFECTS[effect].needs_water or EFFECTS[effect].needs_sea:
                check_water(effect, scene)
            EFFECTS[effect].check(values, scene)
        check_growth(scene)
        pose = None if branched else given_pose(scene)
        if pose is not None:
            check_pose(scene, *pose)
        check_bed(scene, pose)
        return scene

    @property
    def branched(self) -> bool:
        """Whether it is a system of lines: more than one, or with free points other than the end of a line."""
        return _branched(self.points, self.lines, self.buoys)

    @property
    def line(self) -> LineSpec:
        """All lines as one, their arrays one after another."""
        return joined(self.lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain values (text, numbers, lists, tables) from which `from_dict` makes the same scene."""
        return {
            "name": self.name,
            "description": self.description,
            "run": as_table(self.run),
            "point": [as_table(point) for point in self.points],
            "line": [line.table() for line in self.lines],
            **({"buoy": [as_table(buoy) for buoy in self.buoys]} if self.buoys else {}),
            "effects": {
                name: {key: plain(value) for key, value in values.items() if value is not None}
                for name, values in self.effects.items()
            },
            "start": as_table(self.start),
            **({} if self.sea is None else {"sea": self.sea.table()}),
            **({"failure": [as_table(failure) for failure in self.failures]} if self.failures else {}),
            **({"notes": list(self.notes)} if self.notes else {}),
        }

    def as_written(self) -> dict[str, Any]:
        """Plain values as `to_dict`, with line types, sections and attached points as they were written."""
        return self.to_dict() if self.written is None else self.written.table(self.to_dict())

    def with_values(self, values: Mapping[str, Any]) -> Scene:
        """The scene with some values changed, all at once, validated again.

        Args:
            values: by path, such as `effects.linear_damping.b_l`, `line.0.mass` or `point.right.position.0`; lines
                and points go by number or name. Of lines with types, keys mean what they mean in the file:
                `line.leg.length` is that of the whole line, `line_type.chain.EA` that of all lines of the type. An
                effect that the scene lacks is added by its first value.
        """
        table = self.to_dict()
        values = {path: copy.deepcopy(plain(value)) for path, value in values.items()}
        if "sea.packaged" in values:  # another sea takes the place of this one's waves and water
            table["sea"] = {key: value for key, value in table.get("sea", {}).items() if key in ("current", "ramp")}
        if self.written is not None:
            return Scene.from_dict(self.written.changed(table, values))
        for path, value in values.items():
            put(table, path, value)
        return Scene.from_dict(table)

    def value(self, path: str) -> Any:
        """The plain value at a path, such as those of `with_values`.

        Raises:
            SceneError: no such path, or nothing given there.
        """
        table = self.as_written()
        found = None if self.written is None else self.written.locate(path, self.written.places(table))
        if found is None:
            return get(self.to_dict(), path)
        parent, key = found
        if isinstance(parent, dict) and key not in parent:
            raise SceneError(f"{path}: is not given in the scene")
        return parent[key]

    def point(self, name: str) -> PointSpec:
        """The point of that name."""
        return _point(self.points, name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self.to_dict() == other.to_dict()


def load_scene(source: str | Path | Mapping[str, Any] | Scene) -> Scene:
    """A scene from a packaged name, a TOML file or plain values.

    Raises:
        SceneError: for a file that is missing or no TOML, an unknown name (with the nearest), or any bad value.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        return Scene.from_dict(source)
    table, name = read_toml(source)
    return Scene.from_dict(table, name)


def _items(table: Mapping[str, Any], section: str) -> Iterator[tuple[int, Any]]:
    items = read_list(table.get(section, []), section, None, f"one or more [[{section}]] tables")
    if not items:
        raise SceneError(f"{section}: missing; needed: one or more [[{section}]] tables")
    return enumerate(items)


def _list(table: Mapping[str, Any], section: str, allowed: str | None = None) -> list[Any]:
    return read_list(table.get(section, []), section, None, allowed or f"one or more [[{section}]] tables")


def _point(points: tuple[PointSpec, ...], name: str) -> PointSpec:
    return next(point for point in points if point.name == name)


def _check_points(points: tuple[PointSpec, ...]) -> None:
    names = [point.name for point in points]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise refuse(f"point.{i}.name", name, "is used twice", "a name of its own")


def _branched(points: tuple[PointSpec, ...], lines: tuple[LineSpec, ...], buoys: tuple[BuoySpec, ...]) -> bool:
    if len(lines) > 1 or buoys or any(point.body for point in points) or lines[0].nodes == "shared":
        return True
    start = next((p for p in points if p.name == lines[0].start), None)
    return start is not None and start.kind == "free" and not lines[0].rigid


def _check_line(line: LineSpec, points: tuple[PointSpec, ...]) -> None:
    check_ends((line,), points)
    start, end = _point(points, line.start), _point(points, line.end)
    if start.kind != "fixed":
        names = [point.name for point in points]
        raise refuse(f"point.{names.index(start.name)}.kind", start.kind, "cannot begin a rigid line", "fixed")
    if end.kind == "fixed":
        _check_reach(line, "line.0", start, end)


def _check_reach(line: LineSpec, path: str, start: PointSpec, end: PointSpec) -> None:
    """Links between two held ends must be able to close: no side of the polygon exceeds the sum of the others."""
    if line.links < 2:
        raise refuse(f"{path}.links", line.links, "leaves nothing free between two held ends", "a whole number >= 2")
    if not line.rigid:
        return
    distance = float(np.linalg.norm(end.position - start.position))
    if line.total <= distance:
        raise SceneError(
            f"{path}.length: the links are {line.total:g} m long in all, too short for the {distance:g} m between "
            f"{start.name!r} and {end.name!r}; allowed: more than {distance:g} m in all"
        )
    longest = float(np.max(line.length))
    others = line.total - longest + distance
    if longest >= others:
        raise SceneError(
            f"{path}.length: a link of {longest:g} m cannot be closed by the others and the {distance:g} m between "
            f"the ends; allowed: less than {others:g} m"
        )


def _read_effects(table: Any, links: int) -> dict[str, dict[str, Any]]:
    table = read_table(table, "effects")
    check_keys(table, EFFECTS, "effects")
    counts = {"node": links, "link": links, "joint": links + 1}
    return {
        name: read_fields(cls, table[name], f"effects.{name}", counts) for name, cls in EFFECTS.items() if name in table
    }
