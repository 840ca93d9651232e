"""A differentiable simulator of mussel droppers: chains of links, hanging, looped, damped, driven.

Scene -> model -> effects -> residual -> step -> solution. Importing the package turns on float64 in JAX (set
`JAX_ENABLE_X64` before to decide otherwise); a scene may still choose float32. JAX itself and the names below are
imported when they are first asked for, so that the command line can refuse a typing error at once.
"""

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what `_HOMES` says, for editors
    from dropper_jax.base.errors import SceneError as SceneError
    from dropper_jax.base.errors import SimulationError as SimulationError
    from dropper_jax.integrators import INTEGRATORS as INTEGRATORS
    from dropper_jax.load.packaged import scene_names as scene_names
    from dropper_jax.load.scene import Scene as Scene
    from dropper_jax.load.source import load_scene as load_scene
    from dropper_jax.model.line import Line as Line
    from dropper_jax.model.line import Point as Point
    from dropper_jax.model.model import Model as Model
    from dropper_jax.model.state import State as State
    from dropper_jax.model.state import state as state
    from dropper_jax.run.build import build as build
    from dropper_jax.run.build import equilibrium as equilibrium
    from dropper_jax.run.simulate import simulate as simulate
    from dropper_jax.run.solution import Solution as Solution
    from dropper_jax.run.start import from_angles as from_angles
    from dropper_jax.run.start import initial_state as initial_state
    from dropper_jax.statics.static_pose import settle as settle
    from dropper_jax.stepping.choose import make_stepper as make_stepper
    from dropper_jax.stepping.integrate import Trajectory as Trajectory
    from dropper_jax.stepping.integrate import integrate as integrate
    from dropper_jax.stepping.step import step as step
    from dropper_jax.stepping.stepper import Stepper as Stepper

#: Modules and the names of theirs that the package offers itself.
_HOMES = {
    "base.errors": ("SceneError", "SimulationError"),
    "integrators": ("INTEGRATORS",),
    "load.packaged": ("scene_names",),
    "load.scene": ("Scene",),
    "load.source": ("load_scene",),
    "model.line": ("Line", "Point"),
    "model.model": ("Model",),
    "model.state": ("State", "state"),
    "run.build": ("build", "equilibrium"),
    "run.simulate": ("simulate",),
    "run.solution": ("Solution",),
    "run.start": ("from_angles", "initial_state"),
    "statics.static_pose": ("settle",),
    "stepping.choose": ("make_stepper",),
    "stepping.integrate": ("Trajectory", "integrate"),
    "stepping.step": ("step",),
    "stepping.stepper": ("Stepper",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        # JAX reads it when somebody imports it, which may be the user. Processes started from this one inherit it and
        # compute in float64 as well, as they would with the package imported.
        os.environ["JAX_ENABLE_X64"] = "1"


def __getattr__(name: str) -> object:
    if name in _HOME_OF:
        found = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
        globals()[name] = found
        return found
    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
