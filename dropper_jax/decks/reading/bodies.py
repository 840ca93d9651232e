"""Free bodies and rods of MoorDyn as `[[body]]` tables.

A body's mass, centre of mass and inertia about it include those of the rods on it, which become its cylinders. A volume
of the body itself becomes a sphere about the centre of mass. A free rod becomes a separate body.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.decks.reading.sections import Row
from dropper_jax.decks.reading.spars import BODY_PARTS, rod_values

#: Products of inertia below this fraction of the maximum moment are rounding.
ROUNDING = 1e-12


class Solid(NamedTuple):
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2]."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


def free_body(row: Row, rods: list[Row]) -> Table:
    """`[[body]]` of a free body and the rods on it; its attachments are added with the points."""
    row.need(13, "body")
    what = f"body {row.words[0]}"
    angles = np.radians(row.values(5, 8, "r0, p0, y0")).tolist()
    if np.count_nonzero(angles) > 1:
        row.refuse(f"{what}: is rotated about several axes; allowed: about one of x, y and z")
    centre = row.parts(9, "CG", (1, 3))
    if len(centre) == 1:  # MoorDyn: one number is the height of the centre on the body's z-axis
        centre = [0.0, 0.0, centre[0]]
    moments = np.broadcast_to(row.parts(10, "I", (1, 3)), 3)
    own = Solid(row.value(8, "Mass", 0.0), np.array(centre), np.diag(moments))
    cylinders = []
    solids = [own]
    for rod in rods:
        shape = _cylinder(rod)
        cylinders.append(shape)
        solids.append(_solid_of_rod(rod, shape))
    found: Table = {"name": row.name("body"), "row": row.number, "position": row.values(2, 5, "X0, Y0, Z0")}
    found |= _combine_solids(row, what, solids)
    if any(angles):
        found["attitude"] = angles
    if cylinders:
        found["cylinders"] = cylinders
    if row.value(11, "Volume", 0.0):
        if not own.mass:  # a massless body has no centre of its own: that of its rods
            centre = found["centre_of_mass"]
        found["spheres"] = [_sphere(row, centre)]
    elif any(row.parts(12, "CdA", BODY_PARTS)):
        row.note(f"CdA of {what} is not represented, because the body has no volume")
    return found


def free_rod(row: Row) -> Table:
    """`[[body]]` of a free rod: its axes are the scene's, its reference point is its end A."""
    shape = _cylinder(row)
    start = shape["from"]
    shape |= {"from": [0.0, 0.0, 0.0], "to": np.subtract(shape["to"], start).tolist()}
    found = {"name": row.name("rod"), "row": row.number, "position": start, "cylinders": [shape]}
    return found | _combine_solids(row, f"rod {row.words[0]}", [_solid_of_rod(row, shape)])


def _cylinder(row: Row) -> Table:
    """A rod as a cylinder of a body."""
    row.need(10, "rod")
    _, shape = rod_values(row)
    ends = {"from": row.values(3, 6, "Xa to Zb"), "to": row.values(6, 9, "Xa to Zb")}
    return {**ends, **shape, "slices": max(row.integer(9, "NumSegs", 0), 1)}


def _solid_of_rod(row: Row, shape: Table) -> Solid:
    """Mass and inertia of a rod, a solid cylinder."""
    start = np.array(shape["from"])
    end = np.array(shape["to"])
    length = float(np.linalg.norm(end - start))
    if not length > 0.0:
        row.refuse(f"rod {row.words[0]}: has no length; allowed: two ends")
    along = (end - start) / length
    mass = rod_values(row)[0] * length
    # moments of a solid cylinder about its axis, and across it
    axial = mass * shape["diameter"] ** 2 / 8.0
    transverse = mass * (shape["diameter"] ** 2 / 16.0 + length**2 / 12.0)
    inertia = transverse * np.eye(3) + (axial - transverse) * np.outer(along, along)
    return Solid(mass, 0.5 * (start + end), inertia)


def _combine_solids(row: Row, what: str, parts: list[Solid]) -> Table:
    """Mass, centre of mass and inertia about it of several parts."""
    mass = sum(part.mass for part in parts)
    if not mass > 0.0:
        row.refuse(f"{what}: has no mass, with what is on it; allowed: > 0 kg")
    centre = np.sum([part.mass * part.centre for part in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        offset = part.centre - centre
        inertia += part.inertia + part.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    values = np.diag(inertia)
    products = inertia[[0, 0, 1], [1, 2, 2]]
    if np.max(np.abs(products)) > ROUNDING * np.max(values):
        values = np.concatenate([values, products])
    return {"mass": mass, "centre_of_mass": centre.tolist(), "inertia": values.tolist()}


def _sphere(row: Row, centre: list[float]) -> Table:
    """A body's own volume, with the mean of its drag areas and added masses."""
    area, turning_area = _directions(row.parts(12, "CdA", BODY_PARTS))
    added, turning_added = [0.0], [0.0]
    if len(row.words) > 13:
        added, turning_added = _directions(row.parts(13, "Ca", BODY_PARTS))
    of = f"body {row.words[0]}"
    if len({*area}) > 1 or len({*added}) > 1 or any(turning_area) or any(turning_added):
        row.note(f"the means of CdA and Ca of {of} are used; rotational values are ignored")
    row.note(f"the volume of {of} is a sphere about its centre of mass, which can leave the water; MoorDyn's stays wet")
    diameter = (6.0 * row.value(11, "Volume") / math.pi) ** (1.0 / 3.0)
    cd = float(np.mean(area)) / (0.25 * math.pi * diameter**2)
    return {"centre": centre, "diameter": diameter, "cd": cd, "ca": float(np.mean(added))}


def _directions(parts: list[float]) -> tuple[list[float], list[float]]:
    """Values of a body for its translations, and those for its rotations, from one of `BODY_PARTS` numbers."""
    if len(parts) == 2:
        return parts[:1], parts[1:]
    return parts[:3], parts[3:]
