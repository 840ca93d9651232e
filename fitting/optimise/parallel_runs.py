"""Runs of one design abreast: the first alone, for it compiles what all take, the others over threads.

A compiled run holds no lock of Python's, so that threads are enough, and they share programs and models.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def cores() -> int:
    """Cores that this process may take."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_parallel(
    one: Callable[[A], B], items: Sequence[A], say: Callable[[int], None], workers: int | None = None
) -> list[B]:
    """`one` of each item, in their order.

    Args:
        say: told how many are done, on the calling thread.
        workers: threads; as many as there are cores where left out.

    Raises:
        whatever `one` raises, of the first item that it does for; those not begun are let go.
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
