"""Compiled programs stored between processes: a second start neither traces, lowers nor compiles them.

A file holds one executable, as `jax.experimental.serialize_executable` writes it, after its digest: JAX loads a file
with a flipped bit without an error. Its name is the digest of all that the program depends on: the sources, versions,
flags and settings, the processor, the function, its static arguments, and the shapes and types of the others. A
program that cannot be stored or loaded is compiled.

JAX reads its part of a file by `pickle`, which can run any code. Programs are therefore loaded only from a folder that
belongs to the user and that no other user may write, where the system knows owners.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import pickle
import platform
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.experimental import serialize_executable

#: Packages whose names and sources the key of a program contains.
PACKAGES = ("dropper_jax", "fitting")
#: First bytes of a file, before the digest and the program.
MARK = b"dropper2"
UNFINISHED = ".unfinished"
WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
DIGEST = hashlib.sha256().digest_size
#: Age [s] after which an unfinished file counts as left over from a stopped process.
ABANDONED_AGE = 3600.0
#: Total size [bytes] of the stored programs; those not used for the longest time are removed first.
MAX_STORED_BYTES = 1_000_000_000
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


class NoStableText(ValueError):
    """A value that may mean something else in another process."""


class Folder:
    """Files by key in a folder, with a limit on their total size.

    Args:
        path: the folder, which exists.
        largest: total size [bytes] of its files.
    """

    def __init__(self, path: Path, largest: int = MAX_STORED_BYTES) -> None:
        self.path = path
        self.largest = largest
        self._unseen = largest  # bytes written since the sizes of all files were added up

    def read(self, key: str) -> bytes | None:
        """The content with that key; None if it is missing or damaged. A damaged file is removed."""
        file = self.path / key
        try:
            whole = file.read_bytes()
        except OSError:
            return None
        head = whole[: len(MARK) + DIGEST]
        content = whole[len(MARK) + DIGEST :]
        if head != MARK + hashlib.sha256(content).digest():
            self.remove(key)
            return None
        with suppress(OSError):
            os.utime(file)
        return content

    def write(self, key: str, content: bytes) -> None:
        """Store content, replacing an existing file at once; a full or read-only disk is ignored."""
        with suppress(OSError):
            with tempfile.NamedTemporaryFile(dir=self.path, suffix=UNFINISHED, delete=False) as file:
                file.write(MARK + hashlib.sha256(content).digest() + content)
            os.replace(file.name, self.path / key)
            self._unseen += len(content)
            if self._unseen > self.largest / 64:  # looking at all files costs more than storing one
                self._remove_old()
                self._unseen = 0

    def remove(self, key: str) -> None:
        """Remove a file."""
        with suppress(OSError):
            (self.path / key).unlink()

    def _remove_old(self) -> None:
        """Remove the files not used for the longest time, beyond the limit, and what stopped processes have left."""
        files = []
        for file in self.path.iterdir():
            with suppress(OSError):
                about = file.stat()
                if file.suffix != UNFINISHED:
                    files.append((about.st_mtime, about.st_size, file))
                elif about.st_mtime < time.time() - ABANDONED_AGE:
                    file.unlink()
        size = sum(bytes_ for _, bytes_, _ in files)
        for _, bytes_, file in sorted(files):
            if size <= self.largest:
                return
            self.remove(file.name)
            size -= bytes_


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
        """Name of the file of a program; None if a part of it has no stable text.

        Args:
            function, settings: the function and its static arguments.
            values: its other arguments, of which shapes and types count.
        """
        leaves, tree = jax.tree.flatten(list(values))
        try:
            parts = [
                self._sources,
                *_platform(),
                *(f"{name}={getattr(jax.config, name, None)}" for name in SETTINGS),
                stable_text(function),
                stable_text(dict(settings)),
                _tree_text(tree),
                *map(_kind, leaves),
            ]
        except NoStableText:
            return None
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

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


def open_folder(folder: Path) -> Path | None:
    """The folder of programs, created if it is missing; None if it is not the user's own, not writable, or
    writable by others."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        tempfile.TemporaryFile(dir=folder).close()
        status = folder.stat()
        if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & WRITABLE_BY_OTHERS):
            return None
    except OSError:
        return None
    return folder


def user_folder() -> Path | None:
    """The user's folder of programs; None for a user without a home directory."""
    from platformdirs import user_cache_path  # noqa: PLC0415 - only the command line needs it

    folder = user_cache_path("dropper-jax", appauthor=False, opinion=False)
    if not folder.is_absolute():
        return None
    return folder / "programs"


def sources_digest(root: Path = Path(__file__).parents[2]) -> str:
    """Digest of all sources of the packages of this project, which are in the folder `root`."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(f"{file.relative_to(root)}\n{file.stat().st_size}\n".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def stable_text(value: object) -> str:
    """A text that two values share only if they mean the same in every process with the same sources.

    Arrays are written by their digests; objects of this project by their names and fields.

    Raises:
        NoStableText: an object of another kind, or a function that was created at run time.
    """
    match value:
        case None | bool() | int() | float() | str():
            return f"{type(value).__name__}:{value!r}"
        case np.ndarray() | np.generic() | Array():
            array = np.asarray(value)
            return f"array:{array.dtype}{array.shape}{hashlib.sha256(array.tobytes()).hexdigest()}"
        case dict():
            return _join_parts("dict", sorted(f"{stable_text(key)}={stable_text(one)}" for key, one in value.items()))
        case frozenset():
            return _join_parts("frozenset", sorted(map(stable_text, value)))
        case tuple() | list():
            return _join_parts(_type_text(type(value)), map(stable_text, value))
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = dataclasses.fields(value)
            texts = (f"{field.name}={stable_text(getattr(value, field.name))}" for field in fields)
            return _join_parts(_type_text(type(value)), texts)
        case _ if callable(value):
            return _name(value)
    raise NoStableText(type(value).__name__)


def _join_parts(kind: str, parts: Iterable[str]) -> str:
    """The texts of the parts of a value of this kind as one text."""
    return f"{kind}({','.join(parts)})"


def _type_text(kind: type) -> str:
    """The name of a type: of Python's containers, or of this project."""
    if kind in (tuple, list, dict, type(None)):
        return kind.__name__
    return _name(kind)


def _name(value: type | Callable[..., object]) -> str:
    """`module:name` of a type or function that a module of this project defines under that name."""
    module = getattr(value, "__module__", None) or ""
    name = getattr(value, "__qualname__", "")
    found = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    # a compiled function may replace its original under the same name
    original = getattr(found, "__wrapped__", found)
    if module.partition(".")[0] not in PACKAGES or (value is not found and value is not original):
        raise NoStableText(f"{module}.{name}")
    return f"{module}:{name}"


def _tree_text(tree: jax.tree_util.PyTreeDef) -> str:
    """The types of a tree and their static data, without its leaves."""
    node = tree.node_data()
    if node is None:
        if tree.num_leaves:
            return "leaf"
        return "none"
    kind, static = node
    return _join_parts(_type_text(kind) + stable_text(static), map(_tree_text, tree.children()))


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
