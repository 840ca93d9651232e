"""Tension tabulated over strain: reading, checking, and the slopes of the curve through the rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Table, Values, plain, read_list, read_number, refuse

ALLOWED_ROWS = "two or more rows of rising strain; tension starting at 0, never falling, rising at the end"


@dataclasses.dataclass(frozen=True, eq=False)
class ForceTable:
    """Rows of strain (k,) [-], `(|d| - L)/L`, and tension (k,) [N]; the line is slack up to the first strain."""

    strain: np.ndarray
    tension: np.ndarray

    @classmethod
    def read(cls, strain: Plain, tension: Plain, path: str) -> ForceTable:
        """A checked table.

        Raises:
            SceneError: an entry is not a number, the numbers of rows differ, strain does not rise, the first strain is
                negative, the first tension is not 0, tension falls, or does not rise at the end.
        """
        e = _read_column(strain, f"{path}.strain", "-")
        force = _read_column(tension, f"{path}.tension", "N")
        if len(e) < 2:
            raise refuse(f"{path}.strain", plain(e), "has too few rows", ALLOWED_ROWS)
        if len(force) != len(e):
            raise refuse(f"{path}.tension", plain(force), f"has {len(force)} rows", f"{len(e)}, as many as `strain`")
        if e[0] < 0.0 or np.any(np.diff(e) <= 0.0):
            raise refuse(f"{path}.strain", plain(e), "does not rise from 0 or above", ALLOWED_ROWS)
        if force[0] != 0.0 or np.any(np.diff(force) < 0.0) or force[-1] == force[-2]:
            raise refuse(f"{path}.tension", plain(force), "does not rise from 0", ALLOWED_ROWS)
        return cls(e, force)

    @classmethod
    def straight(cls, EA: float) -> ForceTable:
        """The table of a rope of constant stiffness [N]."""
        return cls(np.array([0.0, 1.0]), np.array([0.0, EA]))

    @property
    def secants(self) -> np.ndarray:
        return np.diff(self.tension) / np.diff(self.strain)

    @property
    def stiffness(self) -> float:
        """Maximum slope between two rows [N]: the reference of a damping ratio and the scale of residuals."""
        return float(np.max(self.secants))

    def slopes(self) -> np.ndarray:
        """Slopes of the curve at its rows (k,) [N]: monotone, once continuously differentiable.

        Inside the table, the weighted harmonic mean of both secants, and 0 next to a level interval (Fritsch and
        Butland 1984). At the ends, the secant there, so that the curve continues straight beyond the last row.
        """
        width = np.diff(self.strain)
        secant = self.secants
        first = 2 * width[1:] + width[:-1]
        second = width[1:] + 2 * width[:-1]
        level = (secant[1:] == 0.0) | (secant[:-1] == 0.0)
        before = np.where(level, 1.0, secant[:-1])
        after = np.where(level, 1.0, secant[1:])
        inner = np.where(level, 0.0, (first + second) / (first / before + second / after))
        return np.concatenate([secant[:1], inner, secant[-1:]])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ForceTable):
            return False
        return np.array_equal(self.strain, other.strain) and np.array_equal(self.tension, other.tension)

    __hash__ = None


def _read_column(values: Plain, path: str, unit: str) -> np.ndarray:
    items = read_list(values, path, None, ALLOWED_ROWS)
    return np.array([read_number(x, f"{path}.{i}", {"unit": unit}) for i, x in enumerate(items)], float)


def read_tables(table: Values, path: str, links: int) -> tuple[ForceTable, ...]:
    """One table per link from `strain` and `tension`: lists of numbers for all links, or one such list per link."""
    for key in ("strain", "tension"):
        if key not in table:
            raise SceneError(f"{path}.{key}: missing; needed: {ALLOWED_ROWS}")
    strain = plain(table["strain"])
    tension = plain(table["tension"])
    if not _is_nested(strain) and not _is_nested(tension):
        return (ForceTable.read(strain, tension, path),) * links
    allowed = f"{links} lists, one per link"
    strains = read_list(strain, f"{path}.strain", links, allowed)
    tensions = read_list(tension, f"{path}.tension", links, allowed)
    return tuple(ForceTable.read(strains[i], tensions[i], f"{path}.{i}") for i in range(links))


def _is_nested(column: Plain) -> bool:
    return isinstance(column, list) and any(isinstance(row, list) for row in column)


def tables_of(tables: Sequence[ForceTable]) -> Table:
    """Plain values from which `read_tables` reconstructs the tables."""
    if all(t == tables[0] for t in tables):
        return {"strain": plain(tables[0].strain), "tension": plain(tables[0].tension)}
    return {"strain": [plain(t.strain) for t in tables], "tension": [plain(t.tension) for t in tables]}


def stack_tables(tables: Sequence[ForceTable]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain, tension and slope, each (n, k), of tables extended to equal numbers of rows along their last slope."""
    rows = max(len(t.strain) for t in tables)
    found = np.empty((3, len(tables), rows))
    for i, table in enumerate(tables):
        count = len(table.strain)
        found[:, i, :count] = table.strain, table.tension, table.slopes()
        more = np.arange(1, rows - count + 1)
        slope = found[2, i, count - 1]
        found[:, i, count:] = table.strain[-1] + more, table.tension[-1] + slope * more, slope + 0 * more
    strain, tension, slope = found
    return strain, tension, slope
