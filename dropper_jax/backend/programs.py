"""Compiled programs: kept in a cache of bounded size, and stored in a folder for the next process if it is enabled.

Each kind of scene (its tree, shapes and static settings) has its own compiled programs, which take 300 to 700 memory
maps and some 50 MB. JAX keeps thousands of them. The Linux kernel allows 65 530 maps per process; beyond that, the
compiler ends the process.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import inspect
import os
import re
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Generic, ParamSpec, TypeVar

import jax

from dropper_jax import backend
from dropper_jax.backend import is_plain
from dropper_jax.backend.one_kernel import lower_kernel
from dropper_jax.backend.program_files import Folder, open_folder, user_folder
from dropper_jax.backend.stored import SETTINGS, StoredPrograms, program_key

P = ParamSpec("P")
R = TypeVar("R")

#: Number of operations up to which a run becomes one kernel. A single line has 700 to 2700, and 6400 with the
#: derivatives of a fit; its steps then take half of the time. Systems of lines have 9000 to 14 000: their steps take
#: half of the time too (edulis-longline: 0.6 instead of 1.2 ms), but they compile twice as long (50 instead of 24 s),
#: which only 40 000 steps would repay.
LARGEST_KERNEL = 8000
#: What the compiler says of an option that it does not know.
UNKNOWN_OPTION = re.compile(r"No such compile option: '(\w+)'")
#: Compiler options of kernels on the CPU. XLA's emitters of fused operations start a compiler of their own for each of
#: hundreds of functions; without them what cannot be one kernel compiles in half of the time. LLVM's first level of
#: optimisation is enough: steps are as fast, and the windows of a fit compile in 7 instead of 12 s.
KERNEL_OPTIONS = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}
#: Compiler options of other programs, most of which run for less time than they compile. In one part the descent of
#: `edulis-longline` compiles in 4.3 instead of 10.5 s and takes 0.12 instead of 0.10 s. Small loops stay separate:
#: compiled into one function they take twice as long.
OPTIONS = {
    **KERNEL_OPTIONS,
    "xla_disable_hlo_passes": "small-while-loop-hoisting",
    "xla_cpu_parallel_codegen_split_count": 1,
}


def memory_maps() -> int:
    """Number of memory maps of this process; 0 if the kernel does not report it (it then has no such limit)."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def return_memory() -> None:
    """Clear JAX's own caches and return their memory to the kernel: traces are reference cycles, and freed heap is
    retained."""
    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        # only glibc has it; elsewhere the heap is left unchanged
        getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)(0)


#: With more memory maps than this, fewer programs are kept (some are large), but never fewer than eight.
MAX_MAPS = 16_000


class ProgramCache:
    """Compiled programs of this process by the key that they were compiled for.

    Args:
        most: number of programs; each kind of scene has two or three, some 200 maps each.
        cleared_after: number of new programs after which JAX's own caches are cleared too: traces (20 MB per kind of
            scene) and the programs of single operations, one for each shape. Programs kept here are not recompiled.
    """

    def __init__(self, most: int = 64, cleared_after: int = 48) -> None:
        self.most = most
        self.cleared_after = cleared_after
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
            if clear:
                self._new = 0
        if clear:
            return_memory()
        return program

    def _full(self) -> bool:
        count = len(self._programs)
        return count > self.most or (count > 8 and memory_maps() > MAX_MAPS)

    def clear(self) -> None:
        """Remove all programs."""
        with self._lock:
            self._programs.clear()
            self._new = 0


PROGRAMS = ProgramCache()
#: Programs stored for the next process, or None; see `store_programs`.
_stored: StoredPrograms | None = None


def store_programs(folder: str | Path | None = None) -> Path | None:
    """Store compiled programs in a folder, and use those that it contains: later processes start without compiling.

    The command line does so. A Python program that replaces parts of these packages at run time must not.

    Args:
        folder: the folder; default: that of the user.

    Returns:
        The folder; None if it cannot be used: not writable, or not the user's own.
    """
    global _stored
    path = user_folder() if folder is None else Path(folder)
    opened = None
    if not (path is None or is_plain()):
        opened = open_folder(path)
    _stored = None
    if opened is not None:
        _stored = StoredPrograms(Folder(opened))
    return opened


