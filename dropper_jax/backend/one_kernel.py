"""A function as one kernel on the CPU, by a tag on its call that XLA's compiler reads.

XLA launches the fused operations of a step, some 50 of them, one by one. The launches take longer than the operations.
A tagged call becomes a single function instead, if nothing inside it calls a library (LAPACK), scatters or sorts.

Two properties of the compiler make the tag unsafe on a plain call. It ends the process if a parameter of the call has
no reader left after optimisation, and it cannot compile library calls there. Therefore all arguments are packed into
one array, one element of which is added to a result. A function is tagged only if all its operations are known to be
compiled inline (`INLINE`). Every other function is called unchanged.
"""

from __future__ import annotations

import functools
import importlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend import core
from jax.interpreters import ad, batching, mlir

from dropper_jax.backend import is_plain
from dropper_jax.backend.primitives import INLINE

P = ParamSpec("P")
R = TypeVar("R")

#: Where JAX has the call that carries a tag: 0.11 and later, 0.9.2 to 0.10.
TAGGED_CALLS = (
    ("jax.experimental.xla_metadata", "xla_metadata_call2"),
    ("jax.experimental.scheduling_groups", "xla_metadata_call"),
)
#: Operations of kernels in a kernel.
OF_KERNELS = ("one_kernel", *(name for _, name in TAGGED_CALLS))
TAG_NAME = "xla_cpu_small_call"
TAG = {TAG_NAME: "true", "inlineable": "false"}
#: Number of elements up to which XLA compiles a reduction inline where it gives larger ones to a library (YNNPACK).
LARGEST_REDUCTION = 4096
#: Types that float64 contains exactly, and those of its width, whose bits are used.
WIDENED = frozenset(("bool", "int8", "int16", "int32", "uint8", "uint16", "uint32", "float32"))
SAME_WIDTH = frozenset(("float64", "int64", "uint64"))
#: Whether what is traced is inside a kernel already. Part of the keys of JAX's own caches.
_INSIDE_KERNEL = jax.make_user_context(False)


def one_kernel(f: Callable[P, R]) -> Callable[P, R]:
    """`jax.jit(f)` as one kernel on the CPU where possible: a run is two to five times as fast.

        run = dj.one_kernel(lambda model, s: dj.integrate(stepper, model, s, 0.01, 1000)[0].r)
        slope = dj.one_kernel(jax.grad(loss))

    The result is that of `f`. Derivatives and batches of the returned function are those of the plain `f`, so the
    outermost `grad` or batch is what should be one kernel. A function with library calls (the `dense` solver, sorting),
    callbacks or scattered updates, and one of sharded arguments, is compiled as usual.

    Args:
        f: a pure function of pytrees of arrays.

    Returns:
        The compiled function.
    """

    @functools.wraps(f)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if not _kernels_allowed():
            return f(*args, **kwargs)
        traced = _trace_call(f, args, kwargs)
        if not _can_be_tagged(traced):
            return f(*args, **kwargs)  # traced again: outside a kernel it may call Python
        return traced.call(tagged=True)

    return jax.jit(call)


def lower_kernel(
    f: Callable[..., object], values: Sequence[object], max_operations: int
) -> tuple[jax.stages.Lowered, bool]:
    """`f` lowered for values like these, as one kernel where possible, and whether it is one.

    Args:
        max_operations: number of operations above which it does not become one.
    """
    is_kernel = False

    @functools.wraps(f)
    def call(*args: object) -> object:
        nonlocal is_kernel
        if not _kernels_allowed():
            return f(*args)
        traced = _trace_call(f, args, {})
        is_kernel = _can_be_tagged(traced) and count_operations(traced.program.jaxpr) <= max_operations
        return traced.call(tagged=is_kernel)

    lowered = jax.jit(call).lower(*values)
    return lowered, is_kernel  # set while the line above traces `call`


def _kernels_allowed() -> bool:
    """Whether a call may be tagged here: not inside another kernel."""
    return tags_enabled() and not _INSIDE_KERNEL.value


def count_operations(jaxpr: core.Jaxpr) -> int:
    """Number of operations of a traced function, those of its loops and calls among them."""
    return sum(1 + sum(map(count_operations, _inner_jaxprs(eqn))) for eqn in jaxpr.eqns)


def tags_enabled() -> bool:
    """Whether calls can be tagged: on the CPU, in float64, by a JAX that has such calls."""
    if is_plain():
        return False
    return jax.default_backend() == "cpu" and jax.config.jax_enable_x64 and _tagged_call() is not None


def forbids_callbacks() -> bool:
    """Whether callbacks to Python must be avoided: they prevent a function from becoming one kernel, and JAX runs them
    on the CPU, which `JAX_PLATFORMS=cuda` hides."""
    return _INSIDE_KERNEL.value or not _has_cpu()


