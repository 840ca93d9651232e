"""A run for ParaView: one XML PolyData file (.vtp) per saved time and a collection (.pvd) with the times."""

from __future__ import annotations

import base64
import re
import struct
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.evaluation.record import good_samples
from dropper_jax.run.simulate import Solution
from dropper_jax.scene.slices import first_nodes

TYPES = {"f": ("Float64", "<f8"), "i": ("Int32", "<i4")}


def write_vtk(solution: Solution, folder: str | Path, every: int = 1) -> Path:
    """Write `lines_NNNNNN.vtp` (and `buoys_NNNNNN.vtp`) for every `every`th saved time, and their index `NAME.pvd`.

    A link is a cell with its `tension` [N] (of the step before the saved time), `line` and `link` (counted from 1) and,
    if the lines have one, `diameter` [m]; nodes have their `velocity` [m/s] and, of lines with bending stiffness,
    their `curvature` [1/m] and `bending_moment` [N m]. A buoy is its axis with its
    `diameter`. Samples that are not finite are left out.

    Returns:
        path of the collection.

    Raises:
        SceneError: no sample is finite.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    is_good = good_samples(solution)
    good = [k for k in range(0, len(solution.t), every) if is_good[k]]
    if not good:
        raise SceneError(f"{solution.scene.name}: no finite sample. Use a run with at least one")
    entries = []
    for count, k in enumerate(good):
        parts = {"lines": _lines(solution, k)}
        if solution.scene.buoys:
            parts["buoys"] = _buoys(solution, k)
        for part, (name, text) in enumerate(parts.items()):
            file = f"{name}_{count:06d}.vtp"
            atomic_write(folder / file, text)
            entries.append(f'<DataSet timestep="{float(solution.t[k])!r}" group="" part="{part}" file="{file}"/>')
    names = [f"{i} {line.name}" for i, line in enumerate(solution.scene.lines, start=1)]
    comment = f"{solution.scene.name}: lines {', '.join(names)}"
    text = (
        '<?xml version="1.0"?>\n'
        f"<!-- {re.sub('-{2,}', '-', escape(comment))} -->\n"
        '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian" header_type="UInt32">\n<Collection>\n'
        + "\n".join(entries)
        + "\n</Collection>\n</VTKFile>\n"
    )
    return atomic_write(folder / "run.pvd", text)


def _lines(solution: Solution, k: int) -> str:
    """The links of a sample as PolyData."""
    first = first_nodes(solution.scene)
    counts = [where.links.stop - where.links.start for where in solution.lines]
    link = np.concatenate([1 + np.arange(count) for count in counts])
    cells = {"tension": solution.tension[k], "line": np.repeat(1 + np.arange(len(counts)), counts), "link": link}
    diameter = solution.scene.line.diameter
    if diameter is not None:
        cells["diameter"] = diameter
    ends = np.stack([first, first + 1], axis=1)
    nodes = {"velocity": solution.velocities[k]}
    if solution.curvature is not None and solution.bending_moment is not None:
        nodes |= {"curvature": solution.curvature[k], "bending_moment": solution.bending_moment[k]}
    return polydata(solution.positions[k], ends, nodes, cells)


def _buoys(solution: Solution, k: int) -> str:
    """The buoys of a sample as PolyData."""
    positions = []
    diameter = []
    for buoy in solution.scene.buoys:
        base = solution.point_path(buoy.point)[k] - [0.0, 0.0, buoy.attachment]
        positions += [base, base + [0.0, 0.0, buoy.height]]
        diameter.append(buoy.diameter)
    ends = np.arange(len(positions)).reshape(-1, 2)
    return polydata(np.array(positions), ends, {}, {"diameter": np.array(diameter)})


def polydata(
    points: np.ndarray, ends: np.ndarray, at_points: dict[str, np.ndarray], at_cells: dict[str, np.ndarray]
) -> str:
    """An XML PolyData file of straight cells: points (p, 3), ends (c, 2) as indices of points, data by name."""
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt32">',
            f'<PolyData>\n<Piece NumberOfPoints="{len(points)}" NumberOfVerts="0" NumberOfLines="{len(ends)}" '
            'NumberOfStrips="0" NumberOfPolys="0">',
            "<PointData>",
            *(_array(name, values) for name, values in at_points.items()),
            "</PointData>\n<CellData>",
            *(_array(name, values) for name, values in at_cells.items()),
            "</CellData>\n<Points>",
            _array("Points", points),
            "</Points>\n<Lines>",
            _array("connectivity", ends.ravel()),
            _array("offsets", 2 * (1 + np.arange(len(ends)))),
            "</Lines>\n</Piece>\n</PolyData>\n</VTKFile>\n",
        ]
    )


def _array(name: str, values: np.ndarray) -> str:
    """A data array in base64: the number of bytes (UInt32), then the values."""
    kind, dtype = TYPES[values.dtype.kind]
    content = np.ascontiguousarray(values, dtype).tobytes()
    code = base64.b64encode(struct.pack("<I", len(content)) + content).decode()
    width = ""
    if values.ndim == 2:
        width = f' NumberOfComponents="{values.shape[1]}"'
    return f'<DataArray type="{kind}" Name="{name}"{width} format="binary">{code}</DataArray>'
