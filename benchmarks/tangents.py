"""Derivatives through slack ropes with the law `SlackTangent` against differences of runs, on scenes it never saw.

    python benchmarks/tangents.py --seeds 1 2 --out benchmarks/results/tangents.json

Each kind of scene draws its sizes, sea and ropes from the seed. The derivatives of a mean tension by five numbers are
those of `dj.integrate` with an accuracy and `stepper.tangent`, over 60 s. Differences are as in `dropper sensitivity`:
runs of the same steps at 1 % of a number (0.6 % of a length), with an error from 0.3 % (0.2 %). s and tau of the law
were chosen on other scenes.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import dropper_jax as dj
from dropper_jax.axial import SlackTangent
from dropper_jax.base.json_values import jsonable
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import stepper_of
from dropper_jax.study.gradient_check import RELATIVE_CHANGE, GradientCheck
from fitting.parameters.forward_derivatives import WithSlopes, floats_of
from fitting.parameters.parameter import with_parameter_values
from fitting.sensitivity import study
from fitting.sensitivity.differences import changed_values, slopes_of_runs
from fitting.sensitivity.problem import Study, measure_rows
from fitting.sensitivity.study_runs import StudyRuns
from fitting.sensitivity.tangents import differentiate_start

Table = dict[str, Any]
#: Duration [s], and time over which the sea rises.
DURATION = 60.0
RAMP = 6.0
#: Numbers that scale the scene: stiffness, drag, lengths, current, wave height.
NAMES = ("EA", "drag", "length", "current", "hs")
#: Capacity for steps over their number in the study's own run.
SPARE = 1.2
#: Differences up to which a derivative counts as right, and as wrong from the second on.
RIGHT = 0.03
NEAR = 0.1


def rope(name: str, ends: tuple[str, str], length: float, links: int, kind: str) -> Table:
    return {
        "name": name,
        "from": ends[0],
        "to": ends[1],
        "type": kind,
        "length": f"= {length!r} * length",
        "links": links,
    }


def rope_type(name: str, mass: float, diameter: float, stiffness: float, drag: float = 1.2) -> Table:
    """A kind of rope: mass [kg/m], diameter [m], EA [N]."""
    return {
        "name": name,
        "mass": mass,
        "diameter": diameter,
        "EA": f"= {stiffness!r} * EA",
        "damping_ratio": 0.1,
        "cdn": f"= {drag!r} * drag",
        "cdt": "= 0.1 * drag",
        "can": 1.0,
        "cat": 0.1,
    }


def scene_of(
    rng: np.random.Generator,
    depth: float,
    hs: float,
    points: list[Table],
    lines: list[Table],
    types: list[Table],
    more: Table | None = None,
) -> Scene:
    """A scene in random waves and a current."""
    tp = float(rng.uniform(4.5, 7.5))
    heading = float(rng.uniform(0.0, 0.8))
    waves = {"kind": "spectrum", "spectrum": "jonswap", "hs": f"= {hs!r} * hs", "tp": tp, "count": 40}
    waves |= {"direction": heading, "seed": int(rng.integers(1, 1000))}
    speed = float(rng.uniform(0.2, 0.7))
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}}
    return load_scene(
        {
            "parameters": dict.fromkeys(NAMES, 1.0),
            "run": {"accuracy": 0.01, "save_interval": 0.1, "duration": DURATION},
            "line_type": types,
            "point": points,
            "line": lines,
            "sea": {
                "depth": depth,
                "ramp": RAMP,
                "waves": waves,
                "current": {"kind": "power", "speed": f"= {speed!r} * current", "direction": heading + 0.5},
            },
            "effects": effects | (more or {}),
        }
    )


def small_farm(rng: np.random.Generator) -> tuple[Scene, str]:
    """A backbone between two floats on legs, with two droppers."""
    depth = float(rng.uniform(12.0, 18.0))
    span = float(rng.uniform(20.0, 26.0))
    reach = 1.6 * depth
    leg = float(rng.uniform(1.03, 1.06)) * float(np.hypot(reach, depth))
    points = [
        {"name": "west", "position": [-reach, 0.0, -depth]},
        {"name": "east", "position": [span + reach, 0.0, -depth]},
        {"name": "buoy-0", "float": 0.25, "position": [0.0, 0.0, -0.3]},
        {"name": "buoy-1", "float": 0.25, "position": [span, 0.0, -0.3]},
    ]
    ends = [{"name": f"end-{k}", "kind": "free", "mass": 2.0, "position": [span * k / 3, 0.0, -5.0]} for k in (1, 2)]
    backbone = rope("backbone", ("buoy-0", "buoy-1"), span, 9, "rope")
    backbone["attach"] = [{"point": f"top-{k}", "at": f"= {span * k / 3!r} * length"} for k in (1, 2)]
    lines = [rope("west-leg", ("west", "buoy-0"), leg, 6, "rope"), rope("east-leg", ("east", "buoy-1"), leg, 6, "rope")]
    lines += [backbone, *(rope(f"dropper-{k}", (f"top-{k}", f"end-{k}"), 4.0, 3, "sock") for k in (1, 2))]
    types = [rope_type("rope", 0.9, 0.03, 8e4), rope_type("sock", 6.0, 0.1, 5e4, 1.5)]
    return scene_of(rng, depth, 1.2, points + ends, lines, types, {"seabed": {}}), "tension.west-leg.mean"


def moored_float(rng: np.random.Generator) -> tuple[Scene, str]:
    """A float on one elastic line, in waves."""
    depth = float(rng.uniform(10.0, 16.0))
    points = [
        {"name": "anchor", "position": [0.0, 0.0, -depth]},
        {"name": "float", "float": float(rng.uniform(0.1, 0.3)), "position": [0.5 * depth, 0.0, -0.2]},
    ]
    line = rope("line", ("anchor", "float"), float(rng.uniform(1.25, 1.45)) * depth, 10, "rope")
    return scene_of(rng, depth, 1.5, points, [line], [rope_type("rope", 1.1, 0.032, 5e4)]), "tension.line.mean"


def snapping_chain(rng: np.random.Generator) -> tuple[Scene, str]:
    """A chain from the seabed to a heavy float that snaps it."""
    depth = float(rng.uniform(14.0, 20.0))
    points = [
        {"name": "anchor", "position": [0.0, 0.0, -depth]},
        {"name": "float", "float": 0.8, "position": [0.8 * depth, 0.0, -0.4]},
    ]
    line = rope("chain", ("anchor", "float"), float(rng.uniform(1.35, 1.5)) * depth, 10, "chain")
    types = [rope_type("chain", float(rng.uniform(8.0, 14.0)), 0.04, 2e6)]
    return scene_of(rng, depth, 2.5, points, [line], types, {"seabed": {}}), "tension.chain.mean"


def looped_dropper(rng: np.random.Generator) -> tuple[Scene, str]:
    """A loop of mussel rope between two fixed points, in a current."""
    apart = float(rng.uniform(0.8, 1.6))
    points = [
        {"name": "first", "position": [0.0, 0.0, -1.5]},
        {"name": "second", "position": [apart, 0.0, -1.5]},
    ]
    line = rope("loop", ("first", "second"), float(rng.uniform(7.0, 9.0)), 14, "sock")
    types = [rope_type("sock", float(rng.uniform(3.0, 7.0)), 0.1, 4e4, 1.4)]
    return scene_of(rng, 14.0, 1.5, points, [line], types), "tension.loop.mean"


def two_lines(rng: np.random.Generator) -> tuple[Scene, str]:
    """A float on two chains that lie on the seabed."""
    depth = float(rng.uniform(12.0, 16.0))
    reach = float(rng.uniform(1.8, 2.2)) * depth
    points = [
        {"name": "west", "position": [-reach, 0.0, -depth]},
        {"name": "east", "position": [reach, 0.0, -depth]},
        {"name": "float", "float": 0.6, "position": [0.0, 0.0, -0.4]},
    ]
    length = float(rng.uniform(1.03, 1.06)) * float(np.hypot(reach, depth))
    lines = [rope(name, (name, "float"), length, 10, "chain") for name in ("west", "east")]
    for line, name in zip(lines, ("west-line", "east-line"), strict=True):
        line["name"] = name
    types = [rope_type("chain", float(rng.uniform(4.0, 8.0)), 0.03, 1e6)]
    return scene_of(rng, depth, 2.0, points, lines, types, {"seabed": {}}), "tension.west-line.mean"


def riser(rng: np.random.Generator) -> tuple[Scene, str]:
    """An elastic line from the seabed to a fixed point at the surface, taut or hardly so."""
    depth = float(rng.uniform(12.0, 20.0))
    points = [
        {"name": "bottom", "position": [0.0, 0.0, -depth]},
        {"name": "top", "position": [float(rng.uniform(0.0, 0.3)) * depth, 0.0, -0.5]},
    ]
    distance = float(np.linalg.norm(np.subtract(points[0]["position"], points[1]["position"])))
    line = rope("riser", ("bottom", "top"), float(rng.uniform(0.998, 1.01)) * distance, 12, "rope")
    types = [rope_type("rope", float(rng.uniform(1.5, 4.0)), 0.05, 1e5)]
    return scene_of(rng, depth, 2.0, points, [line], types), "tension.riser.mean"


KINDS: tuple[Callable[[np.random.Generator], tuple[Scene, str]], ...] = (
    small_farm,
    moored_float,
    snapping_chain,
    looped_dropper,
    two_lines,
    riser,
)


class Derivatives(NamedTuple):
    """Value of the quantity, its derivatives (p,), and growth of each over the run, as a power of e (p,)."""

    value: float
    slopes: np.ndarray
    growth: np.ndarray


def derivatives(problem: Study, base: StudyRuns, tangent: SlackTangent | None) -> Derivatives:
    """Derivatives of the run of a study by its numbers, along the steps of that run.

    They grow by the largest displacement of a node over that at the start, or over the extent of the motion.
    """
    settings = base.settings
    accuracy = settings.accuracy
    stepper = replace(stepper_of(base.model, settings, track_work=False), tangent=tangent)
    # it finds the steps again, and rounding may add some
    most = int(SPARE * np.count_nonzero(base.record.length))
    at = jnp.asarray(problem.values)
    start = differentiate_start(problem.plan, base.model, base.start, at)
    times = settings.interval * (1.0 + np.arange(settings.rows))

    def run(values: jax.Array, floats: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
        model = with_parameter_values(problem.model, problem.parameters, values)
        s = with_floats(start, floats)
        _, rows = dj.integrate(
            stepper, model, s, settings.interval, settings.rows, accuracy=accuracy, most=most, warn=False
        )
        return measure_rows(problem.of, model, s, rows, s.t + times, None), rows.r

    def along(direction: jax.Array, floats: list[jax.Array]) -> tuple[tuple[jax.Array, jax.Array], ...]:
        return jax.jvp(run, (at, floats_of(start.tree)), (direction, floats))

    found = jax.jit(jax.vmap(along, out_axes=(None, 0)))(jnp.eye(len(at)), start.slopes)
    (value, _), (slopes, moved) = jax.tree.map(np.asarray, found)
    scale = np.array([p.scale for p in problem.parameters])
    first = np.linalg.norm(start.slopes[0], axis=-1).max(-1) * scale
    most_moved = np.linalg.norm(moved, axis=-1).max((-1, -2)) * scale
    growth = np.log(np.maximum(most_moved / np.maximum(base.extent, first), 1.0))
    return Derivatives(float(value), slopes, growth)


def with_floats(start: WithSlopes, floats: list[jax.Array]) -> Any:
    """The start with these floats in place of its own."""
    leaves, form = jax.tree.flatten(start.tree)
    new = iter(floats)
    changed = []
    for leaf in leaves:
        is_float = jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)
        changed.append(next(new) if is_float else leaf)
    return form.unflatten(changed)


def check_along(problem: Study, base: StudyRuns, slopes: np.ndarray) -> GradientCheck:
    """Two runs along the gradient, as `dj.check_gradient` takes them, with the steps of the study's own."""
    scale = np.array([p.scale for p in problem.parameters])
    matters = slopes * scale
    step = RELATIVE_CHANGE * scale * matters / np.max(np.abs(matters))
    low, high = base.run_all(np.array([problem.values - step, problem.values + step]))
    return GradientCheck.of(2.0 * float(slopes @ step), high.value - low.value)


