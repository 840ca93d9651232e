"""Consistency of rigid bodies with the rest of a scene."""

from __future__ import annotations

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import refuse
from dropper_jax.load.checks_system import check_names
from dropper_jax.scene import BodySpec, PointSpec, SceneData, VesselSpec


def attached_points(
    bodies: tuple[BodySpec, ...], vessels: tuple[VesselSpec, ...], points: tuple[PointSpec, ...]
) -> tuple[PointSpec, ...]:
    """The bodies' and vessels' attachments as points, at their positions at the start.

    Raises:
        SceneError: a name is used twice.
    """
    check_names("body", bodies)
    check_names("vessel", vessels)
    taken, found = {point.name for point in points}, []
    carriers = [(f"body.{i}", "free", body) for i, body in enumerate(bodies)]
    carriers += [(f"vessel.{i}", "fixed", vessel) for i, vessel in enumerate(vessels)]
    for path, kind, body in carriers:
        for name, position in body.attachments.items():
            if name in taken:
                raise refuse(f"{path}.attachments", name, "is used twice", "unique names among points")
            taken.add(name)
            found.append(PointSpec(name=name, position=body.world(position), kind=kind, on=body.name))
    return tuple(found)


def check_bodies(scene: SceneData) -> None:
    """Check that bodies hang on lines that stretch, and that bodies with shapes are in water."""
    if not scene.bodies:
        return
    for i, line in enumerate(scene.lines):
        if line.rigid:
            raise SceneError(
                f"line.{i}.axial.law: 'rigid' in a scene with bodies. Use lines that stretch, such as 'rope'"
            )
    for i, body in enumerate(scene.bodies):
        if body.shapes and scene.sea is None:
            raise SceneError(
                f"body.{i}: {body.name!r} has cylinders or spheres, but the scene has no [sea]; needed: [sea] with "
                "`depth`, or no shapes"
            )
        if body.touches_bed and ("seabed" not in scene.effects or not body.shapes):
            what = "[effects.seabed]" if body.shapes else "cylinders or spheres"
            raise SceneError(
                f"body.{i}.touches_bed: {body.name!r} lacks {what}; allowed: false, or a body and scene with both"
            )


def body_warnings(scene: SceneData) -> tuple[str, ...]:
    """A warning for each body with attachments away from its shapes: they may be arms of a platform, or a mistake."""
    found = []
    for body in scene.bodies:
        away = body.outside()
        if away:
            name = max(away, key=away.get)
            found.append(
                f"body {body.name!r}: {len(away)} attachments are outside its cylinders and spheres, {name!r} by "
                f"{away[name]:.3g} m; they move with it as if on massless arms"
            )
    return tuple(found)


def check_vessels(scene: SceneData) -> None:
    """Check that a vessel with RAOs has waves that rise from rest, within its table."""
    for i, vessel in enumerate(scene.vessels):
        if vessel.rao is not None and (scene.sea is None or scene.sea.waves is None or scene.sea.ramp is None):
            raise SceneError(
                f"vessel.{i}.rao: needs waves that rise from rest; needed: [sea.waves] and `sea.ramp`, or `motion`"
            )
