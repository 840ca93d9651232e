"""A differentiable simulator of mussel droppers: chains of links, hanging, looped, damped, driven.

Scene -> model -> effects -> residual -> step -> solution. Importing the package turns on float64 in JAX (set
`JAX_ENABLE_X64` before to decide otherwise); a scene may still choose float32.
"""

import os

import jax

if "JAX_ENABLE_X64" not in os.environ:
    jax.config.update("jax_enable_x64", True)

from dropper_jax.base.errors import SceneError, SimulationError  # noqa: E402
from dropper_jax.integrators import INTEGRATORS  # noqa: E402
from dropper_jax.load.packaged import scene_names  # noqa: E402
from dropper_jax.load.scene import Scene  # noqa: E402
from dropper_jax.load.source import load_scene  # noqa: E402
from dropper_jax.model.line import Line, Point  # noqa: E402
from dropper_jax.model.model import Model  # noqa: E402
from dropper_jax.model.state import State, state  # noqa: E402
from dropper_jax.run.build import build, equilibrium  # noqa: E402
from dropper_jax.run.simulate import simulate  # noqa: E402
from dropper_jax.run.solution import Solution  # noqa: E402
from dropper_jax.run.start import from_angles, initial_state  # noqa: E402
from dropper_jax.statics.static_pose import settle  # noqa: E402
from dropper_jax.stepping.choose import make_stepper  # noqa: E402
from dropper_jax.stepping.integrate import Trajectory, integrate  # noqa: E402
from dropper_jax.stepping.step import step  # noqa: E402
from dropper_jax.stepping.stepper import Stepper  # noqa: E402

__all__ = [
    "INTEGRATORS",
    "Line",
    "Model",
    "Point",
    "Scene",
    "SceneError",
    "SimulationError",
    "Solution",
    "State",
    "Stepper",
    "Trajectory",
    "build",
    "equilibrium",
    "from_angles",
    "initial_state",
    "integrate",
    "load_scene",
    "make_stepper",
    "scene_names",
    "settle",
    "simulate",
    "state",
    "step",
]