def run_case(kind: Callable[[np.random.Generator], tuple[Scene, str]], seed: int) -> Table:
    started = time.process_time()
    scene, of = kind(np.random.default_rng([seed, KINDS.index(kind)]))
    problem = study(scene, of, [f"parameters.{name}" for name in NAMES])
    base = StudyRuns(problem)
    row: Table = {"scene": kind.__name__, "seed": seed, "of": of, "value": base.value}
    if not np.isfinite(base.value):
        return row | {"refused": "a step of the run failed"}
    found = slopes_of_runs(base, base.run_all(changed_values(problem)))
    smooth = derivatives(problem, base, SlackTangent())
    check = check_along(problem, base, smooth.slopes)
    scale = np.array([p.scale for p in problem.parameters]) / base.value
    reference = found.forward * scale
    error = found.error * scale
    slopes = smooth.slopes * scale
    off = np.abs(slopes - reference)
    return row | {
        "slack": float(np.mean(base.rows.tension <= 0.0)),
        "exact_growth": found.growth,
        "motion_growth": found.motion_growth,
        "names": list(NAMES),
        "differences": reference,
        "error": error,
        "status": list(found.slope_status),
        "tangent": slopes,
        "growth": smooth.growth,
        "right": off <= RIGHT * np.abs(reference),
        "near": off <= NEAR * np.abs(reference),
        "within_error": off <= error,
        "along": check.ratio,
        "check": check.status,
        "seconds": time.process_time() - started,
    }


