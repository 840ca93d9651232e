"""Channels: the position of their sensors, their base class, and the measured data of runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.scene import SceneData, WholeLine, whole_lines
from fitting.traces.trace import noise_by_differences

# Position of a sensor on a scene's lines: a line's node, link, end or length along it, or a point of the scene


class Node(NamedTuple):
    """A position between nodes `first` and `second` of all nodes, at the fraction `share` [-]."""

    first: int
    second: int
    share: float


class Where(NamedTuple):
    """Entries of a channel's table that give the position of its sensor; missing ones are empty."""

    line: str | None = None
    link: int | None = None
    node: int | None = None
    end: str | None = None
    at: float | None = None
    point: str | None = None


def line_of(scene: SceneData, name: str | None, path: str) -> WholeLine:
    """The line of this name as specified; a scene with one line needs no name.

    Raises:
        SceneError: no such line.
    """
    lines = whole_lines(scene)
    if name is None and len(lines) == 1:
        return lines[0]
    known = [line.name for line in lines]
    if name not in known:
        raise SceneError(f"{path}.line: {name!r} is not a line of the scene; {nearest(str(name), known)}")
    return lines[known.index(name)]


def node_of(scene: SceneData, where: Where, path: str) -> Node:
    """The position of a sensor on a node, at a point, or at a length along a line.

    Raises:
        SceneError: no position or more than one; a node, point or length that the line does not have.
    """
    _one_of(where, ("node", "end", "at", "point"), path)
    if where.point is not None:
        node = ends_at(scene, where.point, path)[0][0]
        return Node(node, node, 0.0)
    line = line_of(scene, where.line, path)
    if where.at is not None:
        total = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        _inside(where.at, total[-1], line.name, path)
        link = int(np.clip(np.searchsorted(total, where.at, side="right") - 1, 0, line.spec.links - 1))
        share = (where.at - total[link]) / line.spec.length[link]
        return Node(int(line.nodes[link]), int(line.nodes[link + 1]), float(share))
    if where.end is None:
        number = where.node
    else:
        number = _end(where.end, 0, line.spec.links, path)
    if not 0 <= number <= line.spec.links:
        raise SceneError(
            f"{path}.node: {number} is outside line {line.name!r}; allowed: 0 (its first point) to {line.spec.links}"
        )
    return Node(int(line.nodes[number]), int(line.nodes[number]), 0.0)


def link_of(scene: SceneData, where: Where, path: str) -> int:
    """Number, from 0 among all links, of the link that carries a sensor.

    Raises:
        SceneError: no position or more than one; a link or length that the line does not have.
    """
    _one_of(where, ("link", "end", "at"), path)
    line = line_of(scene, where.line, path)
    if where.at is not None:
        total = np.cumsum(line.spec.length)
        _inside(where.at, total[-1], line.name, path)
        number = int(np.searchsorted(total, where.at - 1e-12)) + 1
    else:
        if where.end is None:
            number = where.link
        else:
            number = _end(where.end, 1, line.spec.links, path)
    if not 1 <= number <= line.spec.links:
        raise SceneError(f"{path}.link: {number} is outside line {line.name!r}; allowed: 1 to {line.spec.links}")
    return line.links.start + number - 1


def ends_at(scene: SceneData, point: str, path: str) -> tuple[tuple[int, int, int], ...]:
    """For every line that ends at a point: its node there, the next one, and the link between.

    Raises:
        SceneError: no such point.
    """
    found = tuple(
        (int(line.nodes[node]), int(line.nodes[inner]), line.links.start + min(node, inner))
        for line in whole_lines(scene)
        for node, name in line.stops.items()
        for inner in (node + 1, node - 1)
        if name == point and 0 <= inner <= line.spec.links
    )
    if not found:
        raise SceneError(
            f"{path}.point: {point!r} is not a point of the scene; {nearest(point, [p.name for p in scene.points])}"
        )
    return found


def _end(end: str, first: int, last: int, path: str) -> int:
    if end not in ("from", "to"):
        raise SceneError(f"{path}.end: {end!r} is not an end of a line; allowed: from, to")
    if end == "from":
        return first
    return last


def _inside(at: float, length: float, line: str, path: str) -> None:
    if not 0 <= at <= length:
        raise SceneError(f"{path}.at: {at:g} m is outside line {line!r}; allowed: 0 to {length:g} m")


def _one_of(where: Where, keys: tuple[str, ...], path: str) -> None:
    """Reject a position that is missing, given twice, or given by a key that this kind does not support."""
    given = [key for key in ("link", "node", "end", "at", "point") if getattr(where, key) is not None]
    wrong = [key for key in given if key not in keys]
    if wrong:
        raise SceneError(f"{path}.{wrong[0]}: not a position for this kind of sensor; allowed: {', '.join(keys)}")
    if len(given) != 1:
        if not given:
            what = "position missing"
        else:
            what = f"position given twice, by {' and '.join(given)}"
        raise SceneError(f"{path}: {what}; allowed: one of {', '.join(keys)}")


class SavedMotion(NamedTuple):
    """A motion at saved times.

    Attributes:
        nodes: of all lines, both ends of each included (S + 1, N, 3) [m], including the start.
        middle: the same at the times of the tensions (S, N, 3) [m].
        tension: of the links (S, n) [N].
        spacing: time between saved states [s].
        gravity: [m/s^2].
    """

    nodes: jax.Array
    middle: jax.Array
    tension: jax.Array
    spacing: jax.Array | float = 1.0
    gravity: jax.Array | float = GRAVITY


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
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        """The channel of a table; `common` are the fields of every channel.

        Raises:
            SceneError: a position that the scene does not have, or columns that do not fit.
        """

    @abstractmethod
    def see(self, motion: SavedMotion) -> jax.Array:
        """Output of a perfect sensor (times, columns) [SI]."""

    def mounted(self, position: jax.Array, turn: jax.Array) -> Channel:
        """The channel mounted in this way, for kinds with a `mounting`; differentiable."""
        return self


