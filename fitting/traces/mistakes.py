"""Possible mistakes of a trace file, each with its correction and the change of the angles that undoes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from fitting.traces.trace import Convention


class Change(NamedTuple):
    """A mistake in words, its correction, and the change of the angles (k, n) [rad] in the file's convention."""

    mistake: str
    fix: str
    apply: Callable[[np.ndarray], np.ndarray]


def in_model(theta: np.ndarray, at: Convention) -> np.ndarray:
    """Angles [rad] of a convention, from the horizontal and positive downwards."""
    theta = at.sign * theta
    return np.pi / 2 - theta if at.zero == "down" else theta


def changes(links: int) -> Iterator[Change]:
    """Changes without a number: mirrored links, relative angles, other orders of columns."""
    mirrors = (
        ("has the wrong sign", "reverse the sign of", lambda theta: -theta),
        ("is measured from the link's other end", "add half a turn to", lambda theta: theta + np.pi),
        ("is mirrored", "use half a turn minus the angles of", lambda theta: np.pi - theta),
    )
    for mistake, fix, mirror in mirrors:
        for j in range(links):
            name = f"theta_{j + 1}"
            yield Change(f"{name} {mistake}", f"{fix} {name}", _of_column(j, mirror))
    # a wrong sign of all angles is a matter of the convention
    yield Change("all links are mirrored (seen from behind)", "use half a turn minus all angles", mirrors[2][2])
    if links > 1:
        total = lambda theta: np.cumsum(theta, axis=1)  # noqa: E731
        yield Change("angles are relative to the link before", "add up the angles from theta_1 on", total)
        fix = "name the columns from the first hook on"
        if links > 2:  # with two links they are swapped
            yield Change("columns are in the reverse order", fix, lambda theta: theta[:, ::-1])
        turned = lambda theta: theta[:, ::-1] + np.pi  # noqa: E731
        yield Change("columns are in the reverse order, and links measured from their other end", fix, turned)
    for j, k in combinations(range(links), 2):
        names = f"theta_{j + 1} and theta_{k + 1}"
        yield Change(f"{names} are swapped", f"swap {names}", _with_columns(_swap_links(links, j, k)))
    for by in range(1, links if links > 2 else 0):
        order = np.roll(np.arange(links), by)
        fix = f"theta_1 belongs in column theta_{by + 1}"
        yield Change(f"columns are shifted by {by}", fix, _with_columns(order))


def _of_column(j: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: np.where(np.arange(theta.shape[1]) == j, change(theta), theta)


def _with_columns(order: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: theta[:, order]


def _swap_links(links: int, j: int, k: int) -> np.ndarray:
    order = np.arange(links)
    order[[j, k]] = k, j
    return order


def shift(j: int | None, by: float) -> Change:
    """The zero of column j, or of all for None, shifted by -by [rad]."""
    name = "all columns" if j is None else f"theta_{j + 1}"
    mistake = f"the zero of {name} is shifted by {-by:.3g} rad"
    add = lambda theta: theta + by  # noqa: E731
    fix = f"add {by:.3g} rad to {name}" + (", or free camera.offset" if j is None else "")
    return Change(mistake, fix, add if j is None else _of_column(j, add))


def late_columns(links: int, frames: Sequence[int]) -> Iterator[Change]:
    """One column some frames later or earlier than the others."""
    for j, by, sign in product(range(links), frames, (1, -1)):
        name, when, where = f"theta_{j + 1}", *(("late", "up") if sign > 0 else ("early", "down"))
        move = partial(_shift_frames, by=by * sign)
        yield Change(f"{name} is {by} frames {when}", f"move {name} {where} by {by} rows", _of_column(j, move))


def _shift_frames(theta: np.ndarray, by: int) -> np.ndarray:
    moved = np.full_like(theta, np.nan)
    if by > 0:
        moved[:-by] = theta[by:]
    else:
        moved[-by:] = theta[:by]
    return moved


def units(named: Convention) -> Iterator[Change]:
    """The unit that is not the named one."""
    factor, unit = (180 / np.pi, "rad") if named.unit == "deg" else (np.pi / 180, "deg")
    yield Change(f"the unit is {unit}", f"--unit {unit}", lambda theta: factor * theta)
