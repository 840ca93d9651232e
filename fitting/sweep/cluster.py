"""Work on a Dask cluster: calls of one function, with results as they finish."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.run.storage import extra


def done_on(scheduler: Any, call: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
    """Numbers of calls and their results, as the workers finish; the call of a dead worker is repeated elsewhere.

    Args:
        scheduler: address of a Dask scheduler, or a client.
        jobs: arguments of each call.

    Raises:
        SceneError: the scheduler cannot be reached.
    """
    distributed = extra("distributed", "sweep")
    own = isinstance(scheduler, str)
    try:
        client = scheduler
        if own:
            client = distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SceneError(f"scheduler: {scheduler}: cannot be reached: {' '.join(str(error).split())}") from None
    try:
        futures = {client.submit(call, *each, pure=False, retries=3): i for i, each in enumerate(jobs)}
        for future in distributed.as_completed(list(futures)):
            yield futures[future], future.result()
            future.release()
    finally:
        if own:
            client.close()
