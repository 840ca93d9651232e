"""The state and the carry from which a run starts: its scene's start, or the end of an earlier run."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.build import initial_state
from dropper_jax.plausibility.plausibility import with_cause
from dropper_jax.plausibility.pose_remarks import check_stretch
from dropper_jax.residual import Stepper
from dropper_jax.run.build_solution import TimeOrigin, run_work_names
from dropper_jax.run.chunks import first_carry
from dropper_jax.run.end_of_run import Last, first_row, restore_carry
from dropper_jax.run.samples import Samples
from dropper_jax.scene import RunSpec
from dropper_jax.statics.equilibrium import node_positions


def stepper_fields(settings: Table) -> Table:
    """Settings of the stepping under the names of the fields of `Stepper`."""
    return {"tolerance" if key == "residual_tolerance" else key: value for key, value in settings.items()}


def initial_carry(stepper: Stepper, model: Model, scene: Scene, before: Samples | None) -> tuple[Last, TimeOrigin]:
    """The initial state of a run, from its scene's start or the end of an earlier run, and the origin of its times."""
    run = scene.run
    if before is None:
        try:
            s = initial_state(model, scene.start)
        except SceneError as error:
            raise with_cause(error, scene) from None
        if scene.start.is_static:
            check_stretch(scene, np.asarray(node_positions(model, s)))
        return _end_at(stepper, model, s, run), TimeOrigin()
    used = before.settings
    origin = TimeOrigin(float(before.t[-1]))
    if (run.interval, run.save_every) == (used["dt"] * used["save_every"], used["save_every"]):
        origin = TimeOrigin(**(before.continues or {}))
        origin = origin._replace(saves=origin.saves + len(before.t) - 1)
    return restore_end(stepper, model, run, before.last), origin


def _end_at(stepper: Stepper, model: Model, s: State, run: RunSpec) -> Last:
    """The row and the carry of a run that starts from a state."""
    row = first_row(s, len(run_work_names(stepper, model, run)))
    return Last(row, first_carry(stepper, model, s, run))


def restore_end(stepper: Stepper, model: Model, run: RunSpec, saved: dict[str, np.ndarray]) -> Last:
    """The end of a run of this kind from its saved leaves."""

    def end_at_origin(model: Model) -> Last:
        """An end with the leaves and shapes of this kind of run; its values do not matter."""
        return _end_at(stepper, model, state(model, jnp.zeros((model.free_nodes, 3), model.dtype)), run)

    return restore_carry(jax.eval_shape(end_at_origin, model), saved)
