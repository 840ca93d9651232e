"""Labelled runs: coordinates and derived variables of files (arc length, loads), their attributes and encoding."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import surface_over
from dropper_jax.quantities.end_links import load_vectors, loaded_fixed_points
from dropper_jax.quantities.step_extremes import LOADS
from dropper_jax.run.samples import Samples
from dropper_jax.scene import whole_lines

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
#: How each variable of a dataset is stored.
Encoding = dict[Hashable, dict[str, Any]]


def derive_variables(solution: Samples) -> Variables:
    """Variables computed from a run: surface at the origin, forces on fixed points, tension at the ends of lines."""
    found: Variables = {}
    if loaded_fixed_points(solution.scene):
        vectors = load_vectors(solution.motion)
        meaning = "sum of the forces of the lines that end at a fixed point; at tension_time"
        found["point_load"] = (("time", "held_point", "axis"), vectors, _attributes("N", meaning))
    links = [(line.links.start, line.links.stop - 1) for line in whole_lines(solution.scene)]
    ends = solution.tension[:, np.array(links)]
    meaning = "tension of the first and the last link of each line; at tension_time"
    found["end_tension"] = (("time", "line", "end"), ends, _attributes("N", meaning))
    if solution.scene.sea is not None:
        eta = surface_over(solution.scene, np.zeros((len(solution.t), 1, 3)), solution.t)[:, 0]
        found["elevation"] = ("time", eta, _attributes("m", "elevation of the surface at x = 0, y = 0"))
    return found


def coordinates(solution: Samples) -> Variables:
    """Coordinates: time and axes, numbers, arc lengths and lines of nodes and links, names of points, bodies, works."""
    scene = solution.scene
    along = "unstretched arc length from the start of the line"
    written = [line.piece_of or line.name for line in scene.lines]
    arc = _arc_lengths(scene, written)
    counts = np.array([line.links + 1 for line in scene.lines])
    number = np.concatenate([np.arange(count) for count in counts])
    ends_link = number > 0  # every node but the first of a line is the last node of a link
    of_node = np.repeat(written, counts)
    found: Variables = {
        "time": ("time", solution.t, {**_attributes("s", "simulated time"), "axis": "T"}),
        "arc_length_of_node": ("node", arc, _attributes("m", along)),
        "arc_length_of_link": (
            "link",
            0.5 * (arc[1:] + arc[:-1])[ends_link[1:]],
            _attributes("m", f"{along} to the middle of the link"),
        ),
    }
    nodes = np.arange(len(number))
    names: list[tuple[str, str, Sequence[str] | np.ndarray, str]] = [
        ("line", "line", list(dict.fromkeys(written)), "line as written"),
        ("end", "end", ["first", "last"], "end of a line"),
        ("written_line_of_node", "node", of_node, "line, pieces together"),
        ("written_line_of_link", "link", of_node[ends_link], "line, pieces together"),
        ("axis", "axis", ["x", "y", "z"], "z is positive upwards"),
        ("contribution", "contribution", solution.work_names, "source of the work"),
    ]
    if len(scene.lines) == 1:
        names += [
            ("node", "node", nodes, "node, both ends included"),
            ("link", "link", nodes[1:], "link j joins nodes j - 1 and j"),
        ]
    else:
        lines = np.repeat(names_of(scene.lines), counts)
        of_line = number[ends_link]
        links = [f"{name}/{j}" for name, j in zip(lines[ends_link], of_line, strict=True)]
        names += [
            ("node", "node", nodes, "node, line after line, both ends of each included"),
            ("link", "link", links, "line/link: link j of a line joins its nodes j - 1 and j"),
            ("line_of_node", "node", lines, "line to which a node belongs"),
            ("node_of_line", "node", number, "number of a node in its line"),
            ("line_of_link", "link", lines[ends_link], "line to which a link belongs"),
            ("link_of_line", "link", of_line, "number of a link in its line"),
        ]
    if held := loaded_fixed_points(scene):
        names.append(("held_point", "held_point", held, "fixed point"))
        if solution.point_load_max is not None:
            names.append(("load", "load", LOADS, "part of a load, vertical upwards"))
    if scene.bodies:
        names.append(("body", "body", names_of(scene.bodies), "rigid body"))
    for name, axis, values, meaning in names:
        if not isinstance(values, np.ndarray):
            values = np.array(values, dtype=str)
        found[name] = (axis, values, {"long_name": meaning})
    return found


def _arc_lengths(scene: Scene, written: list[str]) -> np.ndarray:
    """Unstretched arc length (nodes,) [m] of all nodes from the start of their line, pieces together."""
    arcs = []
    ends = dict.fromkeys(written, 0.0)
    for name, line in zip(written, scene.lines, strict=True):
        # a node that joins two pieces belongs to both
        arcs.append(np.cumsum([ends[name], *line.length]))
        ends[name] = arcs[-1][-1]
    return np.concatenate(arcs)


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
            own = {key: np.flatnonzero(dataset[f"{kind}_{key}"].values == name) for key in ("node", "link")}
            found = dataset.isel(own)
            if name in dataset["line"].values:
                return found.sel(line=name)
            return found
    raise SceneError(f"line: {name!r} is not a line; {nearest(name, [str(n) for n in dataset['line'].values])}")


def for_file(dataset: xarray.Dataset) -> tuple[xarray.Dataset, Encoding]:
    """The dataset and its encoding for a CF file.

    Time counts from a date; names are arrays of characters, since a coordinate variable must be a number; nothing is
    missing, so coordinates have no fill value.
    """
    dataset = dataset.copy()
    comment = {"comment": "simulated time: the date has no meaning", "units_metadata": "leap_seconds: none"}
    dataset["time"].attrs.update(units=EPOCH, calendar="standard", **comment)
    packed: Encoding = {}
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
