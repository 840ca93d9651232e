"""Writing files so that an interrupted run never leaves half of one."""

from __future__ import annotations

import os
import re
import socket
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from dropper_jax.base.errors import SceneError

#: Ends of the names of what is being written: `.NAME.HOST-PROCESS-xxxx.part`, beside NAME.
PART = ".part"
#: Where a shell puts the output of a command that it gives as a file.
STREAMS = ("/dev/", "/proc/")
#: Seconds after which what a process of another machine was writing counts as left over.
ABANDONED = 24 * 3600.0


def refuse_pipe(path: Path, what: str) -> None:
    """Refuse a named pipe, which may never end; those that a shell puts in place of a file are read.

    Raises:
        SceneError: it is one.
    """
    if path.is_fifo() and not str(path).startswith(STREAMS):
        raise SceneError(f"{what}: {str(path)!r} is a named pipe, which may never end; allowed: a file")


def read_lines(path: Path) -> list[str]:
    """The lines of a text file in UTF-8.

    Raises:
        SceneError: it is not there, or is no such text.
    """
    refuse_pipe(path, "file")
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def folder_without(folder: str | Path, last: str) -> Path:
    """A folder, made where it is not there, without the file that is written last and speaks of all others: one of an
    earlier result would speak of this one's, were it ended midway."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / last).unlink(missing_ok=True)
    return folder


def atomic_write(path: str | Path, content: bytes | str | Callable[[BinaryIO], object]) -> Path:
    """Write a file under a temporary name in its folder, then rename it.

    Args:
        path: the file; an existing one is replaced only once the new one is complete.
        content: what to write, text as UTF-8, or a function that writes to the open binary file.

    Returns:
        The path.

    Raises:
        OSError: with the file's name, where the disk refuses.
    """
    path = Path(path)
    temporary = None
    try:
        remove_leftovers(path)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=part_prefix(path), suffix=PART)
        with os.fdopen(handle, "w+b") as file:  # netCDF reads what it wrote
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~_umask())  # mkstemp makes files private, others expect the usual rights
        os.replace(temporary, path)
    except BaseException as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise unwritable(path, error) from None
        raise
    return path


def unwritable(path: Path, error: OSError) -> OSError:
    """The same error, naming the file that was to be written."""
    reason = " ".join(str(error.strerror or error).split())
    reason = reason if reason.startswith("cannot be written") else f"cannot be written: {reason}"
    return OSError(error.errno, reason, str(path))


def part_prefix(path: Path) -> str:
    """How the names of unfinished files begin that this process writes for `path`."""
    return f".{path.name}.{_machine()}-{os.getpid()}-"


def remove_leftovers(path: Path) -> list[Path]:
    """Remove what processes that are gone were writing for `path`, files or folders; returns what went."""
    found = leftovers(path)
    for item in found:
        remove(item)
    return found


def leftovers(path: Path) -> list[Path]:
    """What processes that are gone were writing for `path`, files or folders."""
    begins, written = f".{path.name}.", re.compile(rf"(\w+)-(\d+)-.*{re.escape(PART)}")
    removed = []
    with suppress(OSError):
        for name in [name for name in os.listdir(path.parent) if name.startswith(begins)]:
            found, item = written.fullmatch(name.removeprefix(begins)), path.parent / name
            if found and _is_left(item, found[1], int(found[2])):
                removed.append(item)
    return removed


def _is_left(item: Path, machine: str, process: int) -> bool:
    if machine == _machine():
        return process != os.getpid() and not is_alive(process)
    return item.stat().st_mtime < time.time() - ABANDONED


def remove(item: Path) -> None:
    """Remove a file, or a folder with all that is in it, as far as that goes."""
    with suppress(OSError):
        if item.is_dir() and not item.is_symlink():
            for inner in item.iterdir():
                remove(inner)
            item.rmdir()
        else:
            item.unlink()


def is_alive(process: int) -> bool:
    """Whether a process of this machine is there."""
    if os.name == "nt":  # os.kill would end it
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # another user's
        pass
    return True


def _machine() -> str:
    """This machine's name, letters and digits only."""
    return re.sub(r"\W", "_", socket.gethostname()) or "unknown"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
