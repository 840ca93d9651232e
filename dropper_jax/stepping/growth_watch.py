"""Growth of the derivative of a run in reverse mode, which warns once where it predicts no change of a useful size.

The cotangent of the positions passes through the backward pass of a run step by step. A meter passes along with it: a
variable that is 0 in the run itself, whose cotangent holds the largest position cotangent at the first of `SEGMENTS`
times at which it is not 0, and the maximum since then. Their ratio is the growth. A mean over k steps adds a
contribution at every step, so that the cotangent grows by about k: the times are far apart for that reason.
"""

from __future__ import annotations

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

#: Times of a run at which the cotangent is measured.
SEGMENTS = 16
#: Growth, as a power of e, above which a derivative is warned of.
LIMIT = 10.0
MESSAGE = (
    f"the derivative of a run has grown by more than e^{LIMIT:g}: it is that of the computed steps, but predicts no "
    "change of engineering size. Use differences of runs (`fitting.sensitivity.local`), a shorter run or a mean"
)


@jax.custom_jvp
def start_meter(leaves: list[jax.Array]) -> jax.Array:
    """A meter (2,) of zeros, linked to every array with respect to which a run may be differentiated."""
    return jnp.zeros(2, leaves[0].dtype)


@start_meter.defjvp
def _start_meter_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    return start_meter(*primals), _meter_tangent.bind(*tangents[0])


@jax.custom_jvp
def watch(r: jax.Array, meter: jax.Array, at_end: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions (nodes, 3) and the meter, both unchanged; at the end of a segment their cotangent is measured."""
    return r, meter


@watch.defjvp
def _watch_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[Any, Any]:
    dr, dmeter, _ = tangents
    return watch(*primals), tuple(_watched.bind(dr, dmeter, primals[2]))


def _measure(meter: jax.Array, cotangent: jax.Array, at_end: jax.Array) -> jax.Array:
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


# Primitives with transposes of their own: functions with a custom reverse rule have no forward mode in JAX.
_watched = Primitive("watched_positions")
_watched.multiple_results = True
_watched.def_impl(lambda r, meter, at_end: [r, meter])
_watched.def_abstract_eval(lambda r, meter, at_end: [r, meter])
mlir.register_lowering(_watched, lambda _, r, meter, at_end: [r, meter])


def _watched_transpose(cotangents: list[Any], r: Any, meter: Any, at_end: jax.Array) -> list[Any]:
    ct_r, ct_meter = (ad.instantiate_zeros(ct) for ct in cotangents)
    return [
        ct_r if ad.is_undefined_primal(r) else None,
        _measure(ct_meter, ct_r, at_end) if ad.is_undefined_primal(meter) else None,
        None,
    ]


def _watched_batch(args: tuple[jax.Array, ...], dims: tuple[Any, ...]) -> tuple[list[jax.Array], list[int]]:
    size = next(x.shape[d] for x, d in zip(args, dims, strict=True) if d is not batching.not_mapped)
    return _watched.bind(*(batching.bdim_at_front(x, d, size) for x, d in zip(args, dims, strict=True))), [0, 0]


def _watched_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[list[jax.Array], list[jax.Array]]:
    dr, dmeter = (ad.instantiate_zeros(dot) for dot in tangents[:2])
    return _watched.bind(*primals), _watched.bind(dr, dmeter, primals[2])


ad.primitive_jvps[_watched] = _watched_jvp
ad.primitive_transposes[_watched] = _watched_transpose
batching.primitive_batchers[_watched] = _watched_batch

_meter_tangent = Primitive("meter_tangent")
_meter_tangent.def_impl(lambda *x: jnp.zeros(2, x[0].dtype))
_meter_tangent.def_abstract_eval(lambda *x: x[0].update(shape=(2,)))
mlir.register_lowering(_meter_tangent, mlir.lower_fun(lambda *x: jnp.zeros(2, x[0].dtype), multiple_results=False))
batching.primitive_batchers[_meter_tangent] = lambda args, _: (_meter_tangent.bind(*args), batching.not_mapped)


def _meter_transpose(ct: Any, *x: Any) -> list[Any]:
    if not isinstance(ct, ad.Zero):
        jax.debug.callback(_warn, ct)
    return [ad.Zero(a.aval) if ad.is_undefined_primal(a) else None for a in x]


ad.primitive_jvps[_meter_tangent] = lambda x, _: (_meter_tangent.bind(*x), jnp.zeros(2, x[0].dtype))
ad.primitive_transposes[_meter_tangent] = _meter_transpose
