"""One run of a load case, from its scene to the stored arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import column
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build_model, initial_state, stepper_of
from dropper_jax.modelling.growth import overgrown
from dropper_jax.run.chunks import OWN, compile_run, first_carry
from dropper_jax.run.observation import breaks
from dropper_jax.scene import RunSpec
from dropper_jax.statics.static_pose import equilibrium
from fitting.farm.cases.run_arrays import LoadStatistics, QuantityValues, RunArrays
from fitting.farm.site import Case, Site, Storm

#: How a run ended, stored as the index.
STATUS = ("ok", "not_converged", "non_finite", "invalid_input")


class FarmAtRest(NamedTuple):
    """The farm at rest: the state at the start of runs, and positions of all nodes in still water (nodes, 3) [m]."""

    start: State
    positions: np.ndarray


class CaseRunner:
    """Runs of one site; shared results of cases are computed once.

    Cases share one compiled program, and each run is separate. Side by side, a step of such a system costs more
    (dropper-farm-2 in a storm: 2.7 ms instead of 1.2 to 2.2): all runs wait for the one that needs most corrections.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self.base = site.prepared()
        self._scenes: dict[tuple[object, ...], Scene] = {}
        self._rests: dict[tuple[object, ...], FarmAtRest] = {}

    def __call__(self, case: Case) -> RunArrays:
        """Arrays of a run: those of `LoadStatistics`, `quantity:NAME` of the site's quantities, `status`, `retried`,
        `failed_at` [s], `message`, `broken` (time [s] of the state's break), `rest` (n,) [N] and `depth` (lines, 2)
        [m], the minimum and maximum depth below the level, both at rest."""
        try:
            return self._run(case)
        except SceneError as error:
            return {"status": np.array(STATUS.index("invalid_input")), "message": np.array(str(error))}

    def scene(self, case: Case) -> Scene:
        """The scene of a case, with the mussels in masses and diameters."""
        key = case.storm.still
        if key not in self._scenes:
            self._scenes[key] = overgrown(self.base.with_values(self.site.still_changes(case.storm)))
        return self._scenes[key].with_values(self.site.moving_changes(case))

    def _run(self, case: Case) -> RunArrays:
        """The run of a case up to its end or its first step that fails."""
        scene = self.scene(case)
        model = build_model(scene)
        start, positions = self._rest(scene, model, case.storm)
        skip = self.site.run_of(case.storm).skip
        loads = LoadStatistics(scene, skip, positions, self.site.curve_lines)
        quantities = QuantityValues(self.site.quantities, model, start, scene.run)
        end, found = _advance(model, start, scene.run, skip, loads, quantities)
        broken = []
        if case.storm.broken is not None:
            entry = case.storm.broken.entry
            parted = jax.tree.map(lambda a: a[entry : entry + 1], end.parted)
            broken = column(breaks(scene, parted), "time_s")
        below = case.storm.level - np.asarray(model.nodes(start.r, model.ends(start.t)))[:, 2]
        depth = [(below[line.nodes].min(), below[line.nodes].max()) for line in loads.lines]
        found |= {"rest": np.asarray(start.tension), "depth": np.array(depth), "broken": np.array(broken)}
        return {**loads.collect(), **found, **quantities.collect()}

    def _rest(self, scene: Scene, model: Model, storm: Storm) -> FarmAtRest:
        """The farm at rest in the water of a load case."""
        key = storm.still
        if key not in self._rests:
            start = initial_state(model, scene.start)
            positions = model.nodes(start.r, model.ends(start.t))
            if self.site.exclusion is not None and model.sea.current is not None:
                still = equilibrium(replace(model, sea=replace(model.sea, current=None)))
                if still.status != "ok":
                    raise SceneError(f"exclusion: no equilibrium in still water: {still.message}")
                positions = still.positions
            self._rests[key] = FarmAtRest(start, np.asarray(positions))
        return self._rests[key]


def _advance(
    model: Model, start: State, spec: RunSpec, skip: float, loads: LoadStatistics, quantities: QuantityValues
) -> tuple[State, RunArrays]:
    """Run chunk by chunk into `loads` and `quantities`; the last state, and how the run ended."""
    stepper = stepper_of(model, spec, track_work=False)
    run = compile_run(stepper, model, first_carry(stepper, model, start, spec), spec, watch=quantities.watch)
    carry = run.carry
    done = 0
    found = {"status": np.array(0)}
    retried = 0
    while done < spec.rows:
        carry, rows = run.advance(carry, spec.rows - done, OWN)
        t = (done + 1 + np.arange(len(rows.r))) * spec.interval
        solved = np.asarray(rows.first_bad) < 0
        good = int(np.sum(solved))
        largest = rows.tension
        if quantities.watch is not None and rows.extremes is not None:
            largest = rows.extremes.largest[:, : rows.tension.shape[1]]
        samples = (t, _nodes(model, rows.r, t), rows.tension, largest)
        loads.add(*(np.asarray(values)[:good] for values in samples))
        quantities.add(t, rows, solved & (t > skip))
        done += len(t)
        retried += int(np.sum(rows.retried[:good]))
        if good < len(t):
            code = "not_converged" if np.isfinite(rows.residual[good]) else "non_finite"
            found = {"status": np.array(STATUS.index(code)), "failed_at": np.array(t[good])}
            break
    return carry.state, {**found, "retried": np.array(retried)}


@jax.jit
def _nodes(model: Model, r: np.ndarray, t: np.ndarray) -> Array:
    """All nodes (k, nodes, 3) [m], line by line, from saved free nodes."""
    return jax.vmap(lambda free, time: model.nodes(free, model.ends(time)))(r, jnp.asarray(t, model.dtype))
