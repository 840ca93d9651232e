"""A differentiable simulator of mussel droppers: chains of links, hanging, looped, damped, driven.

Scene -> model -> effects -> residual -> step -> solution. Importing the package turns on float64 in JAX (set
`JAX_ENABLE_X64` before to decide otherwise); a scene may still choose float32.
"""

import os

import jax

if "JAX_ENABLE_X64" not in os.environ:
    jax.config.update("jax_enable_x64", True)

from dropper_jax.errors import SceneError, SimulationError  # noqa: E402
from dropper_jax.integrate import Trajectory, integrate  # noqa: E402
from dropper_jax.integrators import INTEGRATORS, make_stepper  # noqa: E402
from dropper_jax.model import Line, Model, Point, State, state  # noqa: E402
from dropper_jax.scene import Scene, load_scene, scene_names  # noqa: E402
from dropper_jax.simulate import build, equilibrium, simulate  # noqa: E402
from dropper_jax.solution import Solution  # noqa: E402
from dropper_jax.start import from_angles, initial_state  # noqa: E402
from dropper_jax.statics import settle  # noqa: E402
from dropper_jax.stepping import Stepper, step  # noqa: E402

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
