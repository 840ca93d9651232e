"""Channels: their base classes, for sensors at a node and for those on a link."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Table, Values
from dropper_jax.scene import SceneData
from fitting.channels.position import Node, find_link, find_node


class SavedMotion(NamedTuple):
    """A motion at saved times.

    Attributes:
        nodes: of all lines, both ends of each included (S + 1, N, 3) [m], including the start.
        middle: the same at the times of the tensions (S, N, 3) [m].
        tension: of the links (S, n) [N].
        spacing: time between saved states [s].
        gravity: [m/s^2].
    """

    nodes: Array
    middle: Array
    tension: Array
    spacing: Array | float = 1.0
    gravity: Array | float = GRAVITY


@dataclass(frozen=True)
class Channel(ABC):
    """Static: part of the compiled program's key.

    Attributes:
        name: of the channel.
        columns: of the file.
        unit: of the columns.
        camera: number of the camera whose clock gives the time stamps; None: the scene's own time.
    """

    kind: ClassVar[str]
    #: SI unit of the measured quantity.
    measures: ClassVar[str]
    #: Whether its values are at the times of tensions.
    of_tension: ClassVar[bool] = False
    #: Whether values that differ by whole turns are equal.
    turns: ClassVar[bool] = False
    #: Whether it is a single number, in one column.
    scalar: ClassVar[bool] = True
    #: Rows at either end of the saved motion that its values lack, because it takes differences.
    margin: ClassVar[int] = 0
    #: Why it has no value at some times; empty if it always has one.
    without_value: ClassVar[str] = ""
    #: Numbers of how it is mounted, and their units: fields that `mounted` sets.
    mounting: ClassVar[dict[str, str]] = {}
    #: Keys of its table in addition to those of all channels.
    KEYS: ClassVar[tuple[str, ...]] = ()

    name: str
    columns: tuple[str, ...]
    unit: str
    camera: int | None = None

    @classmethod
    @abstractmethod
    def sensor_fields(cls, given: Given) -> Table:
        """Fields by name that only this kind has, and those that give the position of the sensor.

        Raises:
            SceneError: a position that the scene does not have, or columns that do not fit.
        """

    @abstractmethod
    def see(self, motion: SavedMotion) -> Array:
        """Output of a perfect sensor (times, columns) [SI]."""

    def mounted(self, position: Array, turn: Array) -> Channel:
        """The channel mounted in this way, for kinds with a `mounting`; differentiable."""
        return self


class Given(NamedTuple):
    """What a channel is made of.

    Attributes:
        table: its entries; path: that of the table, for errors.
        common: fields that every channel has, by name.
        scene: the measured scene; projections: of the cameras (3, 4) by number.
    """

    table: Values
    path: str
    common: Table
    scene: SceneData
    projections: tuple[tuple[tuple[float, ...], ...], ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Its columns in the file."""
        return self.common["columns"]


@dataclass(frozen=True)
class AtNode(Channel):
    """A sensor at a node, or at a fraction of the way between two."""

    node: Node = Node(0, 0, 0.0)

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        return {"node": find_node(given.scene, given.table, given.path)}

    def positions(self, motion: SavedMotion) -> Array:
        """Positions of the sensor (times, 3) [m]."""
        first = motion.nodes[:, self.node.first]
        return first + self.node.share * (motion.nodes[:, self.node.second] - first)


@dataclass(frozen=True)
class OnLink(Channel):
    """A sensor that moves with a link, between its nodes `first` and `second`."""

    first: int = 0
    second: int = 1

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        line, link = find_link(given.scene, given.table, given.path)
        return {"first": int(line.nodes[link]), "second": int(line.nodes[link + 1])}

    def links(self, motion: SavedMotion) -> Array:
        """Vectors (times, 3) [m] from the link's first to its second node."""
        return motion.nodes[:, self.second] - motion.nodes[:, self.first]
