"""The names that `dropper_jax` offers itself and where they live: for editors and for the package."""

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
from dropper_jax.stepping.adaptive import followed_steps as followed_steps
from dropper_jax.stepping.choose import make_stepper as make_stepper
from dropper_jax.stepping.controlled import controlled_steps as controlled_steps
from dropper_jax.stepping.controlled import integrate_along as integrate_along
from dropper_jax.stepping.integrate import Trajectory as Trajectory
from dropper_jax.stepping.integrate import integrate as integrate
from dropper_jax.stepping.step import step as step
from dropper_jax.stepping.stepper import Stepper as Stepper
