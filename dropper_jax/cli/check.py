"""`dropper check SCENE`: validate a scene and show what a run would compute, without compiling it."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.cli.options import RUN_VALUES, add_run_values, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, deliver, weights_table
from dropper_jax.cli.printing import done_object, listing, print_warnings, record_table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.model import Model

help = "check a scene in seconds: masses, weights in water, densities, periods, time step, and what a run compiles"

#: Names of the periods in the table.
WORDS = {
    "swing": "swing of the shortest link",
    "axial": "axial vibration of the stiffest link",
    "waves": "waves",
}


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "check my-longline.toml", "check paper-case-1 --set sea.waves.amplitude=2 --json")
    add_run_values(parser, RUN_VALUES)
    add_out(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args, RUN_VALUES, notes=False)

    found = examine(scene)
    print_warnings(found["warnings"])
    return deliver(args, done_object(scene=scene.name, **found), text(scene, args.scene, found))


def examine(scene: Scene) -> Table:
    """Facts of a scene that need neither its equilibrium nor a compiled step."""
    from dropper_jax.load.periods import periods, suggest_step
    from dropper_jax.load.sea_warnings import sea_warnings
    from dropper_jax.modelling.growth import overgrown
    from dropper_jax.modelling.scene_model import bare_model
    from dropper_jax.plausibility.line_weights import line_weights, wet_weights
    from dropper_jax.plausibility.plausibility import scene_warnings
    from dropper_jax.scene import whole_lines

    grown = overgrown(scene)
    # without wakes, which need equilibria
    model = bare_model(grown)
    warnings = [*scene_warnings(scene)]
    if model.sea is not None:
        warnings += sea_warnings(scene, model.sea)
    wet = wet_weights(scene)
    lines = []
    for line in whole_lines(grown):
        own = {"line": line.name, "links": line.spec.links, "length_m": line.spec.total}
        lines.append(own | {"mass_kg": line.spec.mass.sum(), "wet_weight_n": wet[line.links].sum()})
    return {
        "lines": lines,
        "points": _free_points(scene),
        "line_weights": line_weights(scene),
        "periods_s": periods(scene),
        "accuracy": scene.run.accuracy,
        "save_interval_s": scene.run.interval,
        "dt_s": scene.run.step,
        "suggested_dt_s": suggest_step(scene),
        "compiled": _compiled(scene, model),
        "warnings": warnings,
    }


def _free_points(scene: Scene) -> Table:
    """Number, mass [kg] and net lift [N] under water of the free points; no lift without water."""
    points = [point for point in scene.points if point.is_free]
    mass = sum(point.mass or 0.0 for point in points)
    lift = 0.0
    if scene.sea is not None:
        volume = sum(point.volume or 0.0 for point in points)
        lift = scene.sea.gravity * (scene.sea.density * volume - mass)
    return {"free": len(points), "mass_kg": mass, "lift_n": lift}


def _compiled(scene: Scene, model: Model) -> Table:
    """What a run compiles: scheme, solver and sizes; None for the number of steps that follow an accuracy."""
    from dropper_jax.modelling.build import stepper_of

    steps = scene.run.steps if scene.run.accuracy is None else None
    return {
        "integrator": scene.run.integrator,
        "solver": stepper_of(model, scene.run).solver_name,
        "dtype": str(model.dtype),
        "links": model.line.links,
        "free_nodes": model.free_nodes,
        "bodies": len(scene.bodies),
        "effects": list(scene.effects),
        "steps": steps,
    }


def text(scene: Scene, source: str, found: Table) -> str:
    """The facts as text; `source` is the scene as the user named it."""
    weight = "weight [N]" if scene.sea is None else "weight in water [N]"
    columns = {
        "line": "{line}",
        "links": "{links}",
        "length [m]": "{length_m:.5g}",
        "mass [kg]": "{mass_kg:.5g}",
        weight: "{wet_weight_n:.5g}",
    }
    compiled = found["compiled"]
    compiles = "{integrator}, solver {solver}, {dtype}; {links} links, {free_nodes} free nodes, {bodies} rigid bodies"
    points = found["points"]
    pairs = []
    if points["mass_kg"] or points["lift_n"]:
        masses = "{mass_kg:.4g} kg".format(**points)
        of_lines = sum(column(found["lines"], "wet_weight_n"))
        if scene.sea is not None:
            masses += "; their net lift submerged is {lift_n:.4g} N".format(**points)
            masses += f"; lines weigh {of_lines:.4g} N in water"
        pairs.append(("floats, masses", masses))
    for name, value in found["periods_s"].items():
        pairs.append((WORDS[name], f"{value:.3g} s"))
    pairs += [
        ("natural periods", f"dropper modes {source}"),
        ("time steps", _steps(scene, found["suggested_dt_s"])),
        ("a run compiles", compiles.format(**compiled)),
        ("effects", ", ".join(compiled["effects"]) or "none"),
        ("a run", f"goes to {scene.run.duration:g} s, saved every {scene.run.interval:g} s"),
    ]
    lines = record_table(found["lines"], columns)
    return "\n".join([lines, *weights_table(scene), "", listing(pairs), "", "ok: the scene is valid"])


def _steps(scene: Scene, suggested: float) -> str:
    """Number and length of the steps, or their accuracy."""
    run = scene.run
    if run.accuracy is None:
        return f"{run.steps} of {run.step:g} s; {suggested:g} s suggested by periods, --accuracy 0.01 chooses them"
    return f"follow an accuracy of {run.accuracy:g}; equal steps, where a study needs them, of {run.step:g} s"
