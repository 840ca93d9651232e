"""The effects that a scene can list. A new effect is one file and one line here, or `register` from outside."""

import dataclasses
import sys
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from dropper_jax.base.errors import SceneError
from dropper_jax.base.registry import Registry
from dropper_jax.model import Effect, Law

#: Class of each effect, in the module of the effect's name, in the order in which a model lists them.
CLASSES = {
    "weight": "Weight",
    "linear_damping": "LinearDamping",
    "quadratic_damping": "QuadraticDamping",
    "joint_friction": "JointFriction",
    "nodal_force": "NodalForce",
    "end_motion": "EndMotion",
    "recorded_motion": "RecordedMotion",
    "buoyancy": "Buoyancy",
    "morison_drag": "MorisonDrag",
    "morison_inertia": "MorisonInertia",
    "thesis_wave_force": "ThesisWaveForce",
    "sea_following_end": "SeaFollowingEnd",
    "seabed": "Seabed",
    "seabed_friction": "SeabedFriction",
    "bending": "Bending",
    "clamp_motion": "ClampMotion",
    "line_contact": "LineContact",
    "torsion": "Torsion",
}
#: Effects by their name in a scene, each imported when it is first looked up.
EFFECTS: Registry[type[Effect]] = Registry({name: f"{__name__}.{name}:{cls}" for name, cls in CLASSES.items()})


def __getattr__(name: str) -> type[Effect]:
    for effect, cls in CLASSES.items():
        if cls == name:
            return EFFECTS[effect]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


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


#: Files whose effects are registered, for worker processes.
REGISTERED_FILES: list[str] = []


def register_file(file: str) -> None:
    """Register the effects of a Python file: its components that are effects with a `name`.

    Raises:
        SceneError: the file cannot be read or run, or has no effect.
    """
    path = Path(file)
    if path.suffix != ".py" or not path.is_file():
        raise SceneError(f"--effects: {file!r} is not a Python file; allowed: an existing FILE.py with effects")
    before = EFFECTS.data.copy()
    try:
        module = _run_file(path)
        own = [cls for cls in vars(module).values() if isinstance(cls, type) and cls.__module__ == module.__name__]
        effects = [cls for cls in own if issubclass(cls, Effect) and hasattr(cls, "name")]
        for cls in effects:
            register(cls)
    except Exception as error:  # a foreign file may raise any error
        EFFECTS.data = before
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise SceneError(f"--effects: {file!r} cannot be used: {what}") from error
    if not effects:
        raise SceneError(
            f"--effects: {file!r} has no effect; needed: a class of dropper_jax.Effect with `name` and @component"
        )
    if str(path.resolve()) not in REGISTERED_FILES:
        REGISTERED_FILES.append(str(path.resolve()))


def _run_file(path: Path) -> ModuleType:
    """The module of a file, which may import modules next to it."""
    name = f"dropper_effects_{path.stem}"
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    sys.path.insert(0, str(path.resolve().parent))
    try:
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), vars(module))
    finally:
        sys.path.remove(str(path.resolve().parent))
    return module


__all__ = ["EFFECTS", "REGISTERED_FILES", "Effect", "Law", "register", "register_file", "register_installed"]
