"""The trace and the scene of a fit to a file, written so that one command repeats it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import as_toml
from fitting.from_file.read_file import Measured
from fitting.traces.trace import write_trace


@dataclass(frozen=True)
class Case:
    """Files that repeat a fit."""

    traces: tuple[Path, ...]
    scene: Path
    options: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """The command that repeats the fit."""
        return shlex.join(["dropper", "fit", *map(str, self.traces), "--scene", str(self.scene), *self.options])


def new_folder(name: str) -> Path:
    """A folder in the current one that does not exist: `NAME-fit`, `NAME-fit-2` ..."""
    number = 1
    while (folder := Path(f"{name}-fit" if number == 1 else f"{name}-fit-{number}")).exists():
        number += 1
    return folder


def write_case(folder: Path, measured: list[Measured], scene: Table, options: tuple[str, ...]) -> Case:
    """Write the traces and the scene; nothing is replaced. `options` are those of the command that repeats the fit."""
    folder.mkdir(parents=True, exist_ok=True)
    traces = []
    for one in measured:
        path = unused(folder / f"{one.trace.name}.csv")
        traces.append(write_trace(path, one.trace, [note.replace("=", " ") for note in one.notes]))
    path = unused(folder / "scene.toml")
    return Case(tuple(traces), atomic_write(path, as_toml(scene)), options)


def unused(path: Path) -> Path:
    """The path, or one with a number that does not exist."""
    number = 1
    found = path
    while found.exists():
        number += 1
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return found
