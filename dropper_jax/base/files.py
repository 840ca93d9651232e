"""Files: atomic writing, reading of lines, and removal of the unfinished files of ended processes."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from dropper_jax.base.errors import SceneError

#: Suffixes of files that contain a complete run; one without a suffix is an `.npz` file.
RUN_SUFFIXES = (".npz", ".nc", ".zarr")
#: Suffix of temporary files: `.NAME.HOST-PROCESS-xxxx.part`, in the same folder as NAME.
PART_SUFFIX = ".part"
#: Folders in which a shell puts command output that it passes as a file.
PIPE_FOLDERS = ("/dev/", "/proc/")


def refuse_pipe(path: Path, what: str) -> None:
    """Reject a named pipe, which may never end. Pipes that a shell passes in place of a file are read.

    Raises:
        SceneError: the path is a named pipe.
    """
    is_pipe = False
    with suppress(OSError):  # of a name that is too long: reading the file gives the error
        is_pipe = path.is_fifo()
    if is_pipe and not str(path).startswith(PIPE_FOLDERS):
        raise SceneError(f"{what}: {str(path)!r} is a named pipe, which may never end. Use a regular file")


def read_lines(path: Path) -> list[str]:
    """The lines of a UTF-8 text file.

    Raises:
        SceneError: the file does not exist or is not UTF-8 text.
    """
    refuse_pipe(path, "file")
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:  # a text that is not UTF-8 is a ValueError
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def prepare_folder(folder: str | Path, last: str) -> Path:
    """Create a folder, and remove the file `last` of an earlier result.

    That file is written last and describes all others, so it would describe new files wrongly if this run stopped
    early.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / last).unlink(missing_ok=True)
    return folder


def atomic_write(path: str | Path, content: bytes | str | Callable[[BinaryIO], object], sync: bool = True) -> Path:
    """Write a file under a temporary name in its folder, then rename it.

    Args:
        path: the file; an existing one is replaced only when the new one is complete.
        content: what to write: bytes, text as UTF-8, or a function that writes to the open binary file.
        sync: wait for the disk, so that the file also survives a power cut.

    Returns:
        The path.

    Raises:
        OSError: the file cannot be written; the error contains its name.
    """
    path = Path(path)
    if isinstance(content, str):
        content = content.encode()
    temporary = path.with_name(f"{part_prefix(path)}{secrets.token_hex(4)}{PART_SUFFIX}")
    try:
        remove_leftovers(path)
        with open(temporary, "x+b") as file:  # netCDF reads back what it wrote
            if callable(content):
                content(file)
            else:
                file.write(content)
            file.flush()
            if sync:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise unwritable(path, error) from None
        raise
    return path


def unwritable(path: Path, error: Exception) -> OSError:
    """The same error with the name of the target file."""
    reason = " ".join(str(getattr(error, "strerror", None) or error).split())
    if not reason.startswith("cannot be written"):
        reason = f"cannot be written: {reason}"
    return OSError(getattr(error, "errno", None), reason, str(path))


def part_prefix(path: Path) -> str:
    """Prefix of the names of unfinished files that this process writes for `path`."""
    return f".{path.name}.{_machine()}-{os.getpid()}-"


def remove_leftovers(path: Path) -> None:
    """Remove the `leftovers` of a path."""
    for item in leftovers(path):
        remove(item)


def leftovers(path: Path) -> list[Path]:
    """The unfinished files and folders that ended processes left for `path`."""
    written = re.compile(rf"\.{re.escape(path.name)}\.(\w+)-(\d+)-.*{re.escape(PART_SUFFIX)}")
    found = []
    with suppress(OSError):
        for item in path.parent.iterdir():
            name = written.fullmatch(item.name)
            if name and _is_leftover(item, name[1], int(name[2])):
                found.append(item)
    return found


#: Process numbers are below this. A name with a larger one was not written by this package.
NO_PROCESS = 2**31
#: Age [s] after which a temporary file of another machine's process counts as left over.
LEFT_OVER_AGE = 24 * 3600.0


def _is_leftover(item: Path, machine: str, process: int) -> bool:
    """Whether the process that wrote an unfinished file or folder has ended."""
    if machine != _machine():
        return item.stat().st_mtime < time.time() - LEFT_OVER_AGE
    import psutil  # noqa: PLC0415 - 20 ms that starting does not need

    is_running = process < NO_PROCESS and psutil.pid_exists(process)
    return process != os.getpid() and not is_running


@contextmanager
def unfinished_folder(path: Path) -> Generator[Path, None, None]:
    """A temporary empty folder next to `path`, in which its content is prepared; it is removed at the end.

    Raises:
        OSError: the folder cannot be made; the error contains the name of `path`.
    """
    try:
        folder = Path(tempfile.mkdtemp(dir=path.parent, prefix=part_prefix(path), suffix=PART_SUFFIX))
    except OSError as error:
        raise unwritable(path, error) from None
    try:
        yield folder
    finally:
        remove(folder)


def remove(item: Path) -> None:
    """Remove a file, or a folder with all its contents, as far as possible."""
    with suppress(OSError):
        if item.is_dir() and not item.is_symlink():
            shutil.rmtree(item, ignore_errors=True)
        else:
            item.unlink()


def _machine() -> str:
    """This machine's name, reduced to letters and digits."""
    return re.sub(r"\W", "_", socket.gethostname()) or "unknown"