@functools.cache
def _has_cpu() -> bool:
    """Whether JAX may use the CPU."""
    try:
        return bool(jax.local_devices(backend="cpu"))
    except RuntimeError:
        return False


def separate_call(f: Callable[P, R]) -> Callable[P, R]:
    """`f` as a separate function in the compiled program; `f` itself if this JAX has no such calls.

    Its results are stored. Otherwise the compiler may compute them again for each operation that reads them.
    """
    call = None if is_plain() else _tagged_call()
    if call is None:
        return f
    return call(f, {"inlineable": "false"})


@functools.cache
def _tagged_call() -> Callable[..., Any] | None:
    """JAX's call of a function with a tag (function, tag); None if this JAX has none."""
    for module, name in TAGGED_CALLS:
        try:
            call = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError):
            continue
        if name == "xla_metadata_call2":
            return call
        return functools.partial(_call_with_keywords, call)
    return None


def _call_with_keywords(call: Callable[..., Any], f: Callable[P, R], tag: dict[str, str]) -> Callable[P, R]:
    """`f` by the tagged call of JAX 0.9.2 to 0.10, which takes the tag as keywords."""
    return call(f, **tag)


def _apply(f: Callable[..., R], tree: jax.tree_util.PyTreeDef, leaves: Sequence[Array]) -> R:
    """`f` of the leaves of its arguments and keywords."""
    args, kwargs = jax.tree.unflatten(tree, leaves)
    return f(*args, **kwargs)


class _Traced(NamedTuple):
    """A traced function: its program, the values of the program's arguments, and the tree of its results."""

    program: core.ClosedJaxpr
    values: list[Array]
    results: jax.tree_util.PyTreeDef

    def call(self, tagged: bool) -> Any:
        """The results of the function, which is not traced again, by a tagged or a plain call."""
        call = _kernel.bind if tagged else _call_plain
        return jax.tree.unflatten(self.results, call(*self.values, program=self.program))


def _trace_call(f: Callable[..., object], args: Sequence[object], kwargs: dict[str, object]) -> _Traced:
    """`f` traced for one kernel; arrays of an outer trace that it contains become arguments of the program."""
    leaves, tree = jax.tree.flatten((args, kwargs))
    values = [jnp.asarray(leaf) for leaf in leaves]
    with _INSIDE_KERNEL(True):
        program, shape = jax.make_jaxpr(lambda *leaves: _apply(f, tree, leaves), return_shape=True)(*values)
    outer = [c for c in program.consts if isinstance(c, jax.core.Tracer)]
    if outer:

        def with_outer(*values: Array) -> list[Array]:
            given = iter(values)
            consts = [next(given) if isinstance(c, jax.core.Tracer) else c for c in program.consts]
            return core.jaxpr_as_fun(core.ClosedJaxpr(program.jaxpr, consts))(*given)

        values = [*outer, *values]
        program = jax.make_jaxpr(with_outer)(*values)
    if getattr(program.jaxpr, "is_high", False):  # JAX 0.12: a search is an operation of its own
        program = jax.jit(core.jaxpr_as_fun(program)).trace(*values).lojax.jaxpr
    return _Traced(program, values, jax.tree.structure(shape))


def _can_be_tagged(traced: _Traced) -> bool:
    """Whether all operations are inline, and there are an argument to pack and a result to add the guard to."""
    packable = all(str(x.dtype) in WIDENED | SAME_WIDTH for x in traced.values)
    if not packable or any(jax.export.is_symbolic_dim(n) for x in traced.values for n in x.shape):
        return False
    has_guard = any(x.size for x in traced.values) and _float_result(traced.program) is not None
    return has_guard and is_inline(traced.program.jaxpr)


def _float_result(program: core.ClosedJaxpr) -> int | None:
    """Index of the first floating-point result that is not empty."""
    for i, kind in enumerate(program.out_avals):
        if str(kind.dtype) in ("float64", "float32") and math.prod(kind.shape):
            return i
    return None


def is_inline(jaxpr: core.Jaxpr) -> bool:
    """Whether XLA compiles all operations of a traced function inline."""
    if jaxpr.effects:
        return False
    return all(_is_inline_operation(eqn) and all(map(is_inline, _inner_jaxprs(eqn))) for eqn in jaxpr.eqns)


def _is_inline_operation(eqn: core.JaxprEqn) -> bool:
    """Whether XLA compiles an operation inline, apart from the functions that it calls."""
    name = eqn.primitive.name
    if name.startswith("reduce_") and name != "reduce_precision" and _calls_reductions():
        return eqn.invars[0].aval.size <= LARGEST_REDUCTION
    return name in INLINE or name in OF_KERNELS