if backend.stores_programs:
    store_programs()


def stored_programs() -> StoredPrograms | None:
    """The programs that this process stores and loads, or None."""
    return _stored


def compile_program(
    function: Callable[..., object],
    settings: Mapping[str, object],
    values: Sequence[object],
    one: Callable[..., object],
    kernel: bool = False,
    shared: bool = False,
) -> jax.stages.Compiled:
    """`one` compiled for values like these, loaded if another process has stored it.

    Args:
        function, settings: the identity of the program: a function of this project, and everything else that tracing
            depends on, arrays that the program contains among it.
        values: example arguments.
        one: the function of the values, with its settings applied.
        kernel: whether it becomes one kernel where possible.
        shared: whether callers of this process whose settings have the same values share it.
    """
    if shared:
        key = program_key(function, {**settings, "kernel": kernel}, values)
        if key is not None:
            return PROGRAMS.get(key, lambda: compile_program(function, settings, values, one, kernel))
    stored = _stored
    if stored is None:
        return _compile(one, values, kernel)
    key = stored.key(function, {**settings, "kernel": kernel}, values)
    if key is None:
        return _compile(one, values, kernel)
    program = stored.load(key)
    if program is None:
        program = _compile(one, values, kernel)
        stored.save(key, program)
    return program


def _compile(one: Callable[..., object], values: Sequence[object], kernel: bool) -> jax.stages.Compiled:
    if kernel:
        lowered, is_kernel = lower_kernel(one, values, LARGEST_KERNEL)
        if not is_kernel:
            return compile_lowered(lowered, OPTIONS)
        # not if it has an operation that this version's compiler does not compile inline
        with suppress(jax.errors.JaxRuntimeError):
            return compile_lowered(lowered, KERNEL_OPTIONS)
    return compile_lowered(jax.jit(one).lower(*values), OPTIONS)


def compile_lowered(lowered: jax.stages.Lowered, options: Mapping[str, str | bool | int]) -> jax.stages.Compiled:
    """A lowered program compiled with options of the CPU's compiler, without them elsewhere, and without those that
    it does not know. Those that `XLA_FLAGS` sets are the user's."""
    if is_plain() or jax.default_backend() != "cpu":
        return lowered.compile()
    flags = os.environ.get("XLA_FLAGS", "")
    known = {name: value for name, value in options.items() if f"--{name}=" not in flags}
    while True:
        try:
            return lowered.compile(known)
        except jax.errors.JaxRuntimeError as error:
            unknown = UNKNOWN_OPTION.search(str(error))
            if unknown is None or known.pop(unknown[1], None) is None:
                raise


class CachedJit(Generic[P, R]):
    """A function compiled as by `jax.jit`, with its programs in a cache; inside another trace it is `jax.jit`
    itself."""

    def __init__(self, function: Callable[P, R], static: Iterable[str], cache: ProgramCache, kernel: bool) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._cache = cache
        self._kernel = kernel
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
        jax_settings = tuple(getattr(jax.config, name, None) for name in SETTINGS)
        key = self._function, frozenset(settings.items()), tree, kinds, jax_settings, self._kernel
        return self._cache.get(key, lambda: self._compile(settings, values))

    def _compile(self, settings: dict[str, Hashable], values: list[object]) -> jax.stages.Compiled:
        names = [name for name in self._signature.parameters if name not in self._static]

        # A separate function: JAX keeps a trace, and with it the program, as long as the traced function exists.
        @functools.wraps(self._function)
        def one(*values: object) -> R:
            return self._function(**settings, **dict(zip(names, values, strict=True)))

        del one.__wrapped__  # its signature includes the static arguments
        return compile_program(self._function, settings, values, one, self._kernel)


def cached_jit(
    static: Iterable[str] = (), cache: ProgramCache = PROGRAMS, kernel: bool = False
) -> Callable[[Callable[P, R]], CachedJit[P, R]]:
    """`jax.jit` for a function of whole scenes.

    Args:
        static: names of the arguments that determine the kind of scene.
        cache: where its programs are kept.
        kernel: whether it becomes one kernel where possible (see `one_kernel`) and worthwhile: for runs of many steps.
    """
    return lambda function: CachedJit(function, static, cache, kernel)
