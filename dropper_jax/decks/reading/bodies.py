"""Free bodies and rods of MoorDyn as `[[body]]` tables.

A body's mass, centre of mass and inertia about it include those of the rods on it, which become its cylinders. A volume
of the body itself becomes a sphere about the centre of mass. A free rod becomes a separate body.
"""

from __future__ import annotations

import math

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.decks.reading.sections import Deck, Row
from dropper_jax.decks.reading.spars import rod_type


def free_body(deck: Deck, row: Row, rods: list[Row], notes: list[str]) -> Table:
    """`[[body]]` of a free body and the rods on it; its attachments are added with the points."""
    row.need(13, "body")
    where = row.values(2, 5, "X0, Y0, Z0")
    turned = [math.radians(angle) for angle in row.values(5, 8, "r0, p0, y0")]
    if sum(angle != 0.0 for angle in turned) > 1:
        row.refuse(f"body {row.words[0]}: is rotated about several axes; allowed: about one of x, y and z")
    mass = row.value(8, "Mass", 0.0)
    centre = row.parts(9, "CG")
    centre = np.array(centre if len(centre) == 3 else [0.0, 0.0, centre[0]])
    moments = row.parts(10, "I")
    parts = [(mass, centre, np.diag(moments if len(moments) == 3 else moments * 3))]
    pairs = [_cylinder(deck, rod) for rod in rods]
    found = _together(row, f"body {row.words[0]}", [*parts, *(part for _, part in pairs)])
    found |= {"name": row.name or f"body-{row.words[0]}", "position": where}
    if any(turned):
        found["attitude"] = turned
    cylinders = [cylinder for cylinder, _ in pairs]
    spheres = _spheres(row, found["centre_of_mass"] if mass == 0.0 else centre.tolist(), notes)
    return found | {key: shapes for key, shapes in (("cylinders", cylinders), ("spheres", spheres)) if shapes}


def free_rod(deck: Deck, row: Row) -> Table:
    """`[[body]]` of a free rod: its axes are the scene's, its reference point is its end A."""
    cylinder, (mass, centre, inertia) = _cylinder(deck, row)
    start = np.array(cylinder["from"])
    found = _together(row, f"rod {row.words[0]}", [(mass, centre - start, inertia)])
    shape = {**cylinder, "from": [0.0, 0.0, 0.0], "to": (np.array(cylinder["to"]) - start).tolist()}
    return {**found, "name": row.name or f"rod-{row.words[0]}", "position": start.tolist(), "cylinders": [shape]}


def _cylinder(deck: Deck, row: Row) -> tuple[Table, tuple[float, np.ndarray, np.ndarray]]:
    """A rod as a cylinder, and its mass [kg], centre of mass [m] and inertia about it [kg m^2]."""
    row.need(10, "rod")
    kind = rod_type(deck, row)
    diameter, each, cdn, can, cdt, cat = kind.values(1, 7, "rod type", 0.0)
    a = np.array(row.values(3, 6, "Xa to Zb"))
    b = np.array(row.values(6, 9, "Xa to Zb"))
    length = float(np.linalg.norm(b - a))
    if not length > 0.0:
        row.refuse(f"rod {row.words[0]}: has no length; allowed: two ends")
    mass = each * length
    along = (b - a) / length
    own = mass * diameter**2 / 8.0
    across = mass * (diameter**2 / 16.0 + length**2 / 12.0)
    inertia = across * np.eye(3) + (own - across) * np.outer(along, along)
    shape = {"from": a.tolist(), "to": b.tolist(), "diameter": diameter, "cdn": cdn, "can": can, "cdt": cdt, "cat": cat}
    shape["slices"] = max(row.integer(9, "NumSegs", 0), 1)
    return shape, (mass, 0.5 * (a + b), inertia)


def _together(row: Row, what: str, parts: list[tuple[float, np.ndarray, np.ndarray]]) -> Table:
    """Mass, centre of mass and inertia about it of several parts."""
    mass = sum(m for m, _, _ in parts)
    if not mass > 0.0:
        row.refuse(f"{what}: has no mass, with what is on it; allowed: > 0 kg")
    centre = sum(m * c for m, c, _ in parts) / mass
    inertia = np.zeros((3, 3))
    for m, c, own in parts:
        away = c - centre
        inertia += own + m * (away @ away * np.eye(3) - np.outer(away, away))
    xx, yy, zz, xy, xz, yz = (float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    if max(map(abs, (xy, xz, yz))) > 1e-12 * max(xx, yy, zz):
        products = [xy, xz, yz]
    else:
        products = []
    return {"mass": mass, "centre_of_mass": centre.tolist(), "inertia": [xx, yy, zz, *products]}


def _spheres(row: Row, centre: list[float], notes: list[str]) -> list[Table]:
    """A body's own volume, with the mean of its drag areas and added masses."""
    volume = row.value(11, "Volume", 0.0)
    area = row.parts(12, "CdA")
    if len(row.words) > 13:
        added = row.parts(13, "Ca")
    else:
        added = [0.0]
    if not volume:
        if any(area):
            notes.append(
                f"line {row.number}: CdA of body {row.words[0]} is not represented, because the body has no volume"
            )
        return []
    if len({*area[:3]}) > 1 or len({*added[:3]}) > 1 or any(area[3:]) or any(added[3:]):
        notes.append(
            f"line {row.number}: the means of CdA and Ca of body {row.words[0]} are used; rotational values are ignored"
        )
    notes.append(
        f"line {row.number}: the volume of body {row.words[0]} is a sphere about its centre of mass, which can leave "
        "the water; MoorDyn's stays wet"
    )
    diameter = (6.0 * volume / math.pi) ** (1.0 / 3.0)
    cd = float(np.mean(area[:3])) / (0.25 * math.pi * diameter**2)
    return [{"centre": centre, "diameter": diameter, "cd": cd, "ca": float(np.mean(added[:3]))}]
