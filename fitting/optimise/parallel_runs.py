"""Parallel runs of one design: the first alone, because it compiles the shared programs, the others on threads.

A compiled run does not hold Python's lock, so that threads suffice, and they share programs and models.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def cores() -> int:
    """Number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_parallel(
    one: Callable[[A], B], items: Sequence[A], say: Callable[[int], None], workers: int | None = None
) -> list[B]:
    """`one` of each item, in order.

    Args:
        say: called with the number of finished items, on the calling thread.
        workers: number of threads; default: one per core.

    Raises:
        The first exception of `one`, in the order of the items; items that have not started are cancelled.
    """
    found: list[B] = []
    with ThreadPoolExecutor(workers or cores()) as pool:
        head = [one(item) for item in items[:1]]
        futures = [pool.submit(one, item) for item in items[1:]]
        try:
            for i, value in enumerate([*head, *futures]):
                found.append(value if i < len(head) else value.result())
                say(i + 1)
        except BaseException:
            for future in futures:
                future.cancel()
            raise
    return found
