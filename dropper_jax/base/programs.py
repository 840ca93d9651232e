"""Compiled programs in a store of bounded size: the one not used for longest goes first, with its memory maps.

Each kind of scene (its tree, shapes and static settings) is compiled to programs of its own: 300 to 700 memory maps and
some 50 MB, of which JAX keeps thousands. The Linux kernel allows 65 530 maps; beyond, the compiler ends the process.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import hashlib
import inspect
import json
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Generic, ParamSpec, TypeVar

import jax
import jaxlib

from dropper_jax.base.compile_cache import Entries, open_cache
from dropper_jax.base.export_cache import open_traces

P = ParamSpec("P")
R = TypeVar("R")

#: Programs kept, two or three to a kind of scene, which take some 200 maps each.
MOST = 64
#: Memory maps of the process above which fewer are kept, large programs for one; though not fewer than `LEAST`.
MAPS = 16_000
LEAST = 8
#: After so many new programs JAX's own caches are emptied too: traces (20 MB to a kind of scene) and the programs of
#: single operations, one for each shape. What is kept here is not compiled again.
CLEARED_AFTER = 48
#: Compiler options, on the CPU, of programs that run briefly and so are to compile fast: they are no one kernel (see
#: `one_kernel`), and XLA's emitters of fused operations, which take a compiler of their own for each of hundreds of
#: functions, are left out (a step of Edulis: 36 s as one kernel, 16.2 else, 11.2 without those, and as fast).
BRIEFLY = {"xla_disable_hlo_passes": "small-while-loop-hoisting", "xla_cpu_use_fusion_emitters": False}


@functools.cache
def supported_options() -> dict[str, str | bool]:
    """Those of `BRIEFLY` that this version's compiler knows, each tried once on a program of one operation.

    The answer is kept in the folder of compiled programs, which belongs to one version of JAX.
    """
    entries = None if FOLDER is None else Entries(FOLDER)
    asked = json.dumps([BRIEFLY, jaxlib.__version__], sort_keys=True).encode()
    key = f"compiler-options-{hashlib.sha256(asked).hexdigest()[:16]}"
    names = None if entries is None else entries.get(key)
    if names is not None:
        return {name: BRIEFLY[name] for name in json.loads(names)}
    found = {}
    for name, value in BRIEFLY.items():
        with suppress(jax.errors.JaxRuntimeError):  # a JAX whose compiler no longer has the option
            jax.jit(lambda x: x + 1.0).lower(0.0).compile({name: value})
            found[name] = value
    if entries is not None:
        entries.store(key, json.dumps([*found]).encode())
    return found


def brief_options() -> dict[str, str | bool] | None:
    """Compiler options of programs that are to compile fast."""
    return supported_options() if jax.default_backend() == "cpu" else None


def memory_maps() -> int:
    """Memory maps of this process; 0 where the kernel does not tell (it then has no such limit)."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def give_back_memory() -> None:
    """Empty JAX's own caches, and hand what they held to the kernel: traces are circles, and freed heap is kept."""
    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        # glibc alone has it; elsewhere the heap is left as it is
        getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)(0)


class Store:
    """Compiled programs by what they were compiled for."""

    def __init__(self, most: int = MOST, cleared_after: int = CLEARED_AFTER):
        self.most, self.cleared_after = most, cleared_after
        self._programs: OrderedDict[Hashable, jax.stages.Compiled] = OrderedDict()
        self._new = 0
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._programs)

    def get(self, key: Hashable, compile_: Callable[[], jax.stages.Compiled]) -> jax.stages.Compiled:
        """The program of this key, compiled where it is not there."""
        with self._lock:
            if key in self._programs:
                self._programs.move_to_end(key)
                return self._programs[key]
        program = compile_()  # without the lock: two threads may compile at once
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
        return count > self.most or (count > LEAST and memory_maps() > MAPS)

    def clear(self) -> None:
        """Forget all programs."""
        with self._lock:
            self._programs.clear()
            self._new = 0


STORE = Store()
# Here, since whatever runs a scene comes by, and programs of other processes can be taken only from now on.
FOLDER = open_cache()
TRACES = open_traces(FOLDER)


def lower_cached(
    function: Callable[..., object],
    settings: Mapping[str, object],
    values: Sequence[object],
    one: Callable[..., object],
) -> jax.stages.Lowered:
    """`one` as `jax.jit` lowers it for values like these, taken from a kept trace where there is one.

    Args:
        function, settings: what it is known by: a function of this project, and all else that tracing depends on;
            arrays among it as `Constants`.
    """
    found = None if TRACES is None else TRACES.lower(function, settings, values, one)
    return found or jax.jit(one).lower(*values)


class CachedJit(Generic[P, R]):
    """A function compiled as by `jax.jit`, its programs in a store; inside another trace it is `jax.jit` itself."""

    def __init__(self, function: Callable[P, R], static: Iterable[str], store: Store, brief: bool):
        functools.update_wrapper(self, function)
        self._function, self._store = function, store
        self._brief = brief
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
        """The compiled program for arguments like these; it takes the arguments that are not static, in their order."""
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
        key = self._function, frozenset(settings.items()), tree, kinds, device_settings, self._brief
        return self._store.get(key, lambda: self._compile(settings, values))

    def _compile(self, settings: dict[str, Hashable], values: list[object]) -> jax.stages.Compiled:
        names = [name for name in self._signature.parameters if name not in self._static]

        # A function of its own: JAX keeps a trace, and with it the program, as long as the function that was traced.
        @functools.wraps(self._function)
        def one(*values: object) -> R:
            return self._function(**settings, **dict(zip(names, values, strict=True)))

        del one.__wrapped__  # its signature has the static arguments
        program = lower_cached(self._function, settings, values, one)
        return program.compile(brief_options() if self._brief else None)


def cached_jit(
    static: Iterable[str] = (), store: Store = STORE, brief: bool = False
) -> Callable[[Callable[P, R]], CachedJit[P, R]]:
    """`jax.jit` for a function of whole scenes.

    Args:
        static: names of the arguments that belong to the kind of scene.
        brief: never make one kernel of it, where others are (see `one_kernel`): for what runs too briefly to be
            worth the compilation.
    """
    return lambda function: CachedJit(function, static, store, brief)
