"""A function as one kernel on the CPU, by a tag on its call that XLA's compiler reads.

XLA launches the fused operations of a step, some 50 of them, one by one. The launches take longer than the operations.
A tagged call becomes a single function instead, if nothing inside it calls a library (LAPACK), scatters or sorts.

Two properties of the compiler make the tag unsafe on a plain call. It ends the process if a parameter of the call has
no reader left after optimisation, and it cannot compile library calls there. Therefore all arguments are packed into
one array, one element of which is added to a result. A function is tagged only if all its operations are known to be
compiled inline (`INLINE`). Every other function is called unchanged.

The older option of the compiler for all runs of a process is still available: `one_kernel()` without a function.
"""

from __future__ import annotations

import functools
import importlib
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar, overload

import jax
import jax.numpy as jnp
from jax.extend import core
from jax.interpreters import ad, batching, mlir

from dropper_jax.backend import is_plain

P = ParamSpec("P")
R = TypeVar("R")

#: Environment variable that disables tags, by `off`.
VARIABLE, OFF = "DROPPER_ONE_KERNEL", "off"
LIMIT = "xla_cpu_small_while_loop_byte_threshold"
FLAG = "--xla_backend_extra_options"
BYTES = 1_000_000_000_000
OPTION = f"{LIMIT}={BYTES}"
#: Where JAX has the call that carries a tag: 0.11 and later, 0.9.2 to 0.10.
TAGGED_CALLS = (
    ("jax.experimental.xla_metadata", "xla_metadata_call2"),
    ("jax.experimental.scheduling_groups", "xla_metadata_call"),
)
TAG = {"xla_cpu_small_call": "true", "inlineable": "false"}
ELEMENTWISE = frozenset(
    """
    add sub mul div rem max min neg sign abs square sqrt rsqrt cbrt exp exp2 log log1p expm1 logistic
    sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh integer_pow pow floor ceil round is_finite
    and or xor not eq ne lt le gt ge select_n convert_element_type stop_gradient copy add_any erf clamp nextafter
    """.split()  # noqa: SIM905
)
#: Operations that XLA compiles inline. `first_derivatives_only` and `zero_of_all` are this project's own.
INLINE = ELEMENTWISE | frozenset(
    """
    broadcast_in_dim concatenate dynamic_slice dynamic_update_slice gather iota pad reshape rev slice split squeeze
    stack unstack tile transpose bitcast_convert_type reduce_sum reduce_max reduce_min reduce_prod reduce_and reduce_or
    argmax argmin reduce_precision optimization_barrier
    shift_left shift_right_logical shift_right_arithmetic
    jit pjit closed_call custom_jvp_call custom_vjp_call checkpoint remat2 scan while cond custom_linear_solve
    first_derivatives_only zero_of_all one_kernel
    """.split()  # noqa: SIM905
)
#: Types that float64 contains exactly, and those of its width, whose bits are used.
WIDENED = frozenset("bool int8 int16 int32 uint8 uint16 uint32 float32".split())  # noqa: SIM905
SAME_WIDTH = frozenset(("int64", "uint64"))
_INSIDE: ContextVar[bool | None] = ContextVar("whether what is traced becomes one kernel; None: not decided")


@overload
def one_kernel(f: None = None) -> bool: ...
@overload
def one_kernel(f: Callable[P, R]) -> Callable[P, R]: ...


def one_kernel(f: Callable[P, R] | None = None) -> bool | Callable[P, R]:
    """`jax.jit(f)` as one kernel on the CPU where possible: a run is two to five times as fast.

        run = dj.one_kernel(lambda model, s: dj.integrate(stepper, model, s, 0.01, 1000)[0].r)
        slope = dj.one_kernel(jax.grad(loss))

    The result is that of `f`. Derivatives and batches of the returned function are those of the plain `f`, so the
    outermost `grad` or batch is what should be one kernel. A function with library calls (the `dense` solver, sorting),
    callbacks or scattered updates, and one of sharded arguments, is compiled as usual.

    Args:
        f: a pure function of pytrees of arrays. Without it, the option of the compiler for all runs of this process and
            its child processes is set, which must be done before the first array is created.

    Returns:
        The compiled function. Without `f`, whether the option holds: False if JAX has already started.
    """
    if f is None:
        return _set_option()

    @functools.wraps(f)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if _INSIDE.get(None) or not tags_enabled():
            return f(*args, **kwargs)
        leaves, tree = jax.tree.flatten((args, kwargs))
        found = _tagged(lambda *leaves: _apply(f, tree, leaves), [jnp.asarray(leaf) for leaf in leaves])
        return f(*args, **kwargs) if found is None else found

    return jax.jit(call)


