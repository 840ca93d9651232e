"""Slopes of `dropper sensitivity` against fresh runs: do two runs at 0.5 % differ as predicted, within two errors?

    python benchmarks/slopes.py --scenes 0:20 --out benchmarks/results/slopes.json
    python benchmarks/slopes.py --scenes 0:10 --seed 7000 --out benchmarks/results/slopes_unseen.json
    python benchmarks/slopes.py --plateau --out benchmarks/results/slopes_plateau.json
    python benchmarks/slopes.py --draw benchmarks/results/slopes_plateau.json docs/pictures/slopes-plateau.png

Random scenes (`random_scenes.draw_scene`, seeds that nothing was tuned on) and packaged ones, five parameters each.
Fresh runs take the steps of the study's own run, and once more steps of their own, whose error is that of the quantity.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from random_scenes import draw_scene

from dropper_jax.base.errors import SceneError
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.progress import silent
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.plots import figures, style
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.run.chunks import run_chunks
from fitting.sensitivity import LocalDerivatives, local_derivatives, study
from fitting.sensitivity.derivatives import changed_study
from fitting.sensitivity.differences import DIFFERENCE_SIZES
from fitting.sensitivity.problem import Study
from fitting.sensitivity.result import KNOWN, NOT_RESOLVED, OTHER_BRANCH
from fitting.sensitivity.study_runs import Run, StudyRuns, measure_run

#: Number of random scenes.
RANDOM = 16
#: First of the seeds of the random scenes, and their duration [s].
FIRST_SEED = 5000
DURATION = 8.0
#: Relative change of the fresh runs.
CHANGE = 0.005
#: Statistics, in turn.
STATISTICS = ("mean", "std", "sustained", "mpm")
#: Packaged scenes: duration [s], quantity, parameters.
PACKAGED: dict[str, tuple[float, str, tuple[str, ...]]] = {
    "edulis-longline": (
        20.0,
        "tension.west-leg.sustained",
        (
            "line.west-leg.length",
            "sea.current.speed",
            "line_type.chain.cdn",
            "line_type.sock.mass",
            "line_type.chain.EA",
        ),
    ),
    "paper-case-1": (
        15.0,
        "tension.chain.std",
        ("line.chain.length", "line_type.chain.EA", "line_type.chain.cdn", "line_type.chain.mass", "buoy.spar.mass"),
    ),
    "paper-case-4": (
        15.0,
        "tension.chain.mean",
        ("line.chain.length", "line_type.chain.EA", "line_type.chain.cdn", "sea.current.speed", "buoy.spar.mass"),
    ),
    "dropper-release-a": (
        2.0,
        "tension.mean",
        ("b_l", "b_q", "line.0.mass.0", "line.0.mass.3", "line.0.mass.6"),
    ),
}


def random_scene(seed: int) -> tuple[Scene, tuple[str, ...]]:
    """The random scene of a seed, with five numbers in `[parameters]` that scale it, and their paths."""
    table = draw_scene(seed)
    ropes = any("axial" in line for line in table["line"])
    names = ["length", "mass", "drag", "stiffness" if ropes else "diameter", "current"]
    if "current" not in table["sea"]:
        names[-1] = "diameter" if ropes else "tangential"
    table["parameters"] = dict.fromkeys(names, 1.0)
    for line in table["line"]:
        for name in ("length", "mass", "diameter"):
            if name in names:
                line[name] = f"= {line[name]!r} * {name}"
        if "axial" in line:
            line["axial"]["EA"] = f"= {line['axial']['EA']!r} * stiffness"
    drag = table["effects"]["morison_drag"]
    drag["cdn"] = f"= {drag['cdn']!r} * drag"
    if "tangential" in names:
        drag["cdt"] = f"= {drag['cdt']!r} * tangential"
    if "current" in table["sea"]:
        table["sea"]["current"]["speed"] = f"= {table['sea']['current']['speed']!r} * current"
    table["run"] = {"accuracy": 0.01, "save_interval": 0.05, "duration": DURATION}
    return load_scene(table), tuple(f"parameters.{name}" for name in names)


def is_excited(seed: int) -> bool:
    """Whether waves or a moving end excite the random scene of a seed; others stay at rest."""
    table = draw_scene(seed)
    return "packaged" in table["sea"] or "end_motion" in table["effects"]


def cases(first: int, last: int, seed: int) -> list[tuple[str, Scene, str, tuple[str, ...]]]:
    """Name, scene, quantity and parameters of each case: `RANDOM` random scenes from a seed on, then packaged ones."""
    found = []
    while len(found) < RANDOM:
        scene, to = random_scene(seed)
        if is_excited(seed):
            found.append((f"random {seed}", scene, f"tension.l0.{STATISTICS[len(found) % len(STATISTICS)]}", to))
        seed += 1
    for name, (duration, of, to) in PACKAGED.items():
        found.append((name, load_scene(name).with_values({"run.duration": duration}), of, to))
    return found[first:last]


def fresh_values(problem: Study) -> list[tuple[np.ndarray, np.ndarray]]:
    """Values (p,) of the two fresh runs of each parameter."""
    pairs = []
    for i, p in enumerate(problem.parameters):
        low = np.array(problem.values)
        high = np.array(problem.values)
        low[i] = max(low[i] - CHANGE * p.scale, p.low)
        high[i] = min(high[i] + CHANGE * p.scale, p.high)
        pairs.append((low, high))
    return pairs


def run_fresh(problem: Study) -> tuple[list[float], list[float]]:
    """Changes of the quantity between the two fresh runs of each parameter: along the own run's steps, and by steps of
    their own."""
    if not problem.has_elastic_links:
        changes = []
        for low, high in fresh_values(problem):
            changes.append(changed_study(problem, high)[0] - changed_study(problem, low)[0])
        return changes, changes
    runs = StudyRuns(problem)
    found = []
    for record in (runs.record, None):
        runs.record = record
        rows = [row for pair in fresh_values(problem) for row in pair]
        values = [run.value for run in runs.run_all(np.array(rows))]
        found.append([high - low for low, high in zip(values[::2], values[1::2], strict=True)])
    return found[0], found[1]


def judge(problem: Study, found: LocalDerivatives, along: list[float], own: list[float]) -> dict[str, Any]:
    """Counts of a case."""
    reach = np.array([(high - low).max() for low, high in fresh_values(problem)])
    scale = np.array([p.scale for p in problem.parameters])
    predicted = found.forward * reach
    allowed = 2.0 * found.error * reach
    steps = 2.0 * np.sqrt(2.0) * np.nan_to_num(found.value_error)
    rounding = 1e-9 * abs(found.value)
    along = np.array(along)
    own = np.array(own)
    known = np.array([status == KNOWN for status in found.slope_status])
    off = np.abs(along - predicted)
    wrong = (along * predicted < 0.0) & (np.abs(predicted) > allowed) & (off > allowed + rounding)
    return {
        "of": found.of,
        "method": found.method,
        "value": found.value,
        "value_error": found.value_error,
        "grows": found.grows,
        "growth": found.growth,
        "motion_growth": found.motion_growth,
        "names": list(found.names),
        "predicted": predicted.tolist(),
        "error": (found.error * reach).tolist(),
        "along": along.tolist(),
        "own": own.tolist(),
        "status": list(found.slope_status),
        "within": (off <= allowed + rounding).tolist(),
        "within_own": (np.abs(own - predicted) <= allowed + steps + rounding).tolist(),
        "huge": int(np.sum(np.abs(np.nan_to_num(found.forward)) * scale > 100.0 * abs(found.value))),
        "wrong_sign": int(np.sum(wrong)),
        "wrong_sign_known": int(np.sum(wrong & known)),
    }


def run_case(name: str, scene: Scene, of: str, to: tuple[str, ...]) -> dict[str, Any]:
    started = time.perf_counter()
    row: dict[str, Any] = {"scene": name}
    try:
        problem = study(scene, of, to)
        found = local_derivatives(problem)
    except SceneError as error:
        return row | {"refused": str(error)}
    if not found.finite:
        return row | {"refused": "a step of the run failed"}
    row["seconds"] = time.perf_counter() - started
    return row | judge(problem, found, *run_fresh(problem))


def summary(rows: list[dict[str, Any]]) -> dict[str, int]:
    """Counts over all cases; those of slopes are of printed ones."""
    good = [row for row in rows if "within" in row]
    stated = [pair for row in good for pair in zip(row["within"], row["status"], strict=True)]
    stated = [(ok, status) for ok, status in stated if status != NOT_RESOLVED]
    clear = [ok for ok, status in stated if status == KNOWN]
    return {
        "scenes": len(rows),
        "compared": len(good),
        "not_resolved": sum(row["status"].count(NOT_RESOLVED) for row in good),
        "other_branch": sum(row["status"].count(OTHER_BRANCH) for row in good),
        "slopes": len(stated),
        "within_two_errors": sum(ok for ok, _ in stated),
        "known_slopes": len(clear),
        "known_within_two_errors": sum(clear),
        "within_by_own_steps": sum(sum(row["within_own"]) for row in good),
        "huge": sum(row["huge"] for row in good),
        "wrong_sign": sum(row["wrong_sign"] for row in good),
        "wrong_sign_known": sum(row["wrong_sign_known"] for row in good),
    }


#: Scene, parameter, quantities and relative changes of the picture of slopes against the size of the difference. The
#: quantity of the study, a maximum, is the last one.
PLATEAU_SCENE = "paper-case-1"
PLATEAU_DURATION = 20.0
PLATEAU_PARAMETER = "buoy.spar.mass"
PLATEAU_QUANTITIES = ("tension.chain.mean", "tension.chain.sustained", "tension.chain.max")
SIZES = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 6e-2)


def run_all_of(runs: StudyRuns, quantities: list[Quantity], values: np.ndarray) -> tuple[Run, np.ndarray]:
    """The run with these values (p,) and several quantities of it; an extreme has to be that of the study."""
    model = runs.model_at(values)
    s = runs.start_at(values)
    program = runs.program(model, s, runs.record)
    rows = run_chunks(program, runs.settings.rows, silent).trajectory
    t = s.t + runs.settings.interval * (1.0 + np.arange(len(rows.r)))
    found = []
    for one in quantities:
        if one == runs.problem.of:
            found.append(runs.measure(model, s, rows))
        else:
            found.append(float(measure_run(one, model, s, rows, t, None)))
    return runs.compare(model, s, rows), np.array(found)


def measure_plateau() -> dict[str, Any]:
    """Scaled slopes of three quantities by central differences of each size."""
    scene = load_scene(PLATEAU_SCENE).with_values({"run.duration": PLATEAU_DURATION, "run.save_interval": 0.1})
    problem = study(scene, PLATEAU_QUANTITIES[-1], [PLATEAU_PARAMETER])
    runs = StudyRuns(problem)
    quantities = [quantity(name, problem.model) for name in PLATEAU_QUANTITIES]
    here = run_all_of(runs, quantities, problem.values)[1]
    slopes = []
    for size in SIZES:
        low, high = (run_all_of(runs, quantities, problem.values * (1.0 + sign * size))[1] for sign in (-1.0, 1.0))
        slopes.append((high - low) / (2.0 * size) / here)
    return {
        "scene": PLATEAU_SCENE,
        "duration": PLATEAU_DURATION,
        "parameter": PLATEAU_PARAMETER,
        "sizes": SIZES,
        "quantities": PLATEAU_QUANTITIES,
        "values": here.tolist(),
        "slopes": np.transpose(slopes).tolist(),
    }


def draw_plateau(stored: Path, picture: Path) -> None:
    """Slopes against the size of the difference, one panel for each quantity; the band is that of the two sizes."""
    found = json.loads(stored.read_text())
    sizes = found["sizes"]
    both = [sizes.index(size) for size in DIFFERENCE_SIZES]
    with style.plot_style():
        figure = figures.new_figure(9.5, 3.4)
        panels = figure.subplots(1, len(found["quantities"]))
        for axes, name, slopes in zip(panels, found["quantities"], found["slopes"], strict=True):
            stated, other = (slopes[i] for i in both)
            error = abs(stated - other)
            axes.axhspan(stated - error, stated + error, color=style.SECOND, alpha=0.3, lw=0)
            axes.semilogx([100.0 * size for size in sizes], slopes, "o-", color=style.DARK, ms=4)
            axes.set_yscale("symlog", linthresh=max(2.0 * error, 2.0 * abs(stated)))
            axes.set_title(name, loc="left")
            axes.set_xlabel("change of the parameter [%]")
        panels[0].set_ylabel("slope [% per %]")
        figures.save(figure, picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:20", help="FIRST:LAST")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="first seed of the random scenes")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--plateau", action="store_true", help="slopes against the size of the difference")
    parser.add_argument("--draw", nargs=2, type=Path, metavar=("STORED", "PICTURE"))
    args = parser.parse_args()
    if args.draw:
        draw_plateau(*args.draw)
        return
    if args.plateau:
        args.out.write_text(json.dumps(measure_plateau(), indent=1))
        return
    first, last = map(int, args.scenes.split(":"))
    rows = []
    for case in cases(first, last, args.seed):
        rows.append(run_case(*case))
        print(json.dumps(rows[-1]), flush=True)
        if args.out is not None:
            args.out.write_text(json.dumps(jsonable({"summary": summary(rows), "rows": rows}), indent=1))
    print(summary(rows))


if __name__ == "__main__":
    main()
