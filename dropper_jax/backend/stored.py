"""Compiled programs stored between processes: a second start neither traces, lowers nor compiles them.

A file holds one executable, as `jax.experimental.serialize_executable` writes it. Its name is the digest of all that
the program depends on: the sources, versions, flags and settings, the processor, the function, its static arguments,
and the shapes and types of the others. A program that cannot be stored or loaded is compiled.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import serialize_executable

from dropper_jax.backend.program_files import Folder
from dropper_jax.backend.stable_text import PACKAGES, NoStableText, stable_text, tree_text

#: Settings of JAX that a program depends on.
SETTINGS = (
    "jax_enable_x64",
    "jax_debug_nans",
    "jax_debug_infs",
    "jax_default_device",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_numpy_dtype_promotion",
    "jax_threefry_partitionable",
)


class StoredPrograms:
    """Compiled programs in a folder of the user.

    Other code may replace parts of these packages at run time, which the digest of their sources does not show: only
    processes that do not should use it.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.loaded = 0  # number of programs that were not compiled
        self._sources = sources_digest()

    def key(
        self, function: Callable[..., object], settings: Mapping[str, object], values: Sequence[object]
    ) -> str | None:
        """Name of the file of a program; None if a part of it has no stable text (see `program_key`)."""
        key = program_key(function, settings, values)
        if key is None:
            return None
        return hashlib.sha256("\n".join([self._sources, *_platform(), key]).encode()).hexdigest()

    def load(self, key: str) -> jax.stages.Compiled | None:
        """The program with that key; None if it is not stored or cannot be loaded here."""
        content = self.folder.read(key)
        if content is None:
            return None
        try:
            calls_lapack, *parts = pickle.loads(content)
            if calls_lapack:
                _start_lapack()
            # all arguments are on the first processor, however many the process has
            program = serialize_executable.deserialize_and_load(*parts, execution_devices=jax.devices()[:1])
        except Exception:  # of XLA or of pickle: what cannot be loaded is compiled
            self.folder.remove(key)
            return None
        self.loaded += 1
        return program

    def save(self, key: str, program: jax.stages.Compiled) -> None:
        """Store a program, unless JAX cannot write it or the sources have changed since this process started.

        A program that JAX has loaded from its own cache loses its functions when it is written again: a process
        that uses that cache does not need this one.
        """
        if self._sources != sources_digest() or jax.config.jax_compilation_cache_dir:
            return
        try:
            content = pickle.dumps(("lapack" in program.as_text(), *serialize_executable.serialize(program)))
        except (ValueError, TypeError, AttributeError, NotImplementedError, pickle.PicklingError):
            return
        self.folder.write(key, content)


def program_key(
    function: Callable[..., object], settings: Mapping[str, object], values: Sequence[object]
) -> str | None:
    """Digest of what tells programs of one process apart; None if a part of it has no stable text.

    Args:
        function, settings: the function and its static arguments.
        values: its other arguments, of which shapes and types count.
    """
    leaves, tree = jax.tree.flatten(list(values))
    try:
        parts = [
            *(f"{name}={getattr(jax.config, name, None)}" for name in SETTINGS),
            stable_text(function),
            stable_text(dict(settings)),
            tree_text(tree),
            *map(_kind, leaves),
        ]
    except NoStableText:
        return None
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def sources_digest(root: Path = Path(__file__).parents[2]) -> str:
    """Digest of all sources of the packages of this project, which are in the folder `root`."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(f"{file.relative_to(root)}\n{file.stat().st_size}\n".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _kind(leaf: object) -> str:
    """Shape and type of an argument on the first processor.

    Raises:
        NoStableText: the argument is on another device.
    """
    first = jax.devices()[0]
    sharding = getattr(leaf, "sharding", None)
    if first.platform != "cpu" or (sharding is not None and sharding.device_set != {first}):
        raise NoStableText("an argument that is not on the first processor")
    kind = jax.typeof(leaf)
    return f"{kind.str_short()}{kind.shape}{kind.weak_type}"


@cache
def _platform() -> tuple[str, ...]:
    """Versions, flags and the kind of processor: programs contain its instructions."""
    lines: set[str] = set()
    with suppress(OSError):
        about = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        lines = {line for line in about if line.startswith(("model name", "flags", "Features"))}
    versions = jax.__version__, metadata.version("jaxlib"), np.__version__, platform.python_version()
    machine = platform.machine(), platform.processor()
    return (*versions, *machine, *sorted(lines), os.environ.get("XLA_FLAGS", ""))


@cache
def _start_lapack() -> None:
    """Load LAPACK, without which a loaded program that calls it ends the process; lowering a call loads it."""
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))
