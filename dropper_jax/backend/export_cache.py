"""Traced programs cached between processes, so that a second start neither traces nor lowers them.

A program is stored next to the compiled ones as the StableHLO that `jax.export` produces. Its key is the digest of
everything that tracing depends on: the sources, JAX and its settings, the function, static arguments, tree, shapes and
types. The first start compiles the exported form too, so that the second start finds the compiled program as well.

This applies only to functions of this project that are called on the host, on the CPU. Values without a form that means
the same in every process are traced as usual (see `plain_form`).
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock, get_ident
from typing import NamedTuple

import jax
import jax.export
import jax.numpy as jnp
import jaxlib
import numpy as np
from jax.sharding import SingleDeviceSharding
from jax.tree_util import PyTreeDef

from dropper_jax.backend.compile_cache import Entries
from dropper_jax.base.plain_form import PROJECT, NoPlainForm, Plain, name_of, to_plain, tree_read, tree_written

#: Environment variable: whether command lines cache traces; `off` disables it.
VARIABLE = "DROPPER_KEEP_TRACES"
ON = "on"
#: First characters of file names, with the number of the format.
PREFIX, FORMAT = "trace-", 1
#: JAX settings that no program depends on and that differ between users.
ASIDE = ("jax_compilation_cache_dir",)
#: Held while a thread lowers a stored program.
LOWERING = Lock()
#: Raised if a value has no plain form, or if this JAX cannot export a program; the program is then traced as usual.
UNKEPT = (NotImplementedError, ValueError, TypeError, AttributeError, OSError)
#: Raised if a file is not a valid module.
UNREADABLE = (*UNKEPT, RuntimeError, LookupError)


class Trace(NamedTuple):
    """A program as stored: its module, the arguments that it uses, its results."""

    module: bytes
    takes: tuple[int, ...]
    results: tuple[tuple[tuple[int, ...], str], ...]
    tree: PyTreeDef


@dataclass(frozen=True)
class Constants:
    """Arrays that a program contains as constants, such as the model of a fit, given as part of its settings."""

    tree: object


class Traces:
    """Traced programs in a folder.

    Args:
        entries: the folder.
    """

    def __init__(self, entries: Entries) -> None:
        self._entries = entries
        self._sources = _sources_digest()

    def lower(
        self,
        function: Callable[..., object],
        settings: Mapping[str, object],
        values: Sequence[object],
        one: Callable[..., object],
    ) -> jax.stages.Lowered | None:
        """The lowered program of a function, traced if it is not cached; None if it cannot be lowered.

        Args:
            function, settings: the identity of the program; static arguments by their names.
            values: example arguments.
            one: the function of the values, with its settings applied.
        """
        try:
            name, key = name_of(function), self._key(function, settings, values)
            trace = self._load(key)
            if trace is not None:
                with suppress(*UNREADABLE):
                    return _lower_program(name, trace, values)
                self._entries.remove(PREFIX + key)
            trace = _trace_program(one, values)
            if self._sources != _sources_digest():  # the sources have been edited since this process started
                return None
            self._keep(key, trace)
            return _lower_program(name, trace, values)
        except UNKEPT:
            return None

    def _key(self, function: Callable[..., object], settings: Mapping[str, object], values: Sequence[object]) -> str:
        leaves, tree = jax.tree.flatten(list(values))
        about = {
            "format": FORMAT,
            "versions": [jax.__version__, jaxlib.__version__, np.__version__, platform.python_version()],
            "sources": self._sources,
            "flags": os.environ.get("XLA_FLAGS", ""),
            "jax": _settings(),
            "function": name_of(function),
            "settings": [[name, _setting(value)] for name, value in sorted(settings.items())],
            "tree": tree_written(tree),
            "kinds": [_kind(leaf) for leaf in leaves],
        }
        return hashlib.sha256(json.dumps(about).encode()).hexdigest()

    def _load(self, key: str) -> Trace | None:
        """The trace with that key; None if it is missing or unreadable. An unreadable one is removed."""
        whole = self._entries.get(PREFIX + key)
        if whole is None:
            return None
        head, _, module = whole.partition(b"\n")
        with suppress(ValueError, TypeError, KeyError, IndexError):
            said = json.loads(head)
            if said["key"] == key:
                results = tuple((tuple(shape), dtype) for shape, dtype in said["results"])
                return Trace(module, tuple(said["takes"]), results, tree_read(said["tree"]))
        self._entries.remove(PREFIX + key)
        return None

    def _keep(self, key: str, trace: Trace) -> None:
        tree = tree_written(trace.tree)
        if tree_read(json.loads(json.dumps(tree))) != trace.tree:
            raise NoPlainForm("the tree of the results changed when it was read back")
        said = {"key": key, "takes": trace.takes, "results": trace.results, "tree": tree}
        self._entries.write(PREFIX + key, json.dumps(said).encode() + b"\n" + trace.module)


def open_traces(folder: Path | None) -> Traces | None:
    """Enable caching of traces in a folder, if the command line requests it and a folder is available.

    Other processes may replace parts of this project at run time, which the digest of the sources does not show.
    """
    if folder is None or os.environ.get(VARIABLE) != ON or not Path(__file__).is_file():
        return None
    return Traces(Entries(folder))


def _kind(leaf: object) -> Plain:
    """Shape and type of an argument on the first processor.

    Raises:
        NoPlainForm: the argument is on another device.
    """
    sharding = getattr(leaf, "sharding", None)
    first = jax.devices()[0]
    if first.platform != "cpu" or not (sharding is None or isinstance(sharding, SingleDeviceSharding)):
        raise NoPlainForm("an argument that is not on a single processor")
    memory = None, first.default_memory().kind
    if sharding is not None and (sharding.device_set != {first} or sharding.memory_kind not in memory):
        raise NoPlainForm("an argument that is not on the first processor")
    kind = jax.typeof(leaf)
    return [list(kind.shape), str(kind.dtype), bool(kind.weak_type)]


def _setting(value: object) -> Plain:
    """A static argument, or the digests of arrays."""
    if not isinstance(value, Constants):
        return to_plain(value)
    leaves, tree = jax.tree.flatten(value.tree)
    arrays = [np.asarray(leaf) for leaf in leaves]
    digests = [[str(a.dtype), list(a.shape), hashlib.sha256(a.tobytes()).hexdigest()] for a in arrays]
    return ["constants", tree_written(tree), digests]


def _settings() -> Plain:
    """All JAX settings, including those of this thread.

    Raises:
        NoPlainForm: a setting is an object, such as a device.
    """
    found = []
    for name in sorted(set(jax.config.values) - set(ASIDE)):
        value = getattr(jax.config, name, jax.config.values[name])
        if value is not None and not isinstance(value, (bool, int, float, str)):
            value = _member(value)
        found.append([name, str(value)])
    return found


def _member(value: object) -> str:
    """The name of an enumeration member."""
    name = getattr(value, "name", None)
    if not isinstance(name, str):
        raise NoPlainForm(f"{type(value).__name__} is not a plain setting")
    return name


# the folder that contains the packages of this project
def _sources_digest(root: Path = Path(__file__).parents[2]) -> str:
    """Digest of all sources of the installed packages of this project."""
    digest = hashlib.sha256()
    for package in PROJECT:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(f"{file.relative_to(root)}\n{file.stat().st_size}\n".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _trace_program(one: Callable[..., object], values: Sequence[object]) -> Trace:
    """The program of a function of trees in flat form, without weakly typed arrays, which cannot be exported."""
    leaves, tree = jax.tree.flatten(tuple(values))
    seen: list[PyTreeDef] = []

    def flat(*leaves: jax.Array) -> tuple[jax.Array, ...]:
        results, after = jax.tree.flatten(one(*jax.tree.unflatten(tree, leaves)))
        seen.append(after)
        return tuple(jax.lax.convert_element_type(a, jnp.asarray(a).dtype) for a in results)

    made = jax.export.export(jax.jit(flat), platforms=["cpu"])(*map(_like, leaves))
    if made.ordered_effects or made.unordered_effects or made.uses_global_constants or made.nr_devices != 1:
        raise NoPlainForm("a program with side effects")
    results = tuple((tuple(a.shape), str(a.dtype)) for a in made.out_avals)
    return Trace(made.mlir_module_serialized, tuple(made.module_kept_var_idx), results, seen[0])


def _lower_program(name: str, trace: Trace, values: Sequence[object]) -> jax.stages.Lowered:
    """A traced program, lowered for values like these."""

    def mould(*leaves: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(jnp.zeros(shape, dtype) for shape, dtype in trace.results)

    # The calling convention that JAX gives a program with the same arguments and results, with this module inserted.
    # `Exported.serialize` needs a library that this project does not depend on.
    like = jax.export.export(jax.jit(mould), platforms=["cpu"])(*map(_like, jax.tree.leaves(list(values))))
    fun_name = name.rpartition(".")[2].rpartition(":")[2]
    made = replace(like, fun_name=fun_name, mlir_module_serialized=trace.module, module_kept_var_idx=trace.takes)

    def again(*values: object) -> object:
        return jax.tree.unflatten(trace.tree, made.call(*jax.tree.leaves(values)))

    again.__name__ = fun_name
    with LOWERING, _lapack_if_called(trace.module):
        return jax.jit(again).lower(*values)


@contextmanager
def _lapack_if_called(module: bytes) -> Iterator[None]:
    """Load LAPACK for stored programs that call it.

    JAX loads it, with SciPy, for all of them, which takes 0.2 s, and before 0.10 for none, which ends the process.
    """
    jax_linalg = vars(jax._src.lax.linalg)
    load = jax_linalg.get("initialize_lapack")
    if b"lapack" in module:
        jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))
    else:
        own = get_ident()  # other threads may lower programs that call it
        jax_linalg["initialize_lapack"] = lambda: None if get_ident() == own else load()
    try:
        yield
    finally:
        jax_linalg["initialize_lapack"] = load


def _like(leaf: object) -> jax.ShapeDtypeStruct:
    kind = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(kind.shape, kind.dtype, weak_type=kind.weak_type)
