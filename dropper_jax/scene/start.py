"""`[start]` of a scene: how a run starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    Plain,
    SectionValues,
    Values,
    check_kind_keys,
    plain,
    read_fields,
    read_table,
    short_text,
)
from dropper_jax.scene.line import LineSpec

#: How the start may be given.
_KINDS = {"one line": ("static", "angles", "positions"), "a system of lines": ("static", "positions", "points")}


@dataclasses.dataclass(frozen=True, eq=False)
class StartSpec(SectionValues):
    """`[start]`: configuration and velocities at t = 0.

    `static`: the equilibrium under `release_force` on `release_nodes`, which are released at t = 0. `angles`:
    `zero = "horizontal"` (thesis (4.1)): `d = L (cos p cos a, cos p sin a, -sin p)`; `zero = "down"` (thesis (3.1)):
    `d = L (sin p cos a, sin p sin a, -cos p)`, p polar, a azimuth. `positions`: all nodes, both ends included; of a
    system of lines one line after another, where a line with attached points is one line. `points`, for a system of
    lines: free points are held at their positions in the scene, the lines settle between them, and all are released at
    t = 0.
    """

    FIELDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "static": ("release_nodes", "release_force"),
        "angles": ("polar", "azimuth", "polar_rate", "azimuth_rate", "zero"),
        "positions": ("positions", "velocities"),
        "points": (),
    }

    kind: str = option("how the start is given", choices=tuple(FIELDS), default="static")
    release_nodes: tuple[int, ...] | None = dataclasses.field(
        metadata={"kind": "option", "meaning": "nodes released at t = 0", "type": tuple, "low": 1}, default=None
    )
    release_force: np.ndarray | None = parameter("forces released at t = 0", unit="N", shape="vectors", default=None)
    polar: np.ndarray = parameter("polar angle of each link", unit="rad", shape="table", default=None)
    azimuth: np.ndarray = parameter("azimuth of each link", unit="rad", shape="table", default=None)
    polar_rate: np.ndarray = parameter("rate of the polar angle", unit="rad/s", shape="table", default=None)
    azimuth_rate: np.ndarray = parameter("rate of the azimuth", unit="rad/s", shape="table", default=None)
    zero: str = option("where the polar angle is zero", choices=("horizontal", "down"), default=None)
    positions: np.ndarray = parameter("positions of all nodes", unit="m", shape="vectors", default=None)
    velocities: np.ndarray = parameter("velocities of all nodes", unit="m/s", shape="vectors", default=None)

    @property
    def is_static(self) -> bool:
        """Whether the run starts from an equilibrium."""
        return self.kind == "static"

    @classmethod
    def read(cls, table: Plain, path: str, lines: Sequence[LineSpec], held: bool, branched: bool = False) -> StartSpec:
        """The start of a scene of these lines.

        Args:
            held: whether the end of the first line is fixed.
            branched: whether starts are those of a system of lines.
        """
        line = lines[0]
        values = read_fields(cls, table, path, {})
        kind = values["kind"]
        _check_kind(kind, read_table(table, path), path, branched)
        if len(lines) > 1 and values["release_nodes"] is not None:
            raise SceneError(
                f"{path}.release_nodes: refers to the nodes of a single line; allowed: none in a system of lines"
            )
        if kind == "static":
            _check_release(values["release_nodes"], values["release_force"], path, line.links - held)
        elif kind == "angles":
            values["zero"] = values["zero"] or "horizontal"
            for key in ("polar", "azimuth", "polar_rate", "azimuth_rate"):
                if values[key] is None and key != "polar":
                    values[key] = np.zeros(line.links)
                _check_rows(values[key], f"{path}.{key}", line.links, "entries", "one per link")
        elif kind == "positions":
            rows = rows_of_pieces(lines)
            for key in ("positions", "velocities"):
                if values[key] is None and key != "positions":
                    values[key] = np.zeros((len(rows), 3))
                if np.shape(values[key])[:1] != rows.shape:
                    _check_rows(values[key], f"{path}.{key}", rows[-1] + 1, "rows", "both ends of each line included")
                    values[key] = values[key][rows]
        return cls(**values)


def rows_of_pieces(lines: Sequence[LineSpec]) -> np.ndarray:
    """The row of each node of all pieces, both ends of each included, in a list of the nodes of all lines.

    Two pieces of a line share the row of the point between them.
    """
    found: list[int] = []
    for i, line in enumerate(lines):
        follows = i > 0 and line.piece_of is not None and line.piece_of == lines[i - 1].piece_of
        first = found[-1] + (not follows) if found else 0
        found += range(first, first + line.links + 1)
    return np.array(found)


@raises_first
def _check_kind(kind: str, given: Values, path: str, branched: bool) -> Iterator[Check]:
    what = "a system of lines" if branched else "one line"
    yield kind not in _KINDS[what], f"{path}.kind: {kind!r} does not fit {what}; allowed: {', '.join(_KINDS[what])}"
    check_kind_keys(given, kind, StartSpec.FIELDS, path)


@raises_first
def _check_release(nodes: tuple[int, ...] | None, force: np.ndarray | None, path: str, free: int) -> Iterator[Check]:
    yield (
        (nodes is None) != (force is None),
        f"{path}: `release_nodes` and `release_force` belong together, one of them is missing",
    )
    for i, node in enumerate(nodes or ()):
        yield node > free, f"{path}.release_nodes.{i}: {node} is not a free node; allowed: 1 to {free}"
    if nodes is not None and force is not None:
        yield (
            len(force) != len(nodes),
            f"{path}.release_force: {short_text(plain(force))} has {len(force)} vectors; allowed: {len(nodes)}, one "
            "per node",
        )


@raises_first
def _check_rows(rows: np.ndarray | None, path: str, count: int, what: str, which: str) -> Iterator[Check]:
    if rows is None:
        raise SceneError(f"{path}: missing; needed: {count} {what}, {which}")
    given = len(rows)
    yield given != count, f"{path}: {short_text(plain(rows))} has {given} {what}; allowed: {count}, {which}"


def directions(polar: np.ndarray, azimuth: np.ndarray, zero: str) -> np.ndarray:
    """Unit vectors of links (n, 3) from their angles [rad] (see `StartSpec`)."""
    if zero == "horizontal":
        along = np.cos(polar)
        down = np.sin(polar)
    else:
        along = np.sin(polar)
        down = np.cos(polar)
    return np.stack([along * np.cos(azimuth), along * np.sin(azimuth), -down], axis=-1)
