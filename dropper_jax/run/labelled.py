"""Labelled runs: variables derived for files (arc length, loads, attributes), and the run rebuilt from a file."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.base.read import Plain
from dropper_jax.load.checks_water import surface_over
from dropper_jax.run.bends import end_tensions, held_points, point_load
from dropper_jax.run.samples import BODIES, RUN_FORMAT, WITHIN, Kind, Samples
from dropper_jax.run.step_extremes import ARRAYS_OF, LOADS, signal_shapes
from dropper_jax.scene import line_slices, whole_lines

if TYPE_CHECKING:
    import xarray

#: How arrays are stored: compressed, with checksums.
PACKED = {"zlib": True, "complevel": 4, "fletcher32": True}
#: Reference date of the time in files: CF requires one, but simulated time has no date.
EPOCH = "seconds since 2000-01-01 00:00:00"
#: CF standard names of the variables that have one.
STANDARD_NAMES = {"time": "time", "elevation": "sea_surface_height_above_mean_sea_level"}
#: Values of a flag and their meanings.
FLAGS = {"step_status": ((0, 1), "good failed")}
Variables = dict[str, tuple[Any, ...]]


def derive_variables(solution: Samples) -> Variables:
    """Variables computed from a run: surface at the origin, forces on fixed points, tension at the ends of lines."""
    arrays = (solution.t, solution.positions, solution.t_tension, solution.tension)
    loads = [point_load(solution.scene, name, *arrays) for name in held_points(solution.scene)]
    found: Variables = {}
    if loads:
        meaning = "sum of the forces of the lines that end at a fixed point; at tension_time"
        found["point_load"] = (("time", "held_point", "axis"), np.stack(loads, axis=1), _attributes("N", meaning))
    ends = np.stack(list(end_tensions(solution.scene, solution.tension).values()), axis=1)
    meaning = "tension of the first and the last link of each line; at tension_time"
    found["end_tension"] = (("time", "line", "end"), ends, _attributes("N", meaning))
    if solution.scene.sea is not None:
        eta = surface_over(solution.scene, np.zeros((len(solution.t), 1, 3)), solution.t)[:, 0]
        found["elevation"] = ("time", eta, _attributes("m", "elevation of the surface at x = 0, y = 0"))
    return found


def coordinates(solution: Samples) -> Variables:
    """Coordinates: arc length of nodes and links, names of fixed points, lines and ends."""
    nodes = []
    links = []
    node_names: list[str] = []
    link_names: list[str] = []
    for line in whole_lines(solution.scene):
        stops = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        links.append(0.5 * (stops[1:] + stops[:-1]))
        link_names += [line.name] * len(links[-1])
        # a node that joins two pieces belongs to both
        for piece in (w.links for w in solution.lines if line.links.start <= w.links.start < line.links.stop):
            nodes.append(stops[piece.start - line.links.start : piece.stop - line.links.start + 1])
            node_names += [line.name] * len(nodes[-1])
    along = "unstretched arc length from the start of the line"
    found: Variables = {
        "arc_length_of_node": ("node", np.concatenate(nodes), _attributes("m", along)),
        "arc_length_of_link": ("link", np.concatenate(links), _attributes("m", f"{along} to the middle of the link")),
        "line": ("line", np.array(list(dict.fromkeys(link_names)), dtype=str), {"long_name": "line as written"}),
        "end": ("end", ["first", "last"], {"long_name": "end of a line"}),
        "written_line_of_node": ("node", np.array(node_names, dtype=str), {"long_name": "line, pieces together"}),
        "written_line_of_link": ("link", np.array(link_names, dtype=str), {"long_name": "line, pieces together"}),
    }
    if names := held_points(solution.scene):
        found["held_point"] = ("held_point", np.array(names, dtype=str), {"long_name": "fixed point"})
        if solution.point_load_max is not None:
            found["load"] = ("load", list(LOADS), {"long_name": "part of a load, vertical upwards"})
    return found


def select_line(dataset: xarray.Dataset, name: str) -> xarray.Dataset:
    """The nodes, links and ends of one line of a labelled run.

    Args:
        dataset: what `Solution.to_xarray` gives, or a file of `dropper run --out run.nc` as xarray opens it.
        name: name of the line in the scene; pieces between attached points have their own names as well.

    Raises:
        SceneError: there is no such line.
    """
    for kind in ("written_line_of", "line_of"):
        if f"{kind}_link" in dataset.coords and name in dataset[f"{kind}_link"].values:
            kept = {key: np.flatnonzero(dataset[f"{kind}_{key}"].values == name) for key in ("node", "link")}
            found = dataset.isel(kept)
            if name in dataset["line"].values:
                return found.sel(line=name)
            return found
    raise SceneError(f"line: {name!r} is not a line; {nearest(name, [str(n) for n in dataset['line'].values])}")


def for_file(dataset: xarray.Dataset) -> tuple[xarray.Dataset, dict[str, dict[str, Any]]]:
    """The dataset and its encoding for a CF file.

    Time counts from a date; names are arrays of characters, since a coordinate variable must be a number; nothing is
    missing, so coordinates have no fill value.
    """
    dataset = dataset.copy()
    comment = {"comment": "simulated time: the date has no meaning", "units_metadata": "leap_seconds: none"}
    dataset["time"].attrs.update(units=EPOCH, calendar="standard", **comment)
    packed: dict[str, dict[str, Any]] = {}
    for name in dataset.variables:
        variable = dataset[name]
        if variable.dtype.kind in "UO":
            packed[name] = {"dtype": "S1", "char_dim_name": f"{str(name).replace('.', '_')}_length"}
        elif name in dataset.coords:
            packed[name] = {"_FillValue": None}
        elif variable.ndim and variable.size:
            packed[name] = PACKED
    return dataset, packed


def add_attributes(dataset: xarray.Dataset) -> xarray.Dataset:
    """CF's standard names and the meanings of flags."""
    for name, standard in STANDARD_NAMES.items():
        if name in dataset.variables:
            dataset[name].attrs["standard_name"] = standard
    for name, (values, meanings) in FLAGS.items():
        dataset[name].attrs.update(flag_values=np.array(values, dataset[name].dtype), flag_meanings=meanings)
    return dataset


def _attributes(units: str, meaning: str) -> dict[str, str]:
    return {"units": units, "long_name": meaning}


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


def reopen_run(path: str | Path, meta: Plain, arrays: dict[str, Any], kind: type[Kind]) -> Kind:
    """The run, as a `kind` of samples, from the provenance and arrays of a file.

    Raises:
        SceneError: one line with the file and what is wrong with it.
    """
    if not isinstance(meta, dict) or meta.get("format") != RUN_FORMAT:
        raise SceneError(f"{path}: a saved run of another format; allowed: format {RUN_FORMAT}")
    if wrong := next(_wrong_about(meta), None):
        raise SceneError(f"{path}: not a saved run: {wrong}")
    try:
        solution = kind.restore(meta, arrays)
    except SceneError as error:
        raise SceneError(f"{path}: not a saved run: its scene: {error}") from None
    except (TypeError, ValueError, KeyError, AttributeError, IndexError, RecursionError) as error:
        raise SceneError(f"{path}: not a saved run: {' '.join(str(error).split())}") from None
    if wrong := next(_wrong_arrays(solution), None):
        raise SceneError(f"{path}: not a saved run: {wrong}")
    return solution


def _wrong_about(meta: Mapping[str, Any]) -> Iterator[str]:
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
