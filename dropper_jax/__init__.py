"""A differentiable simulator of mussel droppers: chains of links, hanging, looped, damped, driven.

From a scene to the next state:

    scene            load.scene.load_scene             a TOML file or a dict, checked, in SI units
      | modelling.build.build_model, modelling.build.initial_state
    model, state     model.Model, model.State          pytrees: what is constant, and what a step changes
      |
      | stepping.integrate                             a run is a scan of steps
      |   stepping.halving.advance_over                one step, or shorter ones where it does not converge
      |     residual.step.step
      |       integrators/   problem(model, state, h)  the scheme writes the residual R(u) = 0 of the step
      |         effects/, axial/, sea/                 with forces, laws of tension, water
      |       residual.newton.newton                   u <- u - P^-1 R(u)
      |         solvers/     linearise(problem, u)     the matrix P, by jax.jacfwd
      |       residual.step.solution                   du = -(dR/du)^-1 dR/dp dp: its exact derivative
      |       problem.finish(u)
    next state, and the maximum scaled residual; run.build_solution builds the solution of the run

Importing the package turns on float64 in JAX (set `JAX_ENABLE_X64` beforehand to prevent that); a scene may still
choose float32. JAX itself and the names below are imported on first use, so that the command line can reject a typing
error at once.
"""

import os
import sys
from importlib import import_module
from importlib.util import find_spec

#: Where each public name lives; the stub next to this file lists the same for editors.
PUBLIC = {
    "Coupled": "coupling.coupled",
    "Effect": "effects",
    "INTEGRATORS": "integrators",
    "Kinematics": "model.kinematics",
    "Line": "model.line",
    "Model": "model.model",
    "Point": "model.line",
    "Scene": "load.scene",
    "SceneData": "scene.data",
    "SceneError": "base.errors",
    "SimulationError": "base.errors",
    "SlackTangent": "axial.law",
    "Solution": "run.simulate",
    "State": "model.state",
    "Stepper": "residual.step",
    "Trajectory": "stepping.progress",
    "as_toml": "base.toml_text",
    "build": "modelling.build",
    "build_model": "modelling.build",
    "check_gradient": "study.gradient_check",
    "component": "base.fields",
    "coupled_lines": "coupling.coupled_lines",
    "equilibrium": "modelling.build",
    "frequency_response": "frequency.response",
    "from_angles": "modelling.build",
    "initial_state": "modelling.build",
    "integrate": "stepping.integrate",
    "linearised": "modelling.build",
    "load_scene": "load.scene",
    "make_stepper": "stepping.stepper",
    "mooring_stiffness": "statics.stiffness",
    "natural_modes": "statics.modes",
    "natural_periods": "statics.modes",
    "nearest": "base.errors",
    "one_kernel": "backend.one_kernel",
    "option": "base.fields",
    "packaged_scene": "load.packaged",
    "parameter": "base.fields",
    "read_moordyn": "decks.reading.reader",
    "recover": "run.recovery",
    "register": "effects",
    "report_run": "report.build",
    "report_runs": "report.build",
    "safe_norm": "base.numerics",
    "scatter_add": "base.indexed_sums",
    "scene_names": "load.packaged",
    "settle": "statics.static_pose",
    "simulate": "run.simulate",
    "state": "model.state",
    "step": "residual.step",
    "step_lengths": "stepping.integrate",
    "store_programs": "backend.programs",
    "tension_deviation": "frequency.linear_waves",
    "write_moordyn": "decks.writing.writer",
    "with_length_in_time": "effects.length_in_time",
    "write_vtk": "report.vtk",
}

__all__ = sorted(PUBLIC)

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        # JAX reads the variable when it is imported, which the user may do later. Child processes inherit it, so that
        # they compute in float64 too.
        os.environ["JAX_ENABLE_X64"] = "1"


def __getattr__(name: str) -> object:
    if name in PUBLIC:
        value = getattr(import_module(f"{__name__}.{PUBLIC[name]}"), name)
        globals()[name] = value
        return value
    # subpackages such as dropper_jax.plots; names with an underscore are probes by tools (IPython, doctest)
    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