@functools.cache
def _calls_reductions() -> bool:
    """Whether XLA gives large reductions to a library: with JAX 0.11 and later, which have the first of
    `TAGGED_CALLS`."""
    module, name = TAGGED_CALLS[0]
    return hasattr(importlib.import_module(module), name)


def _inner_jaxprs(eqn: core.JaxprEqn) -> list[core.Jaxpr]:
    """The traced functions among the parameters of an operation: bodies of loops, branches, calls."""
    kinds = (core.ClosedJaxpr, core.Jaxpr)
    found = []
    for part in jax.tree.leaves(list(eqn.params.values()), is_leaf=lambda x: isinstance(x, kinds)):
        if isinstance(part, core.ClosedJaxpr):
            found.append(part.jaxpr)
        elif isinstance(part, core.Jaxpr):
            found.append(part)
    return found


def _call_plain(*values: Array, program: core.ClosedJaxpr) -> list[Array]:
    """The results of a traced function, without a tag."""
    return core.jaxpr_as_fun(program)(*values)


def _call_tagged(*values: Array, program: core.ClosedJaxpr) -> list[Array]:
    """The tagged call, with all arguments in one array."""
    ends = np.cumsum([x.size for x in values])
    guarded = _float_result(program)

    def unpack(packed: Array) -> list[Array]:
        *parts, guard = jnp.split(packed, ends)
        results = _call_plain(*map(_from_float64, parts, values), program=program)
        # A reader that no optimisation removes: the last element, -0, changes no number that it is added to.
        results[guarded] = results[guarded] + guard[0].astype(results[guarded].dtype)
        return results

    return _tagged_call()(unpack, TAG)(jnp.concatenate([*map(_to_float64, values), jnp.full(1, -0.0)]))


def _to_float64(x: Array) -> Array:
    """The numbers or, of the other types, the bits of an array as float64 (n,)."""
    if str(x.dtype) in WIDENED:
        return x.astype(jnp.float64).ravel()
    return jax.lax.bitcast_convert_type(x, jnp.float64).ravel()


def _from_float64(packed: Array, like: Array) -> Array:
    """The array with the type and shape of `like` that `_to_float64` packed."""
    if str(like.dtype) in WIDENED:
        return packed.astype(like.dtype).reshape(like.shape)
    return jax.lax.bitcast_convert_type(packed, like.dtype).reshape(like.shape)


def _lower(
    context: mlir.LoweringRuleContext, *values: mlir.ir.Value, program: core.ClosedJaxpr
) -> Sequence[mlir.ir.Value]:
    """The tagged call; the plain one if its arguments may be sharded, which inserts communication, or if each call of
    the module has sizes or the platform as further parameters (exported for several), which may have no reader."""
    call = _call_tagged
    if context.dim_var_values or _may_be_sharded(context.module_context.axis_context):
        call = _call_plain
    return mlir.lower_fun(call, multiple_results=True)(context, *values, program=program)


def _may_be_sharded(devices: mlir.AxisContext) -> bool:
    """Whether the arguments of a program may be spread over several devices."""
    match devices:
        case mlir.SPMDAxisContext(mesh=mesh, manual_axes=manual):
            return set(manual) != set(mesh.axis_names)
        case mlir.ShardingContext(num_devices=count):
            return count != 1
    return True


def _derivative(
    primals: Sequence[Array], tangents: Sequence[Array | ad.Zero], *, program: core.ClosedJaxpr
) -> tuple[list[Array], list[Array]]:
    """The derivative of the plain call with respect to the arguments that have a tangent."""
    active = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero)]

    def of_active(*values: Array) -> list[Array]:
        given = list(primals)
        for i, value in zip(active, values, strict=True):
            given[i] = value
        return _call_plain(*given, program=program)

    return jax.jvp(of_active, [primals[i] for i in active], [tangents[i] for i in active])


def _batch(
    values: Sequence[Array], axes: Sequence[int | None], *, program: core.ClosedJaxpr
) -> tuple[list[Array], list[int]]:
    """The batch of the plain call, members first."""
    found = jax.vmap(functools.partial(_call_plain, program=program), in_axes=tuple(axes))(*values)
    return found, [0] * len(found)


_kernel = core.Primitive("one_kernel")
_kernel.multiple_results = True
_kernel.def_impl(_call_plain)
_kernel.def_abstract_eval(lambda *_, program: program.out_avals)
mlir.register_lowering(_kernel, mlir.lower_fun(_call_plain, multiple_results=True))
mlir.register_lowering(_kernel, _lower, platform="cpu")
ad.primitive_jvps[_kernel] = _derivative
batching.primitive_batchers[_kernel] = _batch
