"""What rigid bodies and the rest of a scene must agree on."""

from __future__ import annotations

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import refuse
from dropper_jax.load.checks_system import check_names
from dropper_jax.scene import BodySpec, PointSpec, SceneData, VesselSpec


def attached_points(
    bodies: tuple[BodySpec, ...], vessels: tuple[VesselSpec, ...], points: tuple[PointSpec, ...]
) -> tuple[PointSpec, ...]:
    """The bodies' and vessels' attachments as points, where they are at the start.

    Raises:
        SceneError: a name that is used twice.
    """
    check_names("body", bodies)
    check_names("vessel", vessels)
    taken, found = {point.name for point in points}, []
    carriers = [(f"body.{i}", "free", body) for i, body in enumerate(bodies)]
    carriers += [(f"vessel.{i}", "fixed", vessel) for i, vessel in enumerate(vessels)]
    for path, kind, body in carriers:
        for name, position in body.attachments.items():
            if name in taken:
                raise refuse(f"{path}.attachments", name, "is used twice", "names of their own among points")
            taken.add(name)
            found.append(PointSpec(name=name, position=body.world(position), kind=kind, on=body.name))
    return tuple(found)


def check_bodies(scene: SceneData) -> None:
    """Bodies hang on lines that stretch; what has a shape has water."""
    if not scene.bodies:
        return
    for i, line in enumerate(scene.lines):
        if line.rigid:
            raise SceneError(
                f"line.{i}.axial.law: 'rigid' in a scene with bodies; allowed: lines that stretch, such as 'rope'"
            )
    for i, body in enumerate(scene.bodies):
        if body.shapes and scene.sea is None:
            raise SceneError(
                f"body.{i}: {body.name!r} has cylinders or spheres, but the scene has no [sea]; allowed: [sea] with "
                "`depth`, or no shapes"
            )
        if body.touches_bed and ("seabed" not in scene.effects or not body.shapes):
            what = "[effects.seabed]" if body.shapes else "cylinders or spheres"
            raise SceneError(f"body.{i}.touches_bed: {body.name!r} lacks {what}; allowed: with both, or false")


def body_warnings(scene: SceneData) -> tuple[str, ...]:
    """One line for each body with attachments away from its shapes: the arms of a platform, or a mistake."""
    found = []
    for body in scene.bodies:
        away = body.outside()
        if away:
            name = max(away, key=away.get)
            found.append(
                f"body {body.name!r}: {len(away)} attachments are outside its cylinders and spheres, {name!r} by "
                f"{away[name]:.3g} m; they move with it as if held by arms without mass"
            )
    return tuple(found)


def check_vessels(scene: SceneData) -> None:
    """A vessel in waves has waves that rise from rest, within its table."""
    for i, vessel in enumerate(scene.vessels):
        if vessel.rao is not None and (scene.sea is None or scene.sea.waves is None or scene.sea.ramp is None):
            raise SceneError(
                f"vessel.{i}.rao: needs waves that rise from rest; allowed: [sea.waves] and `sea.ramp`, or `motion`"
            )
