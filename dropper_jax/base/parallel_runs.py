"""Parallel runs of one design: the first alone, because it compiles the shared programs, the others on threads.

A compiled run does not hold Python's lock, so that threads suffice, and they share programs and models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from dropper_jax.base.machine import available_cores

A = TypeVar("A")
B = TypeVar("B")


def run_parallel(
    one: Callable[[A], B], items: Sequence[A], say: Callable[[int], None], workers: int | None = None, alone: int = 1
) -> list[B]:
    """`one` of each item, in order.

    Args:
        say: called with the number of finished items, on the calling thread.
        workers: number of threads; default: one per core.
        alone: number of items that run before the others start.

    Raises:
        The first exception of `one`, in the order of the items; items that have not started are cancelled.
    """
    found: list[B] = []
    with ThreadPoolExecutor(workers or available_cores()) as pool:

        def results() -> Iterator[B]:
            yield from map(one, items[:alone])
            yield from pool.map(one, items[alone:])

        try:
            for value in results():
                found.append(value)
                say(len(found))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return found
