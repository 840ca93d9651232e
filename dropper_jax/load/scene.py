"""The scene: a declarative description in SI units, validated here so that no later checks are needed."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import Check, LocatedValues, SceneError, raises_first
from dropper_jax.base.html_table import html_table
from dropper_jax.base.read import (
    Plain,
    ScenePath,
    Table,
    Values,
    check_keys,
    part,
    plain,
    read_fields,
    read_text,
)
from dropper_jax.base.records import select_keys, without_keys
from dropper_jax.base.references import references_of
from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.load.checks_system import (
    attached_points,
    check_bed,
    check_layout,
    check_scene,
    check_span,
)
from dropper_jax.load.original_lines import OriginalLines, is_written, locate_written
from dropper_jax.load.packaged import find_scene, folder_of
from dropper_jax.load.paths import get, locate, path_as_given, set_value
from dropper_jax.load.periods import with_suggestions
from dropper_jax.load.resolve import GRAVITIES, resolve, with_one_gravity
from dropper_jax.load.template import Template
from dropper_jax.scene import LineSpec, RunSpec, SceneData, StartSpec, choose_steps, directions, sliced_lines
from dropper_jax.scene.start import rows_of_pieces

#: Relative mismatch of a given configuration with lengths and fixed ends that is still attributed to rounding.
POSE_TOLERANCE = 1e-6
#: The same for angles that are closed on loading: files contain angles with four or five decimals.
CLOSED_TOLERANCE = 1e-4
#: Length of an elastic link over its unstretched length from which measured positions are not those of its line.
MAX_STRETCH = 2.0


def given_pose(scene: SceneData) -> tuple[str, np.ndarray] | None:
    """The path of a given start of one line, and its nodes (n + 1, 3) [m]; None for a static start."""
    line = scene.lines[0]
    start = scene.start
    if start.positions is not None:
        return "start.positions", start.positions
    if start.polar is None or start.azimuth is None or start.zero is None:
        return None
    steps = line.length[:, None] * directions(start.polar, start.azimuth, start.zero)
    first = scene.point(line.start).position
    return "start.polar", first + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def closed_start(scene: SceneData) -> StartSpec:
    """The start of one line between fixed points with angles that close, if only rounding prevented it.

    The smallest change of the polar and azimuth angles is used. Other starts, and angles with a larger mismatch, are
    returned unchanged and rejected by `check_pose`.
    """
    line = scene.lines[0]
    start = scene.start
    end = scene.point(line.end)
    polar = start.polar
    azimuth = start.azimuth
    zero = start.zero
    if polar is None or azimuth is None or zero is None or end.is_free:
        return start
    span = end.position - scene.point(line.start).position
    missing = span - line.length @ directions(polar, azimuth, zero)
    if not POSE_TOLERANCE * line.total < np.linalg.norm(missing) <= CLOSED_TOLERANCE * line.total:
        return start
    # Newton steps that close angles; starting from a mismatch of `CLOSED_TOLERANCE`, two reach rounding error
    for _ in range(4):
        # a quarter turn further is the derivative of a direction with respect to its azimuth, without z
        by_polar = directions(polar + np.pi / 2, azimuth, zero)
        by_azimuth = directions(polar, azimuth + np.pi / 2, zero) * [1.0, 1.0, 0.0]
        slope = np.concatenate([line.length[:, None] * by_polar, line.length[:, None] * by_azimuth])
        change = np.split(np.linalg.lstsq(slope.T, missing, rcond=1e-9)[0], 2)
        polar = polar + change[0]
        azimuth = azimuth + change[1]
        missing = span - line.length @ directions(polar, azimuth, zero)
    return replace(start, polar=polar, azimuth=azimuth)


@raises_first
def check_pose(scene: SceneData, line: LineSpec, path: str, nodes: np.ndarray, before: int = 0) -> Iterator[Check]:
    """Check that a given configuration starts and ends at the line's fixed points and has the lengths of rigid
    links.

    Args:
        nodes: of the line (links + 1, 3) [m]; before: number of nodes of other lines before it in the list.
    """
    for i, point in ((0, scene.point(line.start)), (line.links, scene.point(line.end))):
        away = float(np.linalg.norm(nodes[i] - point.position))
        yield (
            away > POSE_TOLERANCE * line.total and not point.is_free,
            f"{path}: node {before + i} is at {_point_text(nodes[i])} m; allowed: {_point_text(point.position)} m, "
            f"the position of {point.name!r}",
        )
    sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    for j in np.flatnonzero(np.abs(sizes - line.length) > POSE_TOLERANCE * line.length):
        yield line.rigid, f"{path}: link {j + 1} is {sizes[j]:.9g} m long; allowed: its length {line.length[j]:.9g} m"


def check_system_pose(scene: SceneData) -> None:
    """Check the start of a system of lines: rigid links that hang between the points where these are, and positions.

    Raises:
        SceneError: links too short for their points, bodies, or positions that disagree with points, with links, or
            with each other.
    """
    if scene.start.kind == "points":
        for i, line in enumerate(scene.lines):
            if line.rigid and line.links > 1:
                check_span(scene, i)
    positions = scene.start.positions
    if positions is None:
        return
    if scene.bodies:
        raise SceneError("start.kind: 'positions' gives nodes of lines only; allowed: in scenes without bodies")
    rows = rows_of_pieces(scene.lines)
    found: dict[str, tuple[int, np.ndarray]] = {}
    for line, where in sliced_lines(scene):
        nodes = positions[where.nodes]
        path = f"start.positions: line {line.name!r}"
        check_pose(scene, line, path, nodes, int(rows[where.nodes.start]))
        sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1) / line.length
        worst = int(np.argmax(sizes))
        if sizes[worst] > MAX_STRETCH:
            raise SceneError(
                f"{path}: link {worst + 1} is {sizes[worst]:.4g} times as long as unstretched; allowed: up to "
                f"{MAX_STRETCH:g}. Check unit and order of the nodes"
            )
        for i, name in ((0, line.start), (line.links, line.end)):
            row = int(rows[where.nodes.start + i])
            other, position = found.setdefault(name, (row, nodes[i]))
            if np.linalg.norm(nodes[i] - position) > POSE_TOLERANCE * line.total:
                raise SceneError(
                    f"start.positions: nodes {other} and {row} are both point {name!r}, but at "
                    f"{_point_text(position)} m and {_point_text(nodes[i])} m; allowed: one position"
                )


def _point_text(position: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.9g}" for x in position) + ")"


#: Maximum number of lines and points in the table of a scene.
MAX_SHOWN = 12


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene(SceneData):
    """A scene, read and checked, that keeps its original form.

    Attributes:
        written: line types, sections and attached points in their original form; None without any.
        template: parameters, repetitions and arrays in their original form; None without any.
    """

    run: RunSpec = part(partial(RunSpec.read, options=OPTIONS), needed="a table with `duration`")
    written: OriginalLines | None = None
    template: Template | None = None

    @classmethod
    def from_dict(cls, table: Values, name: str = "scene") -> Scene:
        """A scene from plain values; `name` is used if the table has none.

        Raises:
            SceneError: one line with the path, the value and what is allowed.
        """
        if isinstance(table, LocatedValues):
            try:
                return cls.from_dict(dict(table), name)
            except SceneError as error:
                raise table.with_line(error) from None
        if "scene" in table:
            raise SceneError("scene: this is a site, not a scene. Use it with cases, season or optimise")
        table, written, template = resolve(table)
        values = read_fields(cls, {"name": name, **with_one_gravity(table)}, "", {})
        scene = cls(**values, written=written, template=template)
        scene = replace(scene, points=scene.points + attached_points(scene))
        check_layout(scene)
        read_text(scene.run.integrator, "run.integrator", INTEGRATORS)
        line = scene.single_line
        held = line is None or not scene.point(line.end).is_free
        start = scene.start.of_lines(scene.lines, held, branched=line is None)
        scene = replace(scene, start=start, effects=_read_effects(scene))
        check_scene(scene)
        scene = replace(scene, start=closed_start(scene))
        pose = None
        if line is not None:
            pose = given_pose(scene)
        if line is not None and pose is not None:
            check_pose(scene, line, *pose)
        else:
            check_system_pose(scene)
        check_bed(scene, pose)
        return with_suggestions(scene)

    def as_written(self) -> Table:
        """Plain values as `to_dict`, with line types, sections and attached points in their original form."""
        if self.written is None:
            return self.to_dict()
        return self.written.table(self.to_dict())

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        rows = [
            ("run", f"{self.run.integrator}, {self.run.steps_in_words} to {self.run.duration:g} s"),
            ("points", ", ".join(f"{point.name} ({point.kind})" for point in self.points[:MAX_SHOWN])),
        ]
        for line in self.lines[:MAX_SHOWN]:
            size = f"{line.links} links, {line.total:.4g} m, {np.sum(line.mass):.4g} kg"
            rows.append((f"line {line.name}", size))
        rows.append(("effects", ", ".join(self.effects) or "none"))
        return html_table(f"Scene {self.name}: {len(self.lines)} lines, {len(self.points)} points", rows)

    def with_values(self, values: Values) -> Scene:
        """The scene with some values changed, all at once, validated again.

        Args:
            values: by path, such as `effects.linear_damping.b_l`, `line.0.mass` or `point.right.position.0`; lines and
                points are selected by number or name. For lines with types, keys have the same meaning as in the file:
                `line.leg.length` is that of the full line, `line_type.chain.EA` that of all lines of the type. An
                effect that the scene lacks is added by its first value.
        """
        values = {path: copy.deepcopy(plain(value)) for path, value in values.items()}
        if self.template is not None:
            return self._from_template(self.template, values)
        for path in values:
            if ScenePath(path).section == "parameters":
                raise SceneError(f"{path}: the scene has no [parameters]. Use paths of its values")
        table = self.to_dict()
        for path, other in (GRAVITIES, GRAVITIES[::-1]):
            if path in values and other not in values and self.sea is not None:
                values[other] = values[path]
        if "sea.packaged" in values:  # another sea replaces this one's waves and water
            table["sea"] = select_keys(table.get("sea", {}), ("current", "ramp"))
        if self.written is not None:
            table = self.written.with_changes(table, values)
        else:
            known = locate(table, values)
            for path, value in values.items():
                set_value(table, path, value, known)
        table["run"] = choose_steps(table["run"], values)
        if "run.integrator" in values and "run.accuracy" not in values:
            table["run"] = self._with_steps_for(table["run"])
        try:
            return Scene.from_dict(table)
        except SceneError as error:
            raise path_as_given(error, values) from None

    def with_equal_steps(self) -> Scene:
        """The scene with equal steps of `run.step` in place of an accuracy, for studies that need them."""
        if self.run.accuracy is None:
            return self
        return self.with_values({"run.dt": self.run.step})

    def _with_steps_for(self, run: Table) -> Table:
        """The table of `[run]`, with equal steps if its scheme has no estimate of the error of a step."""
        scheme = INTEGRATORS.get(run["integrator"])
        if self.run.accuracy is None or "dt" in run or scheme is None:
            return run
        if scheme(**{key: run[key] for key in scheme.options() if key in run}).follows_accuracy:
            return run
        return {**choose_steps(run, {"run.dt": None}), "dt": self.run.step}

    def _from_template(self, original: Template, values: Values) -> Scene:
        """The scene with values changed: parameters before all others, including those of earlier changes."""
        given = {path: value for path, value in values.items() if ScenePath(path).section == "parameters"}
        changes = without_keys(values, given)
        scene = self
        template = original.with_changes(given, changes)
        if given:
            scene = Scene.from_dict(template.table, self.name)
            changes = template.changes
        if changes:
            scene = replace(scene, template=None).with_values(changes)
        return replace(scene, template=template)

    @property
    def parameter_paths(self) -> list[str]:
        """Paths of the numbers of `[parameters]`."""
        if self.template is None:
            return []
        return [f"parameters.{name}" for name in self.template.table.get("parameters", {})]

    def value(self, path: str) -> Plain:
        """The plain value at a path, as used by `with_values`.

        Raises:
            SceneError: the path does not exist, or no value is given there.
        """
        if self.template is not None and ScenePath(path).section == "parameters":
            return float(self.template.value(path))
        table = self.as_written()
        written = locate_written(table)
        if is_written(table, path, written):
            return get(table, path, written)
        return get(self.to_dict(), path)


def _read_effects(scene: Scene) -> dict[str, Table]:
    """Values of the fields of each effect, in the order of the registry."""
    given = scene.effects
    try:
        check_keys(given, EFFECTS, "effects")
    except SceneError as error:
        own = "own effects: register in Python, --effects FILE.py, or an entry point of the group dropper.effects"
        raise SceneError(f"{error}; {own}") from None
    links = sum(line.links for line in scene.lines)
    counts = {"node": links, "link": links, "joint": links + 1}
    names = [name for name in EFFECTS if name in given]
    return {name: read_fields(EFFECTS[name], given[name], f"effects.{name}", counts) for name in names}


def load_scene(source: str | Path | Values | Scene, *, allow_outside: bool = False) -> Scene:
    """A scene from a packaged name, a TOML file, a MoorDyn input, a mooring of MoorPy or RAFT (.yaml), or plain values.

    A MoorDyn input is recognised by its header of line types.

    Args:
        allow_outside: a file may refer to files that are neither below its folder nor below the working folder.

    Raises:
        SceneError: a file that is missing or not TOML, an unknown name (with the nearest), or any invalid value.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        return Scene.from_dict(source)
    if not isinstance(source, str | PathLike):
        raise SceneError(f"scene: {source!r:.60} is not a scene; allowed: a name, a file, a table, or a Scene")
    with references_of(folder_of(source, allow_outside)):
        return Scene.from_dict(*find_scene(source))
