"""`[start]` of a scene: how a run starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raise_first
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection, as_table, check_kind_keys, plain, short_text
from dropper_jax.scene.line import LineSpec

#: How the start may be given.
_KINDS = {"one line": ("static", "angles", "positions"), "a system of lines": ("static", "positions", "points")}


@section
class StartSpec(DeclaredSection):
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
    release_nodes: tuple[int, ...] | None = field(
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

    def of_lines(self, lines: Sequence[LineSpec], held: bool, branched: bool) -> StartSpec:
        """The start of these lines, checked: a row for each link or node, zeros where rates are not given.

        Args:
            held: whether the end of the first line is fixed.
            branched: whether starts are those of a system of lines.
        """
        raise_first(self._line_checks(lines, held, branched), "start")
        if self.kind == "angles":
            found = self._full_arrays(np.arange(lines[0].links), "entries", "one per link")
            return replace(self, zero=self.zero or "horizontal", **found)
        if self.kind == "positions":
            found = self._full_arrays(rows_of_pieces(lines), "rows", "both ends of each line included")
            return replace(self, **found)
        return self

    def _line_checks(self, lines: Sequence[LineSpec], held: bool, branched: bool) -> Iterator[Check]:
        """Checks of the kind, of its keys, and of the released nodes."""
        what = "one line"
        if branched:
            what = "a system of lines"
        yield (
            self.kind not in _KINDS[what],
            f"kind: {self.kind!r} does not fit {what}; allowed: {', '.join(_KINDS[what])}",
        )
        check_kind_keys(as_table(self), self.kind, self.FIELDS, "start")
        nodes = self.release_nodes or ()
        free = lines[0].links - held
        yield (
            bool(nodes) and len(lines) > 1,
            "release_nodes: refers to the nodes of a single line; allowed: none in a system of lines",
        )
        yield (
            (self.release_nodes is None) != (self.release_force is None),
            ": `release_nodes` and `release_force` belong together, one of them is missing",
        )
        for i, node in enumerate(nodes):
            yield node > free, f"release_nodes.{i}: {node} is not a free node; allowed: 1 to {free}"
        forces = self.release_force
        if forces is not None:
            words = f"release_force: {short_text(plain(forces))} has {len(forces)} vectors"
            yield len(forces) != len(nodes), f"{words}; allowed: {len(nodes)}, one a node"

    def _full_arrays(self, rows: np.ndarray, counted: str, which: str) -> dict[str, np.ndarray]:
        """Arrays of the kind's keys, of which the first must be given; others are zero where they are not.

        Args:
            rows: the row of each link or node in an array as the user writes it (see `rows_of_pieces`); an array may
                also have a row for each already.
            counted, which: the rows and what they are, as messages have them.

        Raises:
            SceneError: a missing array, or another number of rows.
        """
        count = rows[-1] + 1
        needed, *others = (key for key in self.FIELDS[self.kind] if key != "zero")  # which is not an array
        if getattr(self, needed) is None:
            raise SceneError(f"start.{needed}: missing; needed: {count} {counted}, {which}")
        found = {}
        for key in (needed, *others):
            given = getattr(self, key)
            if given is None:
                given = np.zeros_like(found[needed])
            if len(given) not in (len(rows), count):
                raise SceneError(
                    f"start.{key}: {short_text(plain(given))} has {len(given)} {counted}; allowed: {count}, {which}"
                )
            if len(given) != len(rows):
                given = given[rows]
            found[key] = given
        return found


def rows_of_pieces(lines: Sequence[LineSpec]) -> np.ndarray:
    """The row of each node of all pieces, both ends of each included, in a list of the nodes of all lines.

    Two pieces of a line share the row of the point between them.
    """
    found: list[int] = []
    first = 0
    before = None  # the line of which the last piece was cut
    for line in lines:
        if line.piece_of is not None and line.piece_of == before:
            first -= 1
        found += range(first, first + line.links + 1)
        first += line.links + 1
        before = line.piece_of
    return np.array(found)


def directions(polar: Any, azimuth: Any, zero: str) -> Any:
    """Unit vectors of links (n, 3) from their angles [rad], arrays of NumPy or JAX.

    horizontal: (cos p cos a, cos p sin a, -sin p), the thesis' (4.3)-(4.5); down: (sin p cos a, sin p sin a, -cos p).
    """
    xp = polar.__array_namespace__()
    along = xp.cos(polar)
    down = xp.sin(polar)
    if zero != "horizontal":
        along = xp.sin(polar)
        down = xp.cos(polar)
    return xp.stack([along * xp.cos(azimuth), along * xp.sin(azimuth), -down], axis=-1)
