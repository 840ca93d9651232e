"""Compiled programs in a store of bounded size: the least recently used one is removed first, with its memory maps.

Each kind of scene (its tree, shapes and static settings) has its own compiled programs, which take 300 to 700 memory
maps and some 50 MB. JAX keeps thousands of them. The Linux kernel allows 65 530 maps per process; beyond that, the
compiler ends the process.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import hashlib
import inspect
import json
import os
import sys
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import get_ident
from typing import Any, Generic, ParamSpec, TypeVar

import jax
import jaxlib

from dropper_jax.backend import is_plain
from dropper_jax.backend.compile_cache import Entries, open_cache
from dropper_jax.backend.export_cache import open_traces
from dropper_jax.backend.one_kernel import TAG_NAME, one_kernel, tags_enabled

P = ParamSpec("P")
R = TypeVar("R")

#: Compiler options, on the CPU, of programs that run briefly and should compile fast. They are not compiled to one
#: kernel (see `one_kernel`). XLA's emitters of fused operations, which start a separate compiler for each of hundreds
#: of functions, are switched off. One step of Edulis compiles in 36 s as one kernel, 16.2 s otherwise and 11.2 s
#: without the emitters, and runs as fast.
EMITTERS = "xla_cpu_use_fusion_emitters"
BRIEFLY = {"xla_disable_hlo_passes": "small-while-loop-hoisting", EMITTERS: False}
#: Options of programs that run for a second at most: the lab dropper compiles in 0.8 instead of 2.0 s and takes 13
#: instead of 6 us per step. Parts for several threads of the compiler cost a tenth of what is left.
QUICKLY = {"xla_backend_optimization_level": 0, "xla_cpu_parallel_codegen_split_count": 1}
#: Options of batches as one kernel: XLA prefers half of the widest vector registers, which takes 1.18 times as long.
WIDELY = {"xla_cpu_prefer_vector_width": 512}
#: Environment variable that enables `QUICKLY` (`on`), for processes that run each scene once.
QUICK, ON = "DROPPER_QUICK_COMPILATION", "on"
#: Compiler contexts by the number of their thread.
CONTEXTS: dict[int, Any] = {}


@functools.cache
def supported_options() -> dict[str, str | bool | int]:
    """The options above that this compiler supports, each tested once on a small program.

    The answer is stored in the folder of compiled programs, which belongs to one version of JAX.
    """
    entries = None if FOLDER is None else Entries(FOLDER)
    options = BRIEFLY | QUICKLY | WIDELY
    asked = json.dumps([options, jaxlib.__version__], sort_keys=True).encode()
    key = f"compiler-options-{hashlib.sha256(asked).hexdigest()[:16]}"
    names = None if entries is None else entries.get(key)
    if names is not None:
        return {name: options[name] for name in json.loads(names)}
    found = {}
    for name, value in options.items():
        with suppress(jax.errors.JaxRuntimeError):  # this JAX's compiler no longer has the option
            jax.jit(lambda x: x + 1.0).lower(0.0).compile({name: value})
            found[name] = value
    if entries is not None:
        entries.write(key, json.dumps([*found]).encode())
    return found


def compiler_options(names: Iterable[str]) -> dict[str, str | bool | int] | None:
    """The options with these names that this version's compiler supports; None if there are none."""
    if not names or is_plain() or jax.default_backend() != "cpu":
        return None
    return {name: value for name, value in supported_options().items() if name in names}


