"""A scene as data, in SI units, after reading and checking."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import option
from dropper_jax.base.read import DeclaredSection, Table, as_table, items, part, plain, read_option, read_table
from dropper_jax.base.records import names_of, without_none
from dropper_jax.scene.anchor import AnchorSpec
from dropper_jax.scene.body import BodySpec
from dropper_jax.scene.failure import FailureSpec
from dropper_jax.scene.fit import FitSpec
from dropper_jax.scene.line import LineSpec, join_lines
from dropper_jax.scene.point import BuoySpec, PointSpec
from dropper_jax.scene.run import RunSpec
from dropper_jax.scene.season import SeasonSpec
from dropper_jax.scene.start import StartSpec
from dropper_jax.scene.vessel import VesselSpec
from dropper_jax.sea.spec import SeaSpec


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneData(DeclaredSection):
    """A scene, validated by `load`.

    Attributes:
        name, description: information for the user.
        points, lines: points and the lines between them.
        effects: values of all fields of each effect, in the order of the registry; None if omitted.
        start: configuration and velocities at t = 0.
        run: default time step, duration, integrator, solver and precision.
        sea: the water, or None.
        buoys: upright cylinders at free points.
        bodies: rigid bodies; their attachments are among the points.
        vessels: vessels with prescribed motion; likewise.
        failures: where lines break, at a load or a time.
        notes: contents of the source file that the scene does not represent; repeated as warnings of every run.
        fit: free parameters, sensors and priors of the rig, used by fits to traces only; or None.
        anchors: anchors of the fixed points.
        season: mussels on lines, by month; or None.
    """

    name: str = option("name", type=str)
    description: str = option("what it is", type=str, default="")
    run: RunSpec = part(RunSpec.read, needed="a table with `duration`")
    points: tuple[PointSpec, ...] = part(items(PointSpec), key="point", default=())
    lines: tuple[LineSpec, ...] = part(items(LineSpec), key="line", needed="one or more [[line]] tables")
    buoys: tuple[BuoySpec, ...] = part(items(BuoySpec), key="buoy", default=())
    bodies: tuple[BodySpec, ...] = part(items(BodySpec), key="body", default=())
    vessels: tuple[VesselSpec, ...] = part(items(VesselSpec), key="vessel", default=())
    effects: dict[str, Table] = part(read_table, default_factory=dict)
    start: StartSpec = part(StartSpec.read, default_factory=StartSpec)
    sea: SeaSpec | None = part(SeaSpec.read, default=None)
    failures: tuple[FailureSpec, ...] = part(items(FailureSpec), key="failure", default=())
    notes: tuple[str, ...] = part(partial(read_option, declared={"type": list}), default=())
    anchors: tuple[AnchorSpec, ...] = part(items(AnchorSpec), key="anchor", default=())
    season: SeasonSpec | None = part(SeasonSpec.read, key="growth", default=None)
    fit: FitSpec | None = part(FitSpec.read, default=None)

    @property
    def gravity(self) -> float:
        """Acceleration of gravity [m/s^2] of weights and of the water."""
        if "weight" in self.effects:
            return float(self.effects["weight"]["gravity"])
        if self.sea is not None:
            return float(self.sea.gravity)
        return GRAVITY

    @property
    def needed_sea(self) -> SeaSpec:
        """The water, for what needs it.

        Raises:
            SceneError: the scene has none.
        """
        if self.sea is None:
            raise SceneError("sea: missing; needed: a [sea] section")
        return self.sea

    @property
    def fixed_points(self) -> list[str]:
        """Names of the fixed points."""
        return [point.name for point in self.points if not point.is_free]

    @property
    def free_points(self) -> list[str]:
        """Names of the free points."""
        return [point.name for point in self.points if point.is_free]

    def check_fixed(self, name: str, path: str) -> None:
        """Reject a name that is not that of a fixed point.

        Raises:
            SceneError: with the path at which it is given.
        """
        if name not in self.fixed_points:
            raise SceneError(f"{path}: {name!r} is not a fixed point; {nearest(name, self.fixed_points)}")

    def check_line_end(self, name: str, path: str) -> None:
        """Reject a name that is not that of a fixed point at which one line ends."""
        self.check_fixed(name, path)
        ends = []
        for line in self.lines:
            ends += [line.name] * [line.start, line.end].count(name)
        if len(ends) != 1:
            raise SceneError(f"{path}: {name!r} has the lines {', '.join(ends)}; allowed: a point with one line")

    @property
    def single_line(self) -> LineSpec | None:
        """The line of a scene of one line, from a fixed point to a fixed or free one; None of a system of lines: more
        than one, or with masses at points, buoys or bodies."""
        first = self.lines[0]
        if len(self.lines) > 1 or self.bodies or self.buoys or first.nodes == "shared":
            return None
        hangs_free = not first.rigid and any(p.is_free for p in self.points if p.name == first.start)
        if hangs_free or any(point.has_body for point in self.points):
            return None
        return first

    @property
    def branched(self) -> bool:
        """Whether it is a system of lines."""
        return self.single_line is None

    @property
    def link_mass_nodes(self) -> dict[str, str]:
        """Node to which mass and water forces of each line's links go, by its name: `far`, `shared` or
        `centre_of_mass`.

        The last applies to compound links, which are divided by their centre of mass.
        """
        bodies = names_of(self.bodies)
        loaded = {point.name for point in self.points if point.has_body or point.carrier in bodies}
        loaded |= {buoy.point for buoy in self.buoys}
        ends: Counter[str] = Counter()
        for line in self.lines:
            ends.update({line.start, line.end})
        alone = {name for name, lines in ends.items() if lines == 1} - loaded
        starts = alone.difference(self.free_points)

        found = {}
        for line in self.lines:
            nodes = "shared"
            if line.centre_of_mass is not None:
                nodes = "centre_of_mass"
            elif line.nodes is not None:
                nodes = line.nodes
            elif line.start in starts and line.end in alone:
                nodes = "far"
            found[line.name] = nodes
        return found

    @property
    def line(self) -> LineSpec:
        """All lines as one, with their arrays concatenated."""
        return join_lines(self.lines)

    def to_dict(self) -> Table:
        """Plain values (text, numbers, lists, tables) from which `from_dict` recreates the scene."""
        table = as_table(self)
        table["point"] = plain([point for point in self.points if point.carrier is None])
        table["effects"] = {}
        for name, values in self.effects.items():
            table["effects"][name] = plain(without_none(values))
        return table

    def point(self, name: str) -> PointSpec:
        """The point with that name.

        Raises:
            SceneError: an unknown name, with the nearest.
        """
        for point in self.points:
            if point.name == name:
                return point
        raise SceneError(f"point: {name!r} is unknown; {nearest(name, names_of(self.points))}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SceneData) and self.to_dict() == other.to_dict()


def link_mass_words(nodes: dict[str, str]) -> str:
    """`SceneData.link_mass_nodes` in one readable line."""
    meaning = {"far": "at their far nodes", "shared": "half at each node", "centre_of_mass": "by the centre of mass"}
    lines = {}
    for key in meaning:
        lines[key] = [name for name, found in nodes.items() if found == key]
    most = max(lines, key=lambda key: len(lines[key]))
    if len(lines[most]) == len(nodes):
        return meaning[most]
    rest = [f"{meaning[key]}: {', '.join(names)}" for key, names in lines.items() if names and key != most]
    return f"{'; '.join(rest)}; {meaning[most]}: all other lines"
