"""A scene as data: what a user describes, in SI units, after reading and checking."""

from __future__ import annotations

import dataclasses
from typing import Any

from dropper_jax.base.read import as_table, plain
from dropper_jax.scene.anchor import AnchorSpec
from dropper_jax.scene.body import BodySpec
from dropper_jax.scene.failure import FailureSpec
from dropper_jax.scene.fit import FitSpec
from dropper_jax.scene.line import LineSpec, joined
from dropper_jax.scene.point import BuoySpec, PointSpec
from dropper_jax.scene.run import RunSpec
from dropper_jax.scene.season import SeasonSpec
from dropper_jax.scene.start import StartSpec
from dropper_jax.scene.vessel import VesselSpec
from dropper_jax.sea.spec import SeaSpec


@dataclasses.dataclass(frozen=True, eq=False)
class SceneData:
    """A scene, valid as `load` leaves it.

    Attributes:
        name, description: for people.
        points, lines: what is held and what hangs between.
        effects: values of all fields of each effect, in the order of the registry; None where left out.
        start: pose and velocities at t = 0.
        run: default time step, duration, integrator, solver and precision.
        sea: the water, or None.
        buoys: upright cylinders at free points.
        bodies: rigid bodies; their attachments stand among the points.
        vessels: what moves by itself; likewise.
        failures: where lines break, at a load or a time.
        notes: what a file that the scene was read from says and the scene does not; warnings of every run.
        fit: what the rig leaves open and what it knows, for fits to traces alone; or None.
        anchors: what held points hold.
        season: mussels on lines, by month; or None.
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
    fit: FitSpec | None = None
    anchors: tuple[AnchorSpec, ...] = ()
    bodies: tuple[BodySpec, ...] = ()
    vessels: tuple[VesselSpec, ...] = ()
    season: SeasonSpec | None = None

    @property
    def branched(self) -> bool:
        """Whether it is a system of lines: more than one, or with free points other than the end of a line."""
        return bool(self.bodies) or is_branched(self.points, self.lines, self.buoys)

    @property
    def line(self) -> LineSpec:
        """All lines as one, their arrays one after another."""
        return joined(self.lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain values (text, numbers, lists, tables) from which `from_dict` makes the same scene."""
        return {
            "name": self.name,
            "description": self.description,
            "run": self.run.table(),
            "point": [as_table(point) for point in self.points if point.on is None],
            "line": [line.table() for line in self.lines],
            **({"buoy": [as_table(buoy) for buoy in self.buoys]} if self.buoys else {}),
            **({"body": [body.table() for body in self.bodies]} if self.bodies else {}),
            **({"vessel": [vessel.table() for vessel in self.vessels]} if self.vessels else {}),
            "effects": {
                name: {key: plain(value) for key, value in values.items() if value is not None}
                for name, values in self.effects.items()
            },
            "start": as_table(self.start),
            **({} if self.sea is None else {"sea": self.sea.table()}),
            **({"failure": [as_table(failure) for failure in self.failures]} if self.failures else {}),
            **({"notes": list(self.notes)} if self.notes else {}),
            **({"anchor": [as_table(anchor) for anchor in self.anchors]} if self.anchors else {}),
            **({} if self.season is None else {"growth": self.season.table()}),
            **({} if self.fit is None else {"fit": self.fit.table()}),
        }

    def point(self, name: str) -> PointSpec:
        """The point of that name."""
        return point_named(self.points, name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SceneData) and self.to_dict() == other.to_dict()


def point_named(points: tuple[PointSpec, ...], name: str) -> PointSpec:
    return next(point for point in points if point.name == name)


def is_branched(points: tuple[PointSpec, ...], lines: tuple[LineSpec, ...], buoys: tuple[BuoySpec, ...]) -> bool:
    if len(lines) > 1 or buoys or any(point.body for point in points) or lines[0].nodes == "shared":
        return True
    start = next((p for p in points if p.name == lines[0].start), None)
    return start is not None and start.kind == "free" and not lines[0].rigid
