"""Calibration of the measured single and double pendulum: error on held-out windows against the published parameters.

The traces are the public data set of Kaheman et al. (arXiv 2205.06231; MIT licence, repository
dynamicslab/MultiArm-Pendulum), thinned to 250 Hz; their folder is named by DROPPER_MEASURED_DATA. The fit sees only
what comes before the held-out windows.

    DROPPER_MEASURED_DATA=FOLDER python benchmarks/measured_pendulums.py [single] [double] [thirds]

`thirds` fits each third of the double pendulum's trace alone, as the command does: do their errors explain how much the
estimates differ?
"""

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from study import command, say, store, stored

from dropper_jax import load_scene
from fitting import FitSettings, fit, prepare, read_trace
from fitting.calibration.comparison import compare_laws
from fitting.calibration.fit import estimate
from fitting.calibration.summarise import summarise

DOWN = FitSettings(zero="down", sign=1, unit="rad")
#: Windows of the law comparison [s]: many enough for a standard error of the score.
LAW_WINDOW = 2.6
LAWS = "laws_on_windows_before_the_held_out_part"


@dataclass(frozen=True)
class Case:
    """One rig: what is free, what is held out [s], the published parameters' errors there [rad]."""

    scene: str
    file: str
    free: tuple[str, ...]
    until: float
    held_out: tuple[tuple[float, float], ...]
    published: tuple[float, ...]
    window: float
    per_joint: bool = False


CASES = {
    "single": Case(
        "measured-single-pendulum",
        "single_pendulum.csv",
        ("line.0.inertia", "viscous", "dry", "b_q", "camera.offset"),
        36.668,
        ((36.668, 45.834), (45.834, 55.0)),
        (0.0067, 0.0129),
        9.16,
    ),
    "double": Case(
        "measured-double-pendulum",
        "double_pendulum.csv",
        ("line.0.inertia", "line.0.centre_of_mass.1", "viscous", "dry", "b_q", "camera.offset"),
        69.342,
        tuple((69.342 + 2.6645 * k, 69.342 + 2.6645 * (k + 1)) for k in range(4)),
        (0.0023, 0.0024, 0.0022, 0.0021),
        2.664,
        per_joint=True,
    ),
}


def scene_of(case: Case):
    """The packaged scene, with friction of its own in each joint where there are two."""
    own = {f"effects.joint_friction.{key}": [1e-4] * 3 for key in ("viscous", "dry") if case.per_joint}
    return load_scene(case.scene).with_values(own)


def run(name: str, case: Case, folder: Path) -> dict:
    """Fit, score, compare laws."""
    trace = read_trace(folder / case.file)
    trace = replace(trace, t=trace.t[::2], theta=trace.theta[::2])
    settings = replace(DOWN, dt=0.004, window=case.window)
    until = case.until
    scene = scene_of(case)
    free = list(case.free)
    prepared = prepare(trace, scene, free, until=until, held_out=case.held_out, settings=settings)
    result = summarise(prepared, "windows", estimate(prepared, "windows"))
    held = [h.rms for h in result.held_out]
    found = {
        "fitted_before_s": case.until,
        "held_out_s": [list(span) for span in case.held_out],
        "published_rad": list(case.published),
        "held_out_rad": held,
        "ratio_of_means": float(np.mean(held) / np.mean(case.published)),
        "fit": {key: value for key, value in result.to_json().items() if key != "correlation"},
    }
    results = f"measured_{name}_pendulum"
    # the laws take longest: the fit is there if they are interrupted
    store(results, {**found, LAWS: stored(results, {LAWS: []})[LAWS]})
    # the laws are compared on windows before the held-out part: choosing one must not use it either
    settings = replace(settings, window=LAW_WINDOW)
    laws = compare_laws(prepare(trace, scene, free, until=until, settings=settings))
    return {**found, LAWS: [law.to_json() for law in laws]}


def thirds(case: Case, folder: Path) -> dict:
    """Estimates and standard errors of each third of a trace."""
    trace = read_trace(folder / case.file)
    edges = np.linspace(trace.t[0], trace.t[-1] + trace.interval, 4)
    parts = [trace.between(low, high) for low, high in zip(edges, edges[1:], strict=False)]
    fits = [fit(part, case.scene, settings=DOWN) for part in parts]
    return {"edges_s": list(edges), "parameters": [found.estimates() for found in fits]}


@command({"rigs": [*CASES, "thirds"]})
def main(args) -> None:
    named = os.environ.get("DROPPER_MEASURED_DATA")
    if not named or not Path(named).is_dir():
        sys.exit("error: DROPPER_MEASURED_DATA names no folder; allowed: the folder with the measured CSV files")
    for name in args.rigs:
        if name == "thirds":
            store("measured_double_thirds", thirds(CASES["double"], Path(named)))
            continue
        found = run(name, CASES[name], Path(named))
        store(f"measured_{name}_pendulum", found)
        say(found)
