"""Compiled programs cached between processes, in a folder of the user.

JAX can cache compiled programs in a folder, but it writes them in place and never replaces a file that it cannot read.
`Entries` replaces its file store. Each file is written under a temporary name and renamed, and it carries a digest. A
file with a wrong digest is removed. When the folder grows beyond 1 GB, the least recently used files are deleted.

A folder belongs to one JAX version and one kind of processor, because programs contain its instructions.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import jax

from dropper_jax.backend import is_plain

try:
    from jax._src import compilation_cache
except ImportError:
    compilation_cache = None

#: Environment variable that names the folder: `on` for the user's default folder, `off` or empty for no cache.
VARIABLE = "DROPPER_COMPILE_CACHE"
OFF, ON = "off", "on"
#: Age [s] after which a temporary file counts as left over from a stopped process.
ABANDONED = 3600.0
#: Names in JAX's module that this code relies on.
NEEDED = ("_cache", "_cache_initialized", "reset_cache")
#: First bytes of a file, before the digest and the program.
MARK, UNFINISHED = b"dropper1", ".unfinished"
DIGEST = hashlib.sha256().digest_size


def open_cache() -> Path | None:
    """Enable the cache given by `DROPPER_COMPILE_CACHE`; returns the folder, or None if there is no usable folder."""
    folder = cache_folder()
    return None if folder is None or is_plain() else compile_cache(folder)


def cache_folder() -> Path | None:
    """The folder of compiled programs that the environment specifies, or None."""
    named = os.environ.get(VARIABLE, OFF)
    if named == ON:
        from platformdirs import user_cache_path  # noqa: PLC0415 - only the command line needs it

        folder = user_cache_path("dropper-jax", appauthor=False, opinion=False)
        return folder if folder.is_absolute() else None  # the user has no home directory
    return None if named in ("", OFF) else Path(named)


def compile_cache(folder: str | Path) -> Path | None:
    """Enable the cache of compiled programs in a folder, and use the programs that it contains.

    XLA writes lines about processor features to standard error when it loads a program; some of these are its own
    hints. The command line hides them. In Python, set the environment variable `TF_CPP_MIN_LOG_LEVEL` to 3 before JAX
    is imported.

    Returns:
        The subfolder for this JAX version and processor; None if it cannot be written or this JAX is organised
        differently.
    """
    store = _jax_store()
    if store is None:
        return None
    cache_folder = Path(folder) / f"jax-{jax.__version__}-{_processor()}"
    try:
        cache_folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=cache_folder).close()
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", str(cache_folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    store.reset_cache()
    store._cache, store._cache_initialized = Entries(cache_folder), True
    # programs for another kind of processor are recompiled and replaced
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    return cache_folder


class Entries:
    """Files of a folder in the interface of JAX's cache: bytes by key."""

    def __init__(self, folder: Path, largest: int = 1_000_000_000) -> None:
        self._path, self.largest = folder, largest
        self._unseen = largest  # bytes stored since the files were last looked at

    def get(self, key: str) -> bytes | None:
        """The program with that key; None if it is missing or damaged. A damaged file is removed."""
        file = self._path / key
        try:
            found = file.read_bytes()
        except OSError:
            return None
        head, program = found[: len(MARK) + DIGEST], found[len(MARK) + DIGEST :]
        with suppress(OSError):
            if head != MARK + hashlib.sha256(program).digest():
                file.unlink()
                return None
            os.utime(file)
        return program

    def write(self, key: str, value: bytes) -> None:
        """Store a program, replacing an existing one."""
        with suppress(OSError):
            with tempfile.NamedTemporaryFile(dir=self._path, suffix=UNFINISHED, delete=False) as beside:
                beside.write(MARK + hashlib.sha256(value).digest() + value)
            os.replace(beside.name, self._path / key)
            self._unseen += len(value)
            if self._unseen > self.largest / 64:  # looking at all files costs more than storing one
                self._evict_old()
                self._unseen = 0

    put = write  # JAX's name of it

    def remove(self, key: str) -> None:
        """Remove a program."""
        with suppress(OSError):
            (self._path / key).unlink()

    def _evict_old(self) -> None:
        files = []
        for file in self._path.iterdir():
            with suppress(OSError):
                about = file.stat()
                if file.suffix != UNFINISHED:
                    files.append((about.st_mtime, about.st_size, file))
                elif about.st_mtime < time.time() - ABANDONED:
                    file.unlink()
        size = sum(bytes_ for _, bytes_, _ in files)
        for _, bytes_, file in sorted(files):
            if size <= self.largest:
                return
            with suppress(OSError):
                file.unlink()
            size -= bytes_


def _jax_store() -> ModuleType | None:
    """JAX's own compilation cache module, if it has the structure known here."""
    return compilation_cache if all(hasattr(compilation_cache, name) for name in NEEDED) else None


def _processor() -> str:
    """A short name for this kind of processor."""
    said = platform.machine() + platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        said += "".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))
    return hashlib.sha256(said.encode()).hexdigest()[:12]
