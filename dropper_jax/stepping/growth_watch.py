"""Growth of the derivative of a run in reverse mode, which warns once where it predicts no change of a useful size.

The cotangent of the positions passes through the backward pass of a run step by step. A meter passes along with it: a
variable that is 0 in the run itself, whose cotangent holds the largest position cotangent at the first of the measured
times at which it is not 0, and the maximum since then. Their ratio is the growth. A mean over k steps adds a
contribution at every step, so that the cotangent grows by about k: the times are far apart for that reason.
"""

from __future__ import annotations

import functools
import operator
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

#: Minimum number of times of a run at which the cotangent is measured, if it has as many steps.
SEGMENTS = 16
#: Growth, as a power of e, above which a derivative is warned of.
LIMIT = 10.0
MESSAGE = (
    f"the derivative of a run has grown by more than e^{LIMIT:g}: it is that of the computed steps, but predicts no "
    "change of engineering size. Use differences of runs (`fitting.sensitivity.local_derivatives`), a shorter run or "
    "a mean"
)


@jax.custom_jvp
def start_meter(leaves: list[Array]) -> Array:
    """A meter (2,) of zeros, linked to every array with respect to which a run may be differentiated."""
    return jnp.zeros(2, leaves[0].dtype)


@start_meter.defjvp
def _start_meter_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    meter = start_meter(*primals)
    total = functools.reduce(operator.add, map(jnp.sum, tangents[0])).astype(meter.dtype)

    def warn_of(ct: Array) -> Array:
        jax.debug.callback(_warn, ct)
        return jnp.zeros_like(ct)

    return meter, _linear(jnp.zeros_like, warn_of, jnp.broadcast_to(total, meter.shape))


@jax.custom_jvp
def watch(r: Array, meter: Array, at_end: Array) -> tuple[Array, Array]:
    """Positions (nodes, 3) and the meter, both unchanged; at the end of a segment their cotangent is measured."""
    return r, meter


@watch.defjvp
def _watch_jvp(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Any, Any]:
    flat, unravel = ravel_pytree(tangents[:2])

    def measured(ct: Array) -> Array:
        of_r, of_meter = unravel(ct)
        return ravel_pytree((of_r, _measure(of_meter, of_r, primals[2])))[0]

    return watch(*primals), unravel(_linear(lambda x: x, measured, flat))


def _linear(f: Callable[[Array], Array], transposed: Callable[[Array], Array], x: Array) -> Array:
    """f(x) (n,) of a linear map with a transpose of its own, in both modes: the two "solvers" of a linear system.

    Functions with a reverse rule of their own have no forward mode in JAX.
    """
    return jax.lax.custom_linear_solve(lambda y: y, x, lambda _, b: f(b), lambda _, ct: transposed(ct))


def _measure(meter: Array, cotangent: Array, at_end: Array) -> Array:
    """The meter (..., 2) after a cotangent of positions (..., nodes, 3)."""
    size = jnp.max(jnp.abs(cotangent), axis=(-2, -1), initial=0.0)
    first = meter[..., 0]
    largest = meter[..., 1]
    return jnp.stack(
        [
            jnp.where(at_end & (first == 0.0), size, first),
            jnp.where(at_end, jnp.maximum(largest, size), largest),
        ],
        axis=-1,
    )


def _warn(meter: np.ndarray) -> None:
    first, largest = np.moveaxis(np.asarray(meter), -1, 0)
    if np.any((first > 0.0) & ~(largest <= first * np.exp(LIMIT))):
        warnings.warn(MESSAGE, RuntimeWarning, stacklevel=2)
