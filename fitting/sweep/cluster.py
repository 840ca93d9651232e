"""Work on a Dask cluster: calls of one function, with results as they finish."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.run.storage import extra

#: Time [s] after which a scheduler that does not answer cannot be reached.
CONNECT_TIMEOUT = 10
#: Number of times that a call is repeated elsewhere if its worker dies or the call fails.
RETRIES = 3


def run_on_cluster(
    scheduler: Any, call: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[int, Any]]:
    """Numbers of calls and their results, as the workers finish; the call of a dead worker is repeated elsewhere.

    Args:
        scheduler: address of a Dask scheduler, or a client.
        jobs: arguments of each call.

    Raises:
        SceneError: the scheduler cannot be reached.
    """
    distributed = extra("distributed", "sweep")
    is_address = isinstance(scheduler, str)
    try:
        client = scheduler
        if is_address:
            client = distributed.Client(scheduler, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise SceneError(f"scheduler: {scheduler}: cannot be reached: {' '.join(str(error).split())}") from None
    try:
        futures = {}
        for number, arguments in enumerate(jobs):
            # equal calls are separate runs
            future = client.submit(call, *arguments, pure=False, retries=RETRIES)
            futures[future] = number
        for future in distributed.as_completed(list(futures)):
            yield futures[future], future.result()
            future.release()
    finally:
        if is_address:
            client.close()
