"""Abnormal ends of a command: invalid input, signals, streams that cannot be written, internal errors.

Each ends in one line on standard error and, with `--json`, one object on standard output. An unexpected error is also
reported in one line, with the exit code of a failed run; Python's development mode (`PYTHONDEVMODE=1`) shows
where it happened.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.printing import FAILED, INTERRUPTED, INVALID_INPUT, STOPPED, failure_object, print_json, print_line

#: Messages of JAX on an unavailable platform, and on memory.
NO_BACKEND = "Unable to initialize backend"
NO_MEMORY = ("RESOURCE_EXHAUSTED", "Out of memory")
#: Errors of a stream that cannot be written.
REFUSALS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF, errno.EFBIG)
#: Errors of a disk that cannot be written, which are not errors of the input.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)


def with_streams() -> None:
    """Replace standard streams that are closed at the start: otherwise `print` fails, or the next opened file replaces
    them."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - as long as the process


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Handle SIGTERM like SIGINT, so that partial results are kept. A handler set by other code is not replaced."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def defer_signals() -> Iterator[None]:
    """Finish this block before a signal is handled; a second signal is handled immediately."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def wait(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            raise KeyboardInterrupt

    for number in before:
        signal.signal(number, wait)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if received:
        raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def report_error(error: BaseException, as_json: bool) -> int:
    """Report the error that ended the command; returns its exit code."""
    nameless = isinstance(error, OSError) and error.filename is None and error.errno in REFUSALS
    if nameless or _output_is_stuck():  # errors of files have the names of the files
        close_stdout()
        reason = getattr(error, "strerror", None) or "is closed"
        print_line(f"error: standard output: cannot be written: {reason}")
        return FAILED
    status, message, code = classify_error(error)
    if status == "internal_error" and sys.flags.dev_mode:
        traceback.print_exception(error)
    message = " ".join(message.split())
    print_line(f"error: {message}")
    if as_json:
        try:
            print_json(failure_object(status, message))
        except OSError as refused:
            close_stdout()
            print_line(f"error: standard output: cannot be written: {refused.strerror}")
            return FAILED
    return code


def _caused_by_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt is the cause: JAX turns one that comes while it compares keys into a ValueError."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def classify_error(error: BaseException) -> tuple[str, str, int]:
    """Status, message and exit code of the error that ended a command."""
    # maximum length of the text of an error in its line
    shown = 300
    if isinstance(error, KeyboardInterrupt):
        return *STOPPED, INTERRUPTED
    if isinstance(error, SceneError):
        return "invalid_input", str(error), INVALID_INPUT
    if isinstance(error, OSError):
        if error.errno in FULL:
            return "not_saved", _of_file(error), FAILED
        return "invalid_input", _of_file(error), INVALID_INPUT
    text = " ".join(str(error).split())
    if NO_BACKEND in text:
        wanted = os.environ.get("JAX_PLATFORMS", "")
        message = f"JAX_PLATFORMS: {wanted!r} cannot be used here. Use cpu, or leave it unset"
        return "invalid_input", message, INVALID_INPUT
    if isinstance(error, MemoryError) or any(word in text for word in NO_MEMORY):
        message = f"out of memory: {text[:shown] or 'no memory is free'}; a shorter run needs less"
        return "out_of_memory", message, FAILED
    if isinstance(error, RecursionError):
        return "invalid_input", "the input is nested too deeply", INVALID_INPUT
    if _caused_by_interrupt(error):
        return *STOPPED, INTERRUPTED
    what = f"{type(error).__name__}: {text}"[:shown]
    return "internal_error", f"internal: {what} (PYTHONDEVMODE=1 shows where; the input is not the cause)", FAILED


def _of_file(error: OSError) -> str:
    """The file and its error."""
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}"


def _output_is_stuck() -> bool:
    """Whether standard output cannot be written."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        return True
    return False


def close_stdout() -> None:
    """Discard further output: otherwise Python reports an error when it flushes at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