def tags_enabled() -> bool:
    """Whether calls can be tagged: on the CPU, in float64, by a JAX that has such calls, unless the user disables
    it."""
    if os.environ.get(VARIABLE) == OFF or is_plain():
        return False
    return jax.default_backend() == "cpu" and jax.config.jax_enable_x64 and _tagged_call() is not None


def is_inside() -> bool | None:
    """Whether what is being traced becomes one kernel; None if nothing has decided that."""
    return _INSIDE.get(None)


@contextmanager
def inside(enabled: bool | None) -> Iterator[None]:
    """Trace for one kernel, or not; None leaves it as it is."""
    token = _INSIDE.set(_INSIDE.get(None) if enabled is None else enabled)
    try:
        yield
    finally:
        _INSIDE.reset(token)


@functools.cache
def _tagged_call() -> Callable[..., Any] | None:
    for module, name in TAGGED_CALLS:
        try:
            call = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError):
            continue
        if name == "xla_metadata_call2":
            return lambda f: call(f, TAG)
        return lambda f: call(f, **TAG)
    return None


def _apply(f: Callable[..., R], tree: jax.tree_util.PyTreeDef, leaves: Sequence[jax.Array]) -> R:
    args, kwargs = jax.tree.unflatten(tree, leaves)
    return f(*args, **kwargs)


def _tagged(f: Callable[..., Any], leaves: list[jax.Array]) -> Any:
    """The results of `f` by a call that can be tagged; None if it cannot."""
    with inside(True):
        program, shape = jax.make_jaxpr(f, return_shape=True)(*leaves)
        if any(isinstance(c, jax.core.Tracer) for c in program.consts):  # of an outer trace: arguments as well
            jaxpr, outer = program.jaxpr, list(program.consts)
            leaves = [*outer, *leaves]

            def hoisted(*values: jax.Array) -> Any:
                count = len(outer)
                return core.jaxpr_as_fun(core.ClosedJaxpr(jaxpr, list(values[:count])))(*values[count:])

            program = jax.make_jaxpr(hoisted)(*leaves)
    if not (all(_packable(v.aval) for v in program.jaxpr.invars) and _has_guarded(program) and is_inline(program)):
        return None
    return jax.tree.unflatten(jax.tree.structure(shape), _kernel.bind(*leaves, program=program))


def _packable(kind: Any) -> bool:
    return str(kind.dtype) in WIDENED | SAME_WIDTH | {"float64"}


def _has_guarded(program: core.ClosedJaxpr) -> bool:
    """Whether there is an argument to pack, and a result to which the guard can be added."""
    return _guarded(program) is not None and any(math.prod(v.aval.shape) for v in program.jaxpr.invars)


def _guarded(program: core.ClosedJaxpr) -> int | None:
    for i, kind in enumerate(program.out_avals):
        if str(kind.dtype) == "float64" and math.prod(kind.shape):
            return i
    return None


def is_inline(program: core.ClosedJaxpr | core.Jaxpr) -> bool:
    """Whether XLA compiles all operations of a traced function inline."""
    jaxpr = getattr(program, "jaxpr", program)
    if jaxpr.effects:
        return False
    for eqn in jaxpr.eqns:
        if eqn.primitive.name not in INLINE:
            return False
        parts = jax.tree.leaves(list(eqn.params.values()), is_leaf=_is_program)
        if not all(is_inline(part) for part in parts if _is_program(part)):
            return False
    return True


def _is_program(x: object) -> bool:
    return isinstance(x, (core.Jaxpr, core.ClosedJaxpr))


