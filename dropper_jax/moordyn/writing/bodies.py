"""Rigid bodies and upright buoys as MoorDyn's rod types, bodies and rods."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.reading.spar import SEGMENTS, UPRIGHT
from dropper_jax.scene import BodySpec


def body_numbers(scene: Scene) -> dict[str, int]:
    """Number of each `[[body]]` among MoorDyn's bodies, by name; those of the buoys come first."""
    return {body.name: len(scene.buoys) + i + 1 for i, body in enumerate(scene.bodies)}


def check_bodies(scene: Scene) -> None:
    """Reject bodies whose forces a file would lack.

    Raises:
        SceneError: products of inertia, several rotations, spheres other than one about the centre of mass.
    """
    for i, body in enumerate(scene.bodies):
        if np.count_nonzero(body.attitude) > 1:
            why = "is about several axes; MoorDyn's codes differ in their order; allowed: about one of x, y and z"
            raise SceneError(f"body.{i}.attitude: {body.attitude.tolist()} {why}")
        if len(body.spheres) > 1 or any(not np.allclose(s.centre, body.centre_of_mass) for s in body.spheres):
            why = "MoorDyn's bodies have one volume, at their centre of mass; allowed: one sphere there"
            raise SceneError(f"body.{i}.spheres: {why}")
        if np.any(body.inertia[3:]):
            why = "MoorDyn's bodies have no products of inertia. Use axes in which they are 0"
            raise SceneError(f"body.{i}.inertia: {body.inertia.tolist()}: {why}")


def body_tables(scene: Scene) -> Iterator[tuple[str, list[str]]]:
    """Title and rows of the sections of rod types, bodies and rods; those of buoys first."""
    types, bodies, rods = [], [], []
    for i, b in enumerate(scene.buoys):
        types.append(_row(f"buoy{i + 1}", b.diameter, 0.0, b.cdn, b.can, b.cdt, b.cat))
        base = scene.point(b.point).position  # in MoorDyn lines end at the base
        whole = _row(i + 1, "Free", *base, "0 0 0", b.mass, "0", 100 * UPRIGHT, "0 0 0")
        bodies.append(f"{whole}  ! name: {b.point}")
        rod = _row(i + 1, f"buoy{i + 1}", f"Body{i + 1}", "0 0 0 0 0", b.height, SEGMENTS, "-")
        rods.append(f"{rod}  ! name: {b.name}")
    for name, number in body_numbers(scene).items():
        body = next(body for body in scene.bodies if body.name == name)
        bodies.append(_body(number, body))
        for c in body.cylinders:
            key = f"rod{len(rods) + 1}"
            types.append(_row(key, c.diameter, 0.0, c.cdn, c.can, c.cdt, c.cat))
            rods.append(_row(len(rods) + 1, key, f"Body{number}", *c.start, *c.end, c.slices, "-"))
    if types:
        head = ["TypeName Diam Mass/m Cd Ca CdEnd CaEnd", "(name) (m) (kg/m) (-) (-) (-) (-)"]
        yield "ROD TYPES", [*head, *types]
    if bodies:
        head = ["ID Attachment X0 Y0 Z0 r0 p0 y0 Mass CG I Volume CdA Ca"]
        head.append("(#) (word) (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)")
        yield "BODIES", [*head, *bodies]
    if rods:
        head = ["ID RodType Attachment Xa Ya Za Xb Yb Zb NumSegs RodOutputs"]
        head.append("(#) (name) (word/ID) (m) (m) (m) (m) (m) (m) (-) (-)")
        yield "RODS", [*head, *rods]


def _body(number: int, body: BodySpec) -> str:
    """A body with its mass, including that of its cylinders, which are written as massless rods."""
    centre, moments = ("|".join(repr(float(x)) for x in values[:3]) for values in (body.centre_of_mass, body.inertia))
    volume, area, added = 0.0, 0.0, 0.0
    for s in body.spheres:
        volume, area, added = np.pi * s.diameter**3 / 6.0, s.cd * np.pi * s.diameter**2 / 4.0, s.ca
    kind = "Pinned" if body.pinned else "Free"
    turned = np.degrees(body.attitude)
    row = _row(number, kind, *body.position, *turned, body.mass, centre, moments, volume, area, added)
    return f"{row}  ! name: {body.name}"


def _row(*values: str | int | float) -> str:
    return " ".join(repr(float(x)) if isinstance(x, float) else str(x) for x in values)