def memory_maps() -> int:
    """Number of memory maps of this process; 0 if the kernel does not report it (it then has no such limit)."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def give_back_memory() -> None:
    """Clear JAX's own caches and return their memory to the kernel: traces are reference cycles, and freed heap is
    retained."""
    jax.clear_caches()
    CONTEXTS.clear()
    gc.collect()
    if sys.platform == "linux":
        # only glibc has it; elsewhere the heap is left unchanged
        getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)(0)


class Store:
    """Compiled programs by the key that they were compiled for."""

    # Two or three programs for each kind of scene, some 200 maps each. After `cleared_after` new programs JAX's own
    # caches are cleared too: traces (20 MB per kind of scene) and the programs of single operations, one for each
    # shape. Programs kept here are not recompiled.
    def __init__(self, most: int = 64, cleared_after: int = 48):
        self.most, self.cleared_after = most, cleared_after
        self._programs: OrderedDict[Hashable, jax.stages.Compiled] = OrderedDict()
        self._new = 0
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._programs)

    def get(self, key: Hashable, compile_: Callable[[], jax.stages.Compiled]) -> jax.stages.Compiled:
        """The program with this key, compiled if it is missing."""
        with self._lock:
            if key in self._programs:
                self._programs.move_to_end(key)
                return self._programs[key]
        program = compile_()  # without the lock: two threads may compile at the same time
        with self._lock:
            self._programs[key] = program
            while self._full():
                self._programs.popitem(last=False)
            self._new += 1
            clear = self._new >= self.cleared_after
            self._new = 0 if clear else self._new
        if clear:
            give_back_memory()
        return program

    def _full(self) -> bool:
        count = len(self._programs)
        # with more memory maps than this, fewer programs are kept (some are large), but never fewer than eight
        return count > self.most or (count > 8 and memory_maps() > 16_000)

    def clear(self) -> None:
        """Remove all programs."""
        with self._lock:
            self._programs.clear()
            self._new = 0


STORE = Store()
# Done here because every run passes through here, and programs of other processes can only be used from now on.
FOLDER = open_cache()
TRACES = open_traces(FOLDER)


def omit_source_lines() -> None:
    """Trace and lower without the lines of Python that operations come from, in one compiler context per thread.

    JAX records the stack at every operation, writes two names for it, and makes a compiler context for each program:
    a tenth of the time until the programs of a scene are compiled. JAX's own errors then show no lines of traced
    functions. A JAX that is organised differently is left unchanged.
    """
    with suppress(ImportError, AttributeError):
        from jax._src.interpreters import mlir  # noqa: PLC0415
        from jax._src.lib import _jax  # noqa: PLC0415
        from jaxlib.mlir import ir  # noqa: PLC0415

        make = mlir.make_ir_context

        def compiler_context() -> ir.Context:
            thread = get_ident()  # threads do not share one: the compiler reads it without the interpreter's lock
            context = CONTEXTS[thread] = CONTEXTS.get(thread) or make()
            return context

        def no_location(*_: object) -> ir.Location:
            return ir.Location.unknown()

        vars(mlir).update(make_ir_context=compiler_context, source_info_to_location=no_location)
        _jax.set_tracebacks_enabled(False)


if os.environ.get("DROPPER_SOURCE_LINES") == "off" and not is_plain():
    omit_source_lines()


def lower_cached(
    function: Callable[..., object],
    settings: Mapping[str, object],
    values: Sequence[object],
    one: Callable[..., object],
) -> jax.stages.Lowered:
    """`one` as `jax.jit` lowers it for values like these, taken from a cached trace if there is one.

    Args:
        function, settings: the identity of the program: a function of this project, and everything else that tracing
            depends on; arrays among it as `Constants`.
    """
    return (TRACES and TRACES.lower(function, settings, values, one)) or jax.jit(one).lower(*values)


class CachedJit(Generic[P, R]):
    """A function compiled as by `jax.jit`, with its programs in a store; inside another trace it is `jax.jit`
    itself."""

    def __init__(
        self, function: Callable[P, R], static: Iterable[str], store: Store, brief: bool, quick: float, emitters: bool
    ):
        functools.update_wrapper(self, function)
        self._calls: Counter[Hashable] = Counter()
        self._function, self._store = function, store
        self._brief, self._quick, self._emitters = brief, quick, emitters
        self._signature = inspect.signature(function)
        self._static = frozenset(static)
        self._jitted = jax.jit(function, static_argnames=tuple(self._static))

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        settings, values = self._split(*args, **kwargs)
        leaves = jax.tree.leaves(values)
        if jax.config.jax_disable_jit or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return self._jitted(*args, **kwargs)
        return self._program(settings, values)(*values)

    def program(self, *args: P.args, **kwargs: P.kwargs) -> Callable[..., R]:
        """The compiled program for arguments like these; it takes the non-static arguments in their order."""
        return self._program(*self._split(*args, **kwargs))

    def _split(self, *args: P.args, **kwargs: P.kwargs) -> tuple[dict[str, Hashable], list[object]]:
        given = self._signature.bind(*args, **kwargs)
        given.apply_defaults()
        settings = {name: given.arguments[name] for name in self._static}
        return settings, [value for name, value in given.arguments.items() if name not in self._static]

    def _program(self, settings: dict[str, Hashable], values: list[object]) -> jax.stages.Compiled:
        leaves, tree = jax.tree.flatten(values)
        kinds = tuple((jax.typeof(leaf), getattr(leaf, "sharding", None)) for leaf in leaves)
        device_settings = jax.config.jax_enable_x64, jax.config.jax_default_device, jax.config.jax_debug_nans
        kind = self._function, frozenset(settings.items()), tree, kinds, device_settings, self._brief
        quick = self._quick > 0 and os.environ.get(QUICK) == ON
        if quick:
            self._calls[kind] += 1
            quick = self._calls[kind] <= self._quick
        return self._store.get((*kind, quick), lambda: self._compile(settings, values, quick))

    def _compile(self, settings: dict[str, Hashable], values: list[object], quick: bool) -> jax.stages.Compiled:
        names = [name for name in self._signature.parameters if name not in self._static]

        # A separate function: JAX keeps a trace, and with it the program, as long as the traced function exists.
        @functools.wraps(self._function)
        def one(*values: object) -> R:
            return self._function(**settings, **dict(zip(names, values, strict=True)))

        del one.__wrapped__  # its signature includes the static arguments
        options = self._compiler_options(quick)
        if self._brief or not tags_enabled():
            return lower_cached(self._function, settings, values, one).compile(options)
        try:
            tagged = lower_cached(self._function, {**settings, "one kernel": True}, values, one_kernel(one))
            if not self._emitters and TAG_NAME not in tagged.as_text():
                options = compiler_options([EMITTERS])
            return tagged.compile(options)
        except jax.errors.JaxRuntimeError:  # an operation that this version's compiler does not compile inline
            return lower_cached(self._function, settings, values, one).compile(options)

    def _compiler_options(self, quick: bool) -> dict[str, str | bool | int] | None:
        return compiler_options([*BRIEFLY] * self._brief + [*QUICKLY] * quick)


def cached_jit(
    static: Iterable[str] = (),
    store: Store = STORE,
    brief: bool = False,
    quick: float = 0,
    emitters: bool = True,
) -> Callable[[Callable[P, R]], CachedJit[P, R]]:
    """`jax.jit` for a function of whole scenes.

    Args:
        static: names of the arguments that determine the kind of scene.
        brief: never compile it to one kernel (see `one_kernel`); for functions that run too briefly to be worth it.
        quick: number of calls of a kind for which it is compiled without optimisation, if the process has asked for
            that; for what runs for a second at most.
        emitters: whether what cannot be one kernel is compiled by XLA's emitters of fused operations: without them a
            scheme with the dense solver compiles in half of the time, and its steps take 3 % longer.
    """
    return lambda function: CachedJit(function, static, store, brief, quick, emitters)