def _plain(*values: jax.Array, program: core.ClosedJaxpr) -> list[jax.Array]:
    return core.jaxpr_as_fun(program)(*values)


def _packed(*values: jax.Array, program: core.ClosedJaxpr) -> list[jax.Array]:
    """The tagged call, with all arguments in one array."""
    kinds = [(x.shape, x.dtype, x.size) for x in values]
    guarded = _guarded(program)

    def unpack(packed: jax.Array) -> list[jax.Array]:
        found, start = [], 0
        for shape, dtype, size in kinds:
            part = packed[start : start + size].reshape(shape)
            start += size
            bits = str(dtype) in SAME_WIDTH
            found.append(jax.lax.bitcast_convert_type(part, dtype) if bits else part.astype(dtype))
        results = _plain(*found, program=program)
        # A reader that no optimisation removes: the last element, -0, changes no number that it is added to.
        results[guarded] = results[guarded] + packed[start]
        return results

    parts = [
        (jax.lax.bitcast_convert_type(x, jnp.float64) if str(x.dtype) in SAME_WIDTH else x.astype(jnp.float64)).ravel()
        for x in values
    ]
    return _tagged_call()(unpack)(jnp.concatenate([*parts, jnp.full(1, -0.0)]))


def _lower(context: mlir.LoweringRuleContext, *values: Any, program: core.ClosedJaxpr) -> Any:
    """The tagged call, or the plain one if its arguments may be sharded, which inserts communication."""
    over = context.module_context.axis_context
    mesh = getattr(over, "mesh", None)
    sharded = getattr(over, "num_devices", 1) != 1
    if mesh is not None:
        sharded = set(getattr(over, "manual_axes", ())) != set(mesh.axis_names)
    rule = mlir.lower_fun(_plain if sharded else _packed, multiple_results=True)
    return rule(context, *values, program=program)


def _derivative(primals: Sequence[Any], tangents: Sequence[Any], *, program: core.ClosedJaxpr) -> Any:
    full = tuple(ad.instantiate_zeros(dot) for dot in tangents)
    return jax.jvp(functools.partial(_plain, program=program), tuple(primals), full)


def _batch(values: Sequence[Any], axes: Sequence[Any], *, program: core.ClosedJaxpr) -> Any:
    given = tuple(None if axis is batching.not_mapped else axis for axis in axes)
    found = jax.vmap(functools.partial(_plain, program=program), in_axes=given)(*values)
    return found, [0] * len(found)


_kernel = core.Primitive("one_kernel")
_kernel.multiple_results = True
_kernel.def_impl(_plain)
_kernel.def_abstract_eval(lambda *_, program: program.out_avals)
mlir.register_lowering(_kernel, mlir.lower_fun(_plain, multiple_results=True))
mlir.register_lowering(_kernel, _lower, platform="cpu")
ad.primitive_jvps[_kernel] = _derivative
batching.primitive_batchers[_kernel] = _batch


def _set_option() -> bool:
    """Set `XLA_FLAGS` for this process and its child processes, if JAX has not started."""
    if in_force():
        return True
    if _devices_started() or is_plain():
        return False
    os.environ["XLA_FLAGS"] = with_option(os.environ.get("XLA_FLAGS", ""))
    return True


def with_option(flags: str) -> str:
    """XLA's flags with the option first, because flags after a word without dashes are not read."""
    words = flags.split()
    for i, word in enumerate(words):
        if word.startswith(f"{FLAG}="):
            return " ".join([f"{word},{OPTION}", *words[:i], *words[i + 1 :]])
    return " ".join([f"{FLAG}={OPTION}", *words])


def in_force() -> bool:
    """Whether the option is at a position where XLA reads it."""
    for word in os.environ.get("XLA_FLAGS", "").split():
        if not word.startswith("--"):
            return False
        if word.startswith(f"{FLAG}="):
            return OPTION in word.removeprefix(f"{FLAG}=").split(",")
    return False


def _devices_started() -> bool:
    """Whether JAX has started its devices, after which it ignores new options."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    is_started = getattr(bridge, "backends_are_initialized", None)
    return bool(is_started()) if is_started else False
