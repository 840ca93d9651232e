"""Error bars of loads: errors of the tensions of a run due to its step, its links, and chance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import record
from dropper_jax.load.scene import Scene
from dropper_jax.run.chaos import time_of_divergence
from dropper_jax.run.companion import error_factor, finer_values
from dropper_jax.run.samples import Samples
from dropper_jax.study.line_loads import QUANTITIES, LineLoads, has_loads, line_loads
from dropper_jax.study.twice_the_links import twice_the_links

#: Loads that depend on few instants and converge irregularly: their error is the whole difference of two runs.
EXTREMES = ("maximum", "minimum", "snaps")
#: Factor on an estimated error so that the true one rarely exceeds it (Roache, J. Fluids Eng. 116 (1994) 405).
GRID_SAFETY = 1.25
#: Relative error of the maximum tension of a line above which it is not resolved.
UNRESOLVED_ERROR = 0.05


def load_errors(
    scene: Scene,
    run: Callable[[Scene], Samples],
    skip: float,
    first: Samples,
    progress: Progress,
) -> Table:
    """Loads of a run with an estimate of their error.

    The scene is also run finer (half the step, or a quarter of the accuracy), with twice the links at the same EA and
    BA and, if present, with twice the internal damping and twice the stiffness of the seabed. All runs take about six
    times as long as a single one. With q a load, g the gain of the finer run as in `run.companion`,

        step:  1.25 |q - q_finer| g/(g - 1), for extremes and counts 1.25 |q - q_finer|,
        links: 1.25 (2 |q - q'|),    q' with twice the links.

    Errors of links are taken as of first order, to which masses at nodes, contact and slack reduce them. The total is
    the sum of both. The factor 1.25 (Roache 1994) turns the estimate into a limit. `chance` is the standard error by
    batch means (for maxima from the spread of the window maxima). It estimates the change in another storm of the same
    length and is not an error of this one. Once the two runs are different motions (`chaotic`, from `horizon_s` on),
    differences of single runs are random, and the error of the step is the whole difference for all loads.

    Args:
        run: simulates a scene, here its variants.
        skip: time left out at the start [s].
        first: the run of the scene itself.

    Returns:
        `loads`: rows by line {line, at_m, and by quantity {value, step, links, chance, error, twice_damping,
        twice_bed}}; `chaotic`, `horizon_s`; `not_resolved`: lines whose maximum tension has an error above 5 %;
        `left_out`: variants that were not run, and the reason.

    Raises:
        SceneError: a failed run, or a record that is too short.
    """
    variants, left_out = _variants(scene)
    _require_loads(first, "of the scene")
    loads = {"base": line_loads(record(first, skip))}
    horizon = None
    for i, (name, variant) in enumerate(variants.items(), start=1):
        progress(i / (1 + len(variants)), name)
        solution = run(variant)
        if name == "finer":
            _require_loads(solution, "with half the step or a quarter of the accuracy")
            horizon = time_of_divergence(first, solution)
        elif not has_loads(solution):
            left_out[name] = f"that run ends with {solution.failure}"
            continue
        loads[name] = line_loads(record(solution, skip), loads["base"])
    chaotic = horizon is not None
    factor = 1.0
    if horizon is None:
        factor = error_factor(first, finer=True)
        horizon = scene.run.duration
    rows = []
    not_resolved = []
    for i in range(len(loads["base"])):
        row = _row({name: of_run[i] for name, of_run in loads.items()}, factor)
        rows.append(row)
        if row["maximum"]["error"] > UNRESOLVED_ERROR * abs(row["maximum"]["value"]):
            not_resolved.append(row["line"])
    return {
        "loads": rows,
        "chaotic": chaotic,
        "horizon_s": horizon,
        "not_resolved": not_resolved,
        "left_out": left_out,
    }


def _require_loads(solution: Samples, which: str) -> None:
    if not has_loads(solution):
        raise SceneError(f"--errors: the run {which} ends with {solution.failure}")


def _variants(scene: Scene) -> tuple[dict[str, Scene], dict[str, str]]:
    """The scenes of the further runs by name, and those left out with the reason."""
    left_out = {}
    found = {"finer": scene.with_values(finer_values(scene.run))}
    try:
        found["links"] = twice_the_links(scene)
    except SceneError as error:
        left_out["links"] = str(error)
    damped = {}
    for i, line in enumerate(scene.lines):
        if line.axial_damping is not None:
            damped[f"line.{i}.axial.damping"] = 2.0 * line.axial_damping
    if damped:
        found["twice_damping"] = scene.with_values(damped)
    if "seabed" in scene.effects:
        stiffness = 2.0 * float(scene.effects["seabed"]["stiffness"])
        found["twice_bed"] = scene.with_values({"effects.seabed.stiffness": stiffness})
    return found, left_out


def _row(loads: dict[str, LineLoads], factor: float) -> Table:
    """Loads of a line with their errors, from those of the run (`base`) and of its variants."""
    base = loads["base"]
    row: Table = {"line": base.line, "at_m": base.at_m}
    for name in QUANTITIES:
        value, chance = base.loads[name]
        change = {key: of_run.values[name] - value for key, of_run in loads.items()}
        step = GRID_SAFETY * abs(change["finer"])
        if name not in EXTREMES:
            step = factor * step
        links = None
        if "links" in change:
            links = GRID_SAFETY * 2.0 * abs(change["links"])
        if np.isnan(chance):
            chance = None
        row[name] = {"value": value, "step": step, "links": links, "chance": chance, "error": step + (links or 0.0)}
        for key in ("twice_damping", "twice_bed"):
            if key in change:
                row[name][key] = change[key]
    return row
