"""Schedule of floats with minimum handling: the fewest visits, and among these the fewest floats moved."""

from __future__ import annotations

from collections.abc import Sequence


def schedule(low: Sequence[int], high: Sequence[int], start: int | None = None) -> list[int]:
    """Number of installed floats in every month.

    Of all plans within the bounds, those with the fewest months of change are selected, then those that move the fewest
    floats, and finally the one with the fewest floats. The search goes month by month over numbers that are a bound of
    some month: a change to any other number can be shifted to one of these without another visit or float.

    Args:
        low, high: minimum and maximum floats of each month; where low is above high, low is used.
        start: floats before the first month; their first change is a visit too. None: they are newly installed.
    """
    spans = [(lo, max(lo, hi)) for lo, hi in zip(low, high, strict=True)]
    numbers = sorted({n for span in spans for n in span} | ({start} if start is not None else set()))
    best: dict[int, tuple[tuple[int, int], list[int]]] = {}
    for month, (lo, hi) in enumerate(spans):
        after = {}
        for n in (n for n in numbers if lo <= n <= hi):
            if month == 0:
                moved = 0 if start is None else abs(n - start)
                after[n] = ((int(moved > 0), moved), [n])
                continue
            cost, plan = min(
                ((visits + (n != before), moved + abs(n - before)), plan)
                for before, ((visits, moved), plan) in best.items()
            )
            after[n] = (cost, [*plan, n])
        best = after
    return min(best.values(), key=lambda found: (found[0], found[1][-1]))[1] if spans else []


def spread(count: int, need: Sequence[float]) -> list[int]:
    """Floats distributed over points in proportion to their needs, as whole numbers by largest remainders."""
    total = sum(max(x, 0.0) for x in need)
    share = [count * max(x, 0.0) / total if total > 0.0 else count / len(need) for x in need]
    found = [int(x) for x in share]
    order = sorted(range(len(need)), key=lambda i: found[i] - share[i])
    for i in order[: count - sum(found)]:
        found[i] += 1
    return found
