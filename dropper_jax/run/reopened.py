"""A run rebuilt from the provenance and arrays of a file, all of them checked."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.base.read import Plain, Table, Values
from dropper_jax.load.scene import Scene
from dropper_jax.run.samples import BODIES, RUN_FORMAT, WITHIN, Kind, Samples
from dropper_jax.run.step_extremes import ARRAYS_OF, signal_shapes
from dropper_jax.scene import line_slices

#: Types of the provenance entries.
KINDS: dict[str, type | tuple[type, ...]] = {
    "status": str,
    "failed_steps": int,
    "retried_steps": int,
    "max_residual": (int, float),
    "max_closure_error": (int, float),
    "compile_s": (int, float),
    "run_s": (int, float),
    "versions": dict,
    "warnings": list,
    "broken": list,
    "work_names": list,
    "settings": dict,
    "scene": dict,
}
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
    if wrong := next(_wrong_about(meta), None):
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
    if wrong := next(_wrong_arrays(solution), None):
        raise SceneError(f"{path}: not a saved run: {wrong}")
    return solution


def _wrong_about(meta: Values) -> Iterator[str]:
    """The error in the provenance, in words."""
    for key, kind in KINDS.items():
        value = meta.get(key)
        if value is None and key in ("max_residual", "max_closure_error"):  # not finite if the run failed
            continue
        if not isinstance(value, kind) or isinstance(value, bool):
            yield f"{key} is {type(value).__name__} in its provenance"
    if isinstance(meta.get("settings"), dict):
        settings = meta["settings"]
    else:
        settings = {}
    for key, may_be_zero in NUMBERS.items():
        value = settings.get(key, 1)
        known = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < math.inf
        if not known or (value == 0 and not may_be_zero):
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
    bad = meta.get("first_bad")
    if bad is not None and not (isinstance(bad, dict) and {"step", "time_s", "residual", "reason"} <= bad.keys()):
        yield "first_bad lacks its step, time, residual or reason"
    for row in meta["broken"]:
        if not (isinstance(row, dict) and {"line", "link", "time_s"} <= row.keys()):
            yield "broken lacks a line, link or time"


def _wrong_arrays(solution: Samples) -> Iterator[str]:
    """The error in the arrays, in words: types, shapes, times that do not increase, impossible values."""
    lines = line_slices(solution.scene)
    nodes = lines[-1].nodes.stop
    links = lines[-1].links.stop
    t = solution.t
    if t.ndim != 1 or not t.size or t.dtype.kind != "f":
        yield f"t has the shape {t.shape} and kind {t.dtype}"
        return
    k = len(t)
    shapes = {
        "positions": (k, nodes, 3),
        "velocities": (k, nodes, 3),
        "tension": (k, links),
        "t_tension": (k,),
        "kinetic": (k,),
        "potential": (k,),
        "work": (k, len(solution.work_names)),
        "tension_square": (k, links),
        **{
            f"{signal}_{name}": (k, *shape)
            for signal, shape in signal_shapes(solution.scene).items()
            for name in ARRAYS_OF
        },
        **{name: (k, len(solution.scene.bodies), 3) for name in BODIES},
    }
    for name, shape in shapes.items():
        value = getattr(solution, name)
        if value is None and name in (*WITHIN, *BODIES):
            continue
        if value.shape != shape or value.dtype.kind != "f":
            yield f"{name} has the shape {value.shape} and kind {value.dtype}, but its scene requires {shape} floats"
            return
        if solution.status == "ok" and not np.all(np.isfinite(value)):
            yield f"{name} is not finite, although its status is ok"
    if solution.step_status.shape != (k,) or solution.step_status.dtype.kind not in "iu":
        yield f"step_status has the shape {solution.step_status.shape} and kind {solution.step_status.dtype}"
    if solution.scene.bodies and solution.body_position is None:
        yield "the motion of its bodies is missing"
    if not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0.0):
        yield "its times do not increase"
    for name, value in solution.own.items():
        if value.shape[:1] != (k,):
            yield f"own.{name} has the shape {value.shape}"
