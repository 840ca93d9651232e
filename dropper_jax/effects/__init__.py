"""The effects that a scene can list. A new effect is one file and one line here, or `register` from outside."""

import dataclasses
from importlib.metadata import entry_points

from dropper_jax.base.errors import SceneError
from dropper_jax.effects.bending import Bending
from dropper_jax.effects.buoyancy import Buoyancy
from dropper_jax.effects.end_motion import EndMotion
from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.effects.line_contact import LineContact
from dropper_jax.effects.linear_damping import LinearDamping
from dropper_jax.effects.morison_drag import MorisonDrag
from dropper_jax.effects.morison_inertia import MorisonInertia
from dropper_jax.effects.nodal_force import NodalForce
from dropper_jax.effects.quadratic_damping import QuadraticDamping
from dropper_jax.effects.recorded_motion import RecordedMotion
from dropper_jax.effects.sea_following_end import SeaFollowingEnd
from dropper_jax.effects.seabed import Seabed
from dropper_jax.effects.seabed_friction import SeabedFriction
from dropper_jax.effects.thesis_wave_force import ThesisWaveForce
from dropper_jax.effects.torsion import Torsion
from dropper_jax.effects.weight import Weight
from dropper_jax.model import Effect, Law

#: Effects by their name in a scene, in the order in which a model lists them.
EFFECTS: dict[str, type[Effect]] = {
    cls.name: cls
    for cls in (
        Weight,
        LinearDamping,
        QuadraticDamping,
        JointFriction,
        NodalForce,
        EndMotion,
        RecordedMotion,
        Buoyancy,
        MorisonDrag,
        MorisonInertia,
        ThesisWaveForce,
        SeaFollowingEnd,
        Seabed,
        SeabedFriction,
        Bending,
        LineContact,
        Torsion,
    )
}


def register(cls: type[Effect]) -> type[Effect]:
    """Register an effect defined outside this package for use in scenes, as a decorator above `component`.

    The same class may be registered again, for example when a notebook cell is run twice.

    Raises:
        ValueError: no `name`, no `component`, or the name of another effect.
    """
    name = getattr(cls, "name", None)
    if not isinstance(name, str):
        raise ValueError(f"{cls.__name__}: has no `name`, the key in [effects.NAME]")
    if not dataclasses.is_dataclass(cls):
        raise ValueError(f"{cls.__name__}: is not a component; put @component under @register")
    known = EFFECTS.get(name)
    if known is not None and (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
        raise ValueError(
            f"{cls.__name__}: the name {name!r} is already used by {known.__module__}.{known.__qualname__}"
        )
    EFFECTS[name] = cls
    return cls


def register_installed() -> None:
    """Register the effects of installed packages: entry points of the group `dropper.effects`.

    Raises:
        SceneError: an entry point cannot be loaded or is not an effect.
    """
    for entry in entry_points(group="dropper.effects"):
        try:
            register(entry.load())
        except Exception as error:  # a foreign module may raise any error on import
            raise SceneError(f"effects.{entry.name}: {entry.value!r} cannot be used: {error}") from error


__all__ = [
    "EFFECTS",
    "Bending",
    "Buoyancy",
    "Effect",
    "EndMotion",
    "JointFriction",
    "Law",
    "LineContact",
    "LinearDamping",
    "MorisonDrag",
    "MorisonInertia",
    "NodalForce",
    "QuadraticDamping",
    "RecordedMotion",
    "SeaFollowingEnd",
    "Seabed",
    "SeabedFriction",
    "ThesisWaveForce",
    "Torsion",
    "Weight",
    "register",
    "register_installed",
]
