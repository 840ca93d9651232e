"""The scene: a declarative description in SI units, validated here so that no later checks are needed."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import LocatedValues, SceneError
from dropper_jax.base.html_table import html_table
from dropper_jax.base.read import Plain, ScenePath, Table, Values, check_keys, part, plain, read_fields, read_text
from dropper_jax.base.records import select_keys, without_keys
from dropper_jax.base.references import references_of
from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.load.checks_system import attached_points, check_bed, check_layout, check_scene
from dropper_jax.load.original_lines import OriginalLines, is_written, locate_written
from dropper_jax.load.packaged import find_scene, folder_of
from dropper_jax.load.paths import get, locate, path_as_given, set_value
from dropper_jax.load.periods import with_suggestions
from dropper_jax.load.resolve import GRAVITIES, resolve, with_one_gravity
from dropper_jax.load.start_pose import check_pose, check_system_pose, closed_start, given_pose
from dropper_jax.load.template import Template
from dropper_jax.scene import RunSpec, SceneData, choose_steps

#: Maximum number of lines and points in the table of a scene.
MAX_SHOWN = 12


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene(SceneData):
    """A scene, read and checked, that keeps its original form.

    Attributes:
        written: line types, sections and attached points in their original form; None without any.
        template: parameters, repetitions and arrays in their original form; None without any.
        before_links: the scene in its original form before values of single links were changed, and these changes by
            path; None without any. Further changes start from it, so that `line.leg.length` remains that of the line.
    """

    run: RunSpec = part(partial(RunSpec.read, options=OPTIONS), needed="a table with `duration`")
    written: OriginalLines | None = None
    template: Template | None = None
    before_links: tuple[Scene, Table] | None = None

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
        pose = given_pose(scene)
        if line is None:
            check_system_pose(scene)
        elif pose is not None:
            check_pose(scene, line, *pose)
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
        if self.before_links is not None:
            base, changes = self.before_links
            return base.with_values({**changes, **values})
        for path in values:
            if ScenePath(path).section == "parameters":
                raise SceneError(f"{path}: the scene has no [parameters]. Use paths of its values")
        table = self.to_dict()
        self._pair_gravities(values)
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
            found = Scene.from_dict(table)
        except SceneError as error:
            raise path_as_given(error, values) from None
        if self.written is None or found.written is not None:
            return found
        single = self.written.single_changes(self.to_dict(), values)
        others = without_keys(values, single)
        base = self.with_values(others) if others else self
        return replace(found, before_links=(base, single))

    def _pair_gravities(self, values: Table) -> None:
        """Add to changed values the gravity of weights or of the water where the other one is changed: they have one.

        Weightless lines in waves keep theirs.
        """
        of_weight, of_sea = GRAVITIES
        if self.sea is None or (of_weight in values) == (of_sea in values):
            return
        if of_sea in values and "weight" in self.effects and self.effects["weight"]["gravity"] == self.sea.gravity:
            values[of_weight] = values[of_sea]
        may_be_weightless = self.sea.waves is not None and "buoyancy" not in self.effects
        if of_weight in values and not (may_be_weightless and values[of_weight] == 0.0):
            values[of_sea] = values[of_weight]

    def sets_other_gravity(self, path: str) -> bool:
        """Whether a change of the value at a path also changes the gravity of the water, or of the weights in it."""
        return self.sea is not None and path in GRAVITIES

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