def summary(rows: list[Table]) -> dict[str, float]:
    """Counts over all slopes, and over those that differences know to 3 %."""
    good = [row for row in rows if "tangent" in row]
    counts = {"scenes": len(rows), "slopes": 0, "right": 0, "near": 0}
    counts |= {"known": 0, "known_right": 0, "known_near": 0, "neither": 0, "neither_in_checked": 0}
    for row in good:
        for i in range(len(row["names"])):
            known = row["error"][i] <= RIGHT * abs(row["differences"][i])
            right = bool(row["right"][i])
            near = bool(row["near"][i])
            neither = not near and not bool(row["within_error"][i])
            counts["slopes"] += 1
            counts["right"] += right
            counts["near"] += near
            counts["known"] += known
            counts["known_right"] += known and right
            counts["known_near"] += known and near
            counts["neither"] += neither
            counts["neither_in_checked"] += neither and row["check"] == "not_trusted"
    return counts | {"largest_growth": max(float(np.max(row["growth"])) for row in good)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--kinds", type=int, nargs="*", default=range(len(KINDS)), help="numbers of kinds, from 0")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = []
    for seed in args.seeds:
        for i in args.kinds:
            rows.append(run_case(KINDS[i], seed))
            print(json.dumps(jsonable(rows[-1])), flush=True)
            if args.out is not None:
                args.out.write_text(json.dumps(jsonable({"summary": summary(rows), "rows": rows}), indent=1))
    print(summary(rows))


if __name__ == "__main__":
    main()
