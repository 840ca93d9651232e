"""Cost of each effect of a scene per step, and the proof that absent effects have no cost."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.read import Table
from dropper_jax.base.records import column, names_of, select_keys
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.model import Effect, Kinematics, Model, State, state
from dropper_jax.modelling.build import build, build_model, stepper_of
from dropper_jax.plots import figures, style
from dropper_jax.residual import Linear, Solver, Stepper, StepProblem, Unknowns
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import Progress, begin
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.curves import save_titled

#: Timed runs of each model.
ROUNDS = 7
FULL = "whole scene"
BARE = "bare scene"


@component
class Unused(Effect):
    """An effect that no scene uses; it represents any effect added to the package later."""

    name = "unused_effect_of_the_proof"
    strength: Array = parameter("strength", unit="N", low=0.0)

    def force(self, k: Kinematics) -> Array:
        return self.strength * jnp.cosh(k.r)


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


def without_effects(model: Model, names: list[str]) -> Model:
    """The model without these effects, and without those that need one of them."""
    left_out = set(names)
    kept = [effect for effect in model.effects if left_out.isdisjoint((effect.name, *effect.needs))]
    return replace(model, effects=tuple(kept))


class Variant:
    """One compiled run of a model."""

    def __init__(self, name: str, model: Model, stepper: Stepper, s: State, dt: float, steps: int) -> None:
        self.name = name
        self.model = model
        self.stepper = stepper
        # laws and work differ between the variants, so the start is created again from positions and velocities
        self.start = _fresh(stepper, model, s)
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


class CountingSolver:
    """A linear solver that counts its corrections."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.name = solver.name
        self.count = 0

    def linearise(self, problem: StepProblem, u: Unknowns) -> CountedMatrix:
        """The solver's matrix."""
        return CountedMatrix(self.solver.linearise(problem, u), self._add)

    def _add(self) -> None:
        self.count += 1


class CountedMatrix(NamedTuple):
    """A factored matrix that reports each use to the host."""

    matrix: Linear
    report: Callable[[], None]

    def apply(self, rows: Unknowns) -> Unknowns:
        """The solver's correction."""
        jax.debug.callback(self.report)
        return self.matrix.apply(rows)


def _fresh(stepper: Stepper, model: Model, s: State) -> Progress:
    """The start of a run of the model, from the positions, velocities and tensions of a state."""
    return begin(stepper, model, state(model, s.r, s.v, s.tension))


def proof(scene: Scene) -> Table:
    """Compare compiled programs as identical text.

    `removed_is_never_had`: a scene without its optional effects gives the same program as one that never had them.
    `new_effect_changes_nothing`: one more effect class in the registry of the package does not change the program of
    the scene.
    """
    base = program(scene)
    EFFECTS[Unused.name] = Unused
    try:
        again = program(Scene.from_dict(scene.to_dict()))
    finally:
        del EFFECTS[Unused.name]
    table = scene.to_dict()
    run = scene.run
    kept = select_keys(table["effects"], ("weight",))
    model, s = build(scene)

    def text_of(smaller: Model) -> str:
        return _text(make_stepper(smaller, run.integrator, "auto", **run.options), smaller, s, run.step)

    removed = text_of(without_effects(model, [name for name in scene.effects if name not in kept]))
    never_had = text_of(build_model(Scene.from_dict({**table, "effects": kept})))
    return {
        "removed_is_never_had": removed == never_had,
        "new_effect_changes_nothing": base == again,
        "program_lines": base.count("\n"),
        "contains_cosh": "cosh" in base,
    }


def program(scene: Scene) -> str:
    """The text of the program of one step of a scene before compilation."""
    model, s = build(scene)
    return _text(stepper_of(model, scene.run), model, s, scene.run.step)


def _text(stepper: Stepper, model: Model, s: State, dt: float) -> str:
    """The text of the program of one step."""
    start = _fresh(stepper, model, s)
    return jax.jit(partial(advance, stepper, saves=1)).lower(model, start, jnp.asarray(dt, model.dtype)).as_text()


@style.plot_style()
def draw_costs(report: Table, path: str | Path) -> Path:
    """Microseconds, operations and bytes per step of the scene without each of its effects, one bar each."""
    rows = report["rows"]
    figure = figures.new_figure(11.0, 1.6 + 0.42 * len(rows))
    names = column(rows, "name")
    colours = [style.FIRST, *[style.FAINT] * len(rows)][: len(rows)]  # the whole scene comes first
    parts = (("us_per_step", "microseconds per step"), ("flops", "operations per step"), ("bytes", "bytes per step"))
    for axes, (key, label) in zip(figure.subplots(1, 3, sharey=True), parts, strict=True):
        values = [row[key] or 0.0 for row in rows]
        axes.bar_label(axes.barh(names, values, color=colours), [f"{v:.4g}" for v in values], fontsize=8, padding=2)
        axes.set_xlim(0, 1.25 * max([*values, 1e-9]))
        axes.set_xlabel(label)
        if key == "us_per_step":
            axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
    return save_titled(
        figure, f"{report['scene']}: what each effect costs ({report['integrator']}, {report['solver']})", path
    )
