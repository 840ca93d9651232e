"""Rigid bodies and upright buoys as MoorDyn's rod types, bodies and rods."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.errors import Check, raises_first
from dropper_jax.decks.reading.spars import SEGMENTS, UPRIGHT_INERTIA
from dropper_jax.load.scene import Scene
from dropper_jax.scene import BodySpec


def body_numbers(scene: Scene) -> dict[str, int]:
    """Number of each `[[body]]` among MoorDyn's bodies, by name; those of the buoys come first."""
    return {body.name: i for i, body in enumerate(scene.bodies, start=len(scene.buoys) + 1)}


@raises_first
def check_bodies(scene: Scene) -> Iterator[Check]:
    """Reject bodies whose forces a file would lack.

    Raises:
        SceneError: products of inertia, several rotations, spheres other than one about the centre of mass.
    """
    for i, body in enumerate(scene.bodies):
        yield (
            int(np.count_nonzero(body.attitude)) > 1,
            f"body.{i}.attitude: {body.attitude.tolist()} is about several axes; MoorDyn's codes differ in their "
            "order; allowed: about one of x, y and z",
        )
        yield (
            len(body.spheres) > 1 or any(not np.allclose(s.centre, body.centre_of_mass) for s in body.spheres),
            f"body.{i}.spheres: MoorDyn's bodies have one volume, at their centre of mass; allowed: one sphere there",
        )
        yield (
            bool(np.any(body.inertia[3:])),
            f"body.{i}.inertia: {body.inertia.tolist()}: MoorDyn's bodies have no products of inertia. Use axes in "
            "which they are 0",
        )


def rule(words: str) -> str:
    """The line that starts a section."""
    return f"{'-' * 22} {words} {'-' * 40}"


def section(title: str, head: str, units: str, rows: list[str]) -> list[str]:
    """A section of a table; empty without rows."""
    if rows:
        return [rule(title), head, units, *rows]
    return []


def body_tables(scene: Scene) -> list[str]:
    """The sections of rod types, bodies and rods; those of buoys first."""
    types = []
    bodies = []
    rods = []
    for i, b in enumerate(scene.buoys, start=1):
        types.append(words_of(f"buoy{i}", b.diameter, 0.0, b.cdn, b.can, b.cdt, b.cat))
        base = scene.point(b.point).position  # in MoorDyn lines end at the base
        bodies.append(
            words_of(i, "Free", *base, "0 0 0", b.mass, "0", 100 * UPRIGHT_INERTIA, "0 0 0", f" ! name: {b.point}")
        )
        rods.append(words_of(i, f"buoy{i}", f"Body{i}", "0 0 0 0 0", b.height, SEGMENTS, "-", f" ! name: {b.name}"))
    for number, body in enumerate(scene.bodies, start=len(bodies) + 1):
        bodies.append(_body(number, body))
        for c in body.cylinders:
            key = f"rod{len(rods) + 1}"
            types.append(words_of(key, c.diameter, 0.0, c.cdn, c.can, c.cdt, c.cat))
            rods.append(words_of(len(rods) + 1, key, f"Body{number}", *c.start, *c.end, c.slices, "-"))
    return [
        *section("ROD TYPES", "TypeName Diam Mass/m Cd Ca CdEnd CaEnd", "(name) (m) (kg/m) (-) (-) (-) (-)", types),
        *section(
            "BODIES",
            "ID Attachment X0 Y0 Z0 r0 p0 y0 Mass CG I Volume CdA Ca",
            "(#) (word) (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)",
            bodies,
        ),
        *section(
            "RODS",
            "ID RodType Attachment Xa Ya Za Xb Yb Zb NumSegs RodOutputs",
            "(#) (name) (word/ID) (m) (m) (m) (m) (m) (m) (-) (-)",
            rods,
        ),
    ]


def _body(number: int, body: BodySpec) -> str:
    """A body with its mass, including that of its cylinders, which are written as massless rods."""
    centre = "|".join(map(repr, body.centre_of_mass.tolist()))
    moments = "|".join(map(repr, body.inertia[:3].tolist()))
    sphere = (0.0, 0.0, 0.0)
    for s in body.spheres:
        sphere = (np.pi * s.diameter**3 / 6.0, s.cd * np.pi * s.diameter**2 / 4.0, s.ca)
    kind = "Pinned" if body.pinned else "Free"
    pose = (*body.position, *np.degrees(body.attitude))
    return words_of(number, kind, *pose, body.mass, centre, moments, *sphere, f" ! name: {body.name}")


def words_of(*values: str | int | float) -> str:
    """The words of a row, with every digit of its numbers."""
    words = []
    for value in values:
        if isinstance(value, float):
            value = float(value)  # NumPy's numbers are written as numbers
        words.append(str(value))
    return " ".join(words)
