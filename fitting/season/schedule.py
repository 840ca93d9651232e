"""Schedule of floats with least handling: as few visits as can be, and on them as few floats moved as can be."""

from __future__ import annotations

from collections.abc import Sequence


def schedule(low: Sequence[int], high: Sequence[int], start: int | None = None) -> list[int]:
    """Floats in place in every month.

    Of all plans within the bounds those with the fewest months in which the number changes, of these one that moves
    the fewest floats, of these that with fewest floats at last. Found month by month over the numbers that are a bound
    of some month: a plan that changes to another number can be slid to one of these without another visit or float.

    Args:
        low, high: least and most floats of each month; where low is above high, low is taken.
        start: floats in place before the first month; their first change is a visit too. None: they are set out fresh.
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
    """Floats over points in proportion to what each needs, whole numbers by largest remainders."""
    total = sum(max(x, 0.0) for x in need)
    share = [count * max(x, 0.0) / total if total > 0.0 else count / len(need) for x in need]
    found = [int(x) for x in share]
    order = sorted(range(len(need)), key=lambda i: found[i] - share[i])
    for i in order[: count - sum(found)]:
        found[i] += 1
    return found
