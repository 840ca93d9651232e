"""Labelled runs: variables derived for files (arc length, loads, attributes), and the run rebuilt from a file."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.checks_water import surface_over
from dropper_jax.run.bends import end_tensions, held_points, point_load
from dropper_jax.run.samples import Samples
from dropper_jax.run.step_extremes import LOADS
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
