"""Cost of each effect of a scene per step: measured times, and counts of the compiled programs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build, stepper_of
from dropper_jax.residual import Stepper
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.absent_effects import initial_progress, proof, without_effects
from dropper_jax.study.counting_solver import CountingSolver

#: Timed runs of each model.
ROUNDS = 7
FULL = "whole scene"
BARE = "bare scene"


def cost(
    scene: Scene,
    steps: int = 2000,
    each: Callable[[Table], None] = lambda row: None,
) -> Table:
    """Flops and bytes of the compiled step, and measured time per step, with all effects, without each, and bare.

    Times are medians of interleaved runs in one process; `ratio` is relative to the complete scene. Runs without an
    effect have another motion and may need another number of Newton corrections, so `correction_ratio` compares the
    time per correction. The compiler counts the body of a loop once (corrections included), so the counts compare
    variants and are not totals.

    Args:
        each: gets each row as soon as it is compiled, with the time of its first run and without corrections.

    Returns:
        scene, integrator, solver, rows of {name, effects, flops, bytes, us_per_step, ratio, corrections_per_step,
        us_per_correction, correction_ratio, operations}, proof. Explicit schemes have no corrections: None. After an
        interruption (Ctrl-C) the rows so far, without corrections and proof, with the `status` "interrupted".
    """
    model, s = build(scene)
    run = scene.run
    first = stepper_of(model, run)
    found: Table = {"scene": scene.name, "integrator": first.integrator.name, "solver": first.solver_name}
    variants: list[Variant] = []
    proven = None
    ending = {}
    try:
        for name, shrunk in model_variants(model):
            stepper = make_stepper(shrunk, run.integrator, _solver(run, shrunk), **run.options)
            variant = Variant(name, shrunk, stepper, s, run.step, steps)
            variant.time()
            variants.append(variant)
            each(variant.row(variants[0]))
        for variant in variants:
            variant.times.clear()  # the first run is a warm-up
        for _ in range(ROUNDS):
            for variant in variants:
                variant.time()
        for variant in variants:
            variant.count_corrections()
        proven = proof(scene)
    except KeyboardInterrupt:
        ending = {"status": "interrupted"}
    rows = [variant.row(variants[0]) for variant in variants if variant.times]
    return found | {"rows": rows, "proof": proven} | ending


def _solver(run: RunSpec, model: Model) -> str:
    """The solver of the scene; a smaller model may need another one, selected by `auto`."""
    try:
        stepper_of(model, run)
    except SceneError:
        return "auto"
    return run.solver


def model_variants(model: Model) -> list[tuple[str, Model]]:
    """The whole model, the models without one effect each, and the one without any, with their names."""
    # bodies without their constraints would be four masses
    names = [e.name for e in model.effects if e not in model.constraints]
    removed = {FULL: [], **{f"without {name}": [name] for name in names}, BARE: names}
    return [(name, without_effects(model, own)) for name, own in removed.items()]


class Variant:
    """One compiled run of a model."""

    def __init__(self, name: str, model: Model, stepper: Stepper, s: State, dt: float, steps: int) -> None:
        self.name = name
        self.model = model
        self.stepper = stepper
        # laws and work differ between the variants, so the start is created again from positions and velocities
        self.start = initial_progress(stepper, model, s)
        self.dt = jnp.asarray(dt, model.dtype)
        self.steps = steps
        run = jax.jit(partial(advance, stepper, saves=1, save_every=steps))
        self.compiled = run.lower(model, self.start, self.dt).compile()
        self.counts = self.compiled.cost_analysis() or {}  # of one step: the body of a loop counts once
        self.program = self.compiled.as_text() or ""
        #: Wall times [s] of its runs, and Newton corrections per step, once they are counted.
        self.times: list[float] = []
        self.corrections: float | None = None

    def time(self) -> None:
        """Run once, and keep the wall time."""
        started = time.perf_counter()
        jax.block_until_ready(self.compiled(self.model, self.start, self.dt))
        self.times.append(time.perf_counter() - started)

    @property
    def us_per_step(self) -> float:
        """Median wall time per step [us]."""
        return 1e6 * statistics.median(self.times) / self.steps

    def count_corrections(self) -> None:
        """Newton corrections per step of the timed run, retries included; none for an explicit scheme.

        Counted in a separate run, by solvers that call the host: the timed program is that of users.
        """
        if self.stepper.solver is None:
            return
        counting = CountingSolver(self.stepper.solver)
        run = jax.jit(partial(advance, replace(self.stepper, solver=counting), saves=1, save_every=self.steps))
        jax.block_until_ready(run(self.model, self.start, self.dt))
        jax.effects_barrier()
        self.corrections = counting.count / self.steps - 1.0  # a first correction of zero evaluates the guess

    @property
    def us_per_correction(self) -> float | None:
        """Wall time per Newton correction [us]; None before they are counted, and without any."""
        return self.us_per_step / self.corrections if self.corrections else None

    def row(self, full: Variant) -> Table:
        """Its numbers, with ratios to the full scene."""
        per_correction = self.us_per_correction
        correction_ratio = None
        if per_correction and full.us_per_correction:
            correction_ratio = per_correction / full.us_per_correction
        return {
            "name": self.name,
            "effects": names_of(self.model.effects),
            "flops": self.counts.get("flops"),
            "bytes": self.counts.get("bytes accessed"),
            "us_per_step": self.us_per_step,
            "ratio": self.us_per_step / full.us_per_step,
            "corrections_per_step": self.corrections,
            "us_per_correction": per_correction,
            "correction_ratio": correction_ratio,
            "operations": self.program.count(" = "),
        }
