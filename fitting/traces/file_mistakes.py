"""Mistakes that a file of angles may contain, each with the correction of its angles.

All angles here are theta (k, n) [rad] in the convention of the file: a row for each frame, and a column for each link
from the first hook on. Checks of a trace try one `Correction` after another and report the one that helps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from fitting.traces.trace import Convention


class Correction(NamedTuple):
    """A mistake and its correction in words, and the correction as a function from angles (k, n) [rad] to others."""

    mistake: str
    fix: str
    apply: Callable[[np.ndarray], np.ndarray]


def corrections(links: int) -> Iterator[Correction]:
    """Corrections of mirrored links, relative angles and other orders of columns."""
    mirrors = (
        ("has the wrong sign", "reverse the sign of", lambda theta: -theta),
        ("is measured from the link's other end", "add half a turn to", lambda theta: theta + np.pi),
        ("is mirrored", "use half a turn minus the angles of", lambda theta: np.pi - theta),
    )
    for mistake, fix, mirror in mirrors:
        for j in range(links):
            name = f"theta_{j + 1}"
            yield Correction(f"{name} {mistake}", f"{fix} {name}", _of_column(j, mirror))
    # a wrong sign of all angles is a matter of the convention
    yield Correction("all links are mirrored (seen from behind)", "use half a turn minus all angles", mirrors[2][2])
    if links > 1:
        fix = "add up the angles from theta_1 on"
        yield Correction("angles are relative to the link before", fix, lambda theta: np.cumsum(theta, axis=1))
        fix = "name the columns from the first hook on"
        if links > 2:  # with two links they are swapped
            yield Correction("columns are in the reverse order", fix, lambda theta: theta[:, ::-1])
        mistake = "columns are in the reverse order, and links measured from their other end"
        yield Correction(mistake, fix, lambda theta: theta[:, ::-1] + np.pi)
    for j, k in combinations(range(links), 2):
        names = f"theta_{j + 1} and theta_{k + 1}"
        order = np.arange(links)
        order[[j, k]] = k, j
        yield Correction(f"{names} are swapped", f"swap {names}", _with_columns(order))
    if links > 2:
        for by in range(1, links):
            fix = f"theta_1 belongs in column theta_{by + 1}"
            yield Correction(f"columns are shifted by {by}", fix, _with_columns(np.roll(np.arange(links), by)))


def _of_column(j: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """The change of one column alone."""
    return lambda theta: np.where(np.arange(theta.shape[1]) == j, change(theta), theta)


def _with_columns(order: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Other columns: number j becomes the one that is number `order[j]` in the file."""
    return lambda theta: theta[:, order]


def shifted_zero(j: int | None, by: float) -> Correction:
    """Angles of column j, or of all columns for None, that are too small by `by` [rad]."""

    def add(theta: np.ndarray) -> np.ndarray:
        return theta + by

    if j is None:
        name = "all columns"
        more = ", or free camera.offset"
        change = add
    else:
        name = f"theta_{j + 1}"
        more = ""
        change = _of_column(j, add)
    fix = f"add {by:.3g} rad to {name}{more}"
    return Correction(f"the zero of {name} is shifted by {-by:.3g} rad", fix, change)


def late_columns(links: int, frames: Sequence[int]) -> Iterator[Correction]:
    """One column that is late or early by one of these numbers of frames.

    A column that is N frames late shows in row i the angle of row i - N.
    """
    directions = ((1, "late", "up"), (-1, "early", "down"))
    for j, count, (sign, when, where) in product(range(links), frames, directions):
        name = f"theta_{j + 1}"
        move = partial(_shift_frames, by=count * sign)
        fix = f"move {name} {where} by {count} rows"
        yield Correction(f"{name} is {count} frames {when}", fix, _of_column(j, move))


def _shift_frames(theta: np.ndarray, by: int) -> np.ndarray:
    """The angles of `by` frames later, or earlier if negative; NaN where the trace has none."""
    moved = np.full_like(theta, np.nan)
    if by > 0:
        moved[:-by] = theta[by:]
    else:
        moved[-by:] = theta[:by]
    return moved


def other_unit(named: Convention) -> Iterator[Correction]:
    """Angles in the unit that is not the stated one."""
    if named.unit == "deg":
        yield Correction("the unit is rad", "--unit rad", np.degrees)
    else:
        yield Correction("the unit is deg", "--unit deg", np.radians)