class Context(NamedTuple):
    """Context for making a channel: the scene, projections of the cameras (3, 4) by number, its path for errors."""

    scene: SceneData
    projections: tuple[tuple[tuple[float, ...], ...], ...]
    path: str


# Measured data: runs with the samples of every channel, their sensors, and the cameras


@dataclass(frozen=True)
class CameraSpec:
    """`[[camera]]`: its projection (3, 4) and its clock: stamp t is taken at `rate t - delay` of the scene's time."""

    name: str
    matrix: tuple[tuple[float, ...], ...]
    delay: float = 0.0
    rate: float = 1.0


@dataclass(frozen=True)
class Sensor:
    """A channel and its assumed sensor: `measured(t) = offset + gain * true(t - delay)` [SI].

    Attributes:
        noise: standard deviation [SI], or a fraction of the value if `relative`; None: estimated from the samples.
    """

    channel: Channel
    noise: float | None = None
    relative: bool = False
    offset: float = 0.0
    gain: float = 1.0
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Run:
    """One run: times (k,) [s] and values (k, m) [SI] of every channel, NaN if missing, and its own scene values."""

    name: str
    t: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    own: dict[str, Any] = field(default_factory=dict)


#: Values (k, m) of every run and channel, or (k, m, ...) of derivatives.
ByChannel = Sequence[Sequence[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Series:
    """Samples in blocks, one for every column of every channel of every run; empty slots are at a block's end.

    Attributes:
        run, source: number of the run, and of the sensor, whose noise is the same in all runs (K,).
        t: times (K, S) [s].
        weight: 1/sigma (K, S, 1), 0 in empty slots.
        decay: decay rate of the noise's autocorrelation (K, 1) [1/s]; None if it is white.
        follows: no block continues another one (K,).
    """

    run: np.ndarray
    source: np.ndarray
    t: np.ndarray
    weight: np.ndarray
    follows: np.ndarray
    decay: np.ndarray | None = None
    jitter: ClassVar[None] = None

    def times(self) -> np.ndarray:
        """Times of all slots (K, S) [s]."""
        return self.t


@dataclass(frozen=True)
class Data:
    """What was measured."""

    sensors: tuple[Sensor, ...]
    cameras: tuple[CameraSpec, ...]
    runs: tuple[Run, ...]

    def columns(self) -> list[tuple[int, int, np.ndarray, int]]:
        """Run, channel, existing samples (k,) and column of every block."""
        return [
            (r, c, known, j)
            for r, run in enumerate(self.runs)
            for c, y in enumerate(run.values)
            for j, known in enumerate(np.isfinite(y).T)
        ]

    def in_blocks(self, values: ByChannel) -> np.ndarray:
        """The values where there are samples (K, S, ...), 0 in empty slots."""
        parts = [values[r][c][known, j] for r, c, known, j in self.columns()]
        slots = max(map(len, parts))
        return np.stack([np.pad(a, [(0, slots - len(a)), *[(0, 0)] * (a.ndim - 1)]) for a in parts])

    def deviations(self, shown: ByChannel) -> np.ndarray:
        """Predicted minus measured values (K, S) [SI]."""
        found = self.in_blocks(shown) - self.in_blocks([run.values for run in self.runs])
        turns = np.array([self.sensors[c].channel.turns for _, c, *_ in self.columns()])
        return found - 2 * np.pi * np.round(found / (2 * np.pi)) * turns[:, None]

    def series(self, sizes: np.ndarray, shown: ByChannel) -> Series:
        """The samples with white noise of these sizes (c,) [SI], relative ones as fractions of predicted values."""
        run, source, *_ = zip(*self.columns(), strict=True)
        t = [[np.tile(t[:, None], y.shape[1]) for t, y in zip(one.t, one.values, strict=True)] for one in self.runs]
        scaled = [list(map(_scale, self.sensors, one)) for one in shown]
        weight = self.in_blocks([[1 / (size * y) for size, y in zip(sizes, one, strict=True)] for one in scaled])
        return Series(np.array(run), np.array(source), self.in_blocks(t), weight[..., None], np.zeros(len(run), bool))

    def first_noise(self) -> np.ndarray:
        """Noise of each channel (c,) from the data's file, otherwise from differences of high order."""
        return np.array([s.noise or self._difference_noise(c) for c, s in enumerate(self.sensors)])

    def _difference_noise(self, channel: int) -> float:
        """Standard deviation of white noise on a smooth motion, by differences of high order."""
        values = [run.values[channel] for run in self.runs]
        sizes = np.concatenate([noise_by_differences(y) for y in values])
        level = max(float(np.nanmax(np.abs(y))) for y in values)
        spread = max(float(np.nanstd(y, axis=0).max()) for y in values)
        if np.isfinite(sizes).any():
            found = float(np.nanmedian(sizes))
        else:
            found = 0.1 * spread
        return max(found, 1e-6 * level, 1e-12)


def _scale(sensor: Sensor, values: np.ndarray) -> np.ndarray:
    """Scale of a sensor's noise at these values (k, m): 1, or the value if the noise is a fraction of it."""
    if not sensor.relative:
        return np.ones_like(values)
    # a reading of 0 is not exact: at least 5 % of the channel's RMS
    return np.maximum(np.abs(values), 0.05 * np.sqrt(np.nanmean(values**2)))
