"""A run rebuilt from the provenance and arrays of a file, all of them checked."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import available_memory, in_words
from dropper_jax.base.read import Plain, Table, Values
from dropper_jax.load.scene import Scene
from dropper_jax.quantities.end_links import loaded_fixed_points
from dropper_jax.quantities.step_extremes import LOADS
from dropper_jax.quantities.variables import SOME, VARIABLES
from dropper_jax.run.samples import RUN_FORMAT, Kind, Samples
from dropper_jax.scene import line_slices, whole_lines

NUMBER = (int, float)
#: Types of the provenance entries.
KINDS: dict[str, type | tuple[type, ...]] = {
    "status": str,
    "failed_steps": int,
    "retried_steps": int,
    "max_residual": NUMBER,
    "max_closure_error": NUMBER,
    "compile_s": NUMBER,
    "run_s": NUMBER,
    "versions": dict,
    "warnings": list,
    "broken": list,
    "work_names": list,
    "settings": dict,
    "scene": dict,
}
#: Entries that are None if the run failed: they were not finite.
MAY_BE_NONE = ("max_residual", "max_closure_error")
#: Required settings; numbers (and whether they may be zero) and texts are checked if present.
NEEDED = ("dt", "duration", "integrator")
NUMBERS = {"dt": False, "duration": False, "save_every": False, "residual_tolerance": True, "steps": True}
TEXTS = ("integrator", "solver", "dtype")
#: Fraction of the free memory that a file may use.
MEMORY_SHARE = 0.8


def check_archive(file: BinaryIO, path: str | Path) -> None:
    """Reject an archive whose unpacked arrays do not fit into memory.

    Raises:
        SceneError: with both sizes.
        zipfile.BadZipFile: not an archive.
    """
    with zipfile.ZipFile(file) as archive:
        size = sum(item.file_size for item in archive.infolist())
    file.seek(0)
    left = available_memory()
    if size > MEMORY_SHARE * left:
        raise SceneError(
            f"{path}: holds {in_words(size)} of arrays, but {in_words(left)} of memory are free. Use a smaller file"
        )


def reopen_run(path: str | Path, meta: Plain, arrays: Table, kind: type[Kind]) -> Kind:
    """The run, as a `kind` of samples, from the provenance and arrays of a file.

    Raises:
        SceneError: one line with the file and what is wrong with it.
    """
    if not isinstance(meta, dict) or meta.get("format") != RUN_FORMAT:
        raise SceneError(f"{path}: a saved run of another format; allowed: format {RUN_FORMAT}")
    if wrong := next(_provenance_errors(meta), None):
        raise SceneError(f"{path}: not a saved run: {wrong}")
    try:
        given = {key: value for key, value in meta.items() if key != "format"}
        scene = Scene.from_dict(given.pop("scene"))
        tuples = {key: tuple(given.pop(key, ())) for key in ("work_names", "warnings", "broken")}
        solution = kind(scene=scene, **arrays, **tuples, **given)
    except SceneError as error:
        raise SceneError(f"{path}: not a saved run: its scene: {error}") from None
    except (TypeError, ValueError, KeyError, AttributeError, IndexError, RecursionError) as error:
        raise SceneError(f"{path}: not a saved run: {' '.join(str(error).split())}") from None
    if wrong := next(_array_errors(solution), None):
        raise SceneError(f"{path}: not a saved run: {wrong}")
    return solution


def _provenance_errors(meta: Values) -> Iterator[str]:
    """The errors in the provenance, in words; checks after an error assume that there is none."""
    for key, kind in KINDS.items():
        value = meta.get(key)
        if not _has_type(value, kind) and not (value is None and key in MAY_BE_NONE):
            yield f"{key} is {type(value).__name__} in its provenance"
    settings = meta["settings"]
    for key, may_be_zero in NUMBERS.items():
        value = settings.get(key, 1)
        if not (_has_type(value, NUMBER) and 0 <= value < math.inf and (value or may_be_zero)):
            yield f"settings.{key} is {value!r:.40}"
    for key in TEXTS:
        if not isinstance(settings.get(key, ""), str):
            yield f"settings.{key} is {settings.get(key)!r:.40}"
    for key in NEEDED:
        if key not in settings:
            yield f"settings.{key} is missing"
    for key in ("warnings", "work_names"):
        if not all(isinstance(item, str) for item in meta[key]):
            yield f"{key} contains an entry that is not text"
    if not (meta.get("first_bad") is None or _has_keys(meta["first_bad"], "step", "time_s", "residual", "reason")):
        yield "first_bad lacks its step, time, residual or reason"
    if not all(_has_keys(row, "line", "link", "time_s") for row in meta["broken"]):
        yield "broken lacks a line, link or time"


def _has_type(value: Plain, kind: type | tuple[type, ...]) -> bool:
    """Whether a value is of a type; a truth value is not a number."""
    return isinstance(value, kind) and not isinstance(value, bool)


def _has_keys(row: Plain, *keys: str) -> bool:
    """Whether a value is a table with these keys."""
    return isinstance(row, dict) and row.keys() >= set(keys)


def _array_errors(solution: Samples) -> Iterator[str]:
    """The errors in the arrays, in words: types, shapes, times that do not increase, impossible values."""
    t = solution.t
    if t.ndim != 1 or not t.size or t.dtype.kind != "f":
        yield f"t has the shape {t.shape} and kind {t.dtype}"
    scene = solution.scene
    last = line_slices(scene)[-1]
    sizes = {"time": len(t), "axis": 3, "end": 2, "load": len(LOADS), "contribution": len(solution.work_names)}
    sizes |= {"node": last.nodes.stop, "link": last.links.stop, "line": len(whole_lines(scene))}
    sizes |= {"held_point": len(loaded_fixed_points(scene)), "body": len(scene.bodies)}
    for key, variable in VARIABLES.items():
        value = getattr(solution, key)
        if key == "step_status" or (value is None and key in SOME):
            continue
        shape = tuple(sizes[dimension] for dimension in variable.dimensions)
        if value.shape != shape or value.dtype.kind != "f":
            yield f"{key} has the shape {value.shape} and kind {value.dtype}, but its scene requires {shape} floats"
        if solution.status == "ok" and not np.all(np.isfinite(value)):
            yield f"{key} is not finite, although its status is ok"
    if solution.step_status.shape != t.shape or solution.step_status.dtype.kind not in "iu":
        yield f"step_status has the shape {solution.step_status.shape} and kind {solution.step_status.dtype}"
    if scene.bodies and solution.body_position is None:
        yield "the motion of its bodies is missing"
    if not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0.0):
        yield "its times do not increase"
    for name, value in solution.own.items():
        if value.shape[:1] != t.shape:
            yield f"own.{name} has the shape {value.shape}"
