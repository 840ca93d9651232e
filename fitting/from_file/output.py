"""The trace and the scene of a fit to a file, written so that one command repeats it."""

from __future__ import annotations

import shlex
from pathlib import Path

from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import as_toml
from fitting.from_file.read_file import MeasuredFile
from fitting.traces.trace_file import write_trace


def write_case(folder: Path, measured: list[MeasuredFile], scene: Table, options: list[str]) -> str:
    """Write the traces and the scene; nothing is replaced.

    Returns:
        The command with these options that repeats the fit.
    """
    folder.mkdir(parents=True, exist_ok=True)
    traces = []
    for one in measured:
        path = unused(folder, one.trace.name, ".csv")
        traces.append(str(write_trace(path, one.trace, one.notes)))
    path = atomic_write(unused(folder, "scene", ".toml"), as_toml(scene))
    return shlex.join(["dropper", "fit", *traces, "--scene", str(path), *options])


def unused(folder: Path, name: str, suffix: str = "") -> Path:
    """A path in a folder that does not exist: `NAME`, `NAME-2` ..., with the suffix."""
    number = 1
    found = folder / f"{name}{suffix}"
    while found.exists():
        number += 1
        found = folder / f"{name}-{number}{suffix}"
    return found
