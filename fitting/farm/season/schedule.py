"""The schedule of floats with minimum handling, and their distribution over points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

#: Visits, moved floats, and the floats of each month so far.
FloatPlan = tuple[int, int, list[int]]


def float_schedule(low: Sequence[int], high: Sequence[int], start: int | None = None) -> list[int]:
    """Number of installed floats in every month.

    Of all plans within the bounds, those with the fewest months of change are selected, then those that move the fewest
    floats, and finally the one with the fewest floats. The search goes month by month over numbers that are a bound of
    some month: a change to any other number can be shifted to one of these without another visit or float.

    Args:
        low, high: minimum and maximum floats of each month; where low is above high, low is used.
        start: floats before the first month; their first change is a visit too. None: they are newly installed.
    """
    spans = [(lo, max(lo, hi)) for lo, hi in zip(low, high, strict=True)]
    numbers = set(itertools.chain.from_iterable(spans))
    if start is not None:
        numbers.add(start)
    best: dict[int | None, FloatPlan] = {start: (0, 0, [])}
    for lo, hi in spans:
        best = {n: _best_plan(best, n) for n in sorted(numbers) if lo <= n <= hi}
    return min(best.values(), key=lambda found: (*found[:2], found[2][-1:]))[2]


def _best_plan(best: dict[int | None, FloatPlan], floats: int) -> FloatPlan:
    """The best of the plans by their last number of floats, continued to this number."""
    found = []
    for before, (visits, moved, plan) in best.items():
        if before is not None:
            visits += before != floats
            moved += abs(floats - before)
        found.append((visits, moved, [*plan, floats]))
    return min(found)


def distribute_floats(count: int, need: Sequence[float] | np.ndarray) -> list[int]:
    """Floats distributed over points in proportion to their needs, as whole numbers by largest remainders."""
    wanted = np.maximum(need, 0.0)
    if not wanted.any():
        wanted = np.ones(len(need))
    share = count * wanted / wanted.sum()
    found = share.astype(int)
    order = np.argsort(found - share, kind="stable")
    found[order[: count - found.sum()]] += 1
    return found.tolist()
