"""Slopes of five quantities of one storm of `edulis-longline` against fresh runs, with eight seeds of phases.

    python benchmarks/storm_slopes.py --out benchmarks/results/storm_slopes.json

Each seed has the waves of the scene with other phases. For each quantity the slopes that `sensitivity` states are
compared with the difference of two runs at 0.5 %, which take the same steps.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from slopes import fresh_values, run_all_of

from dropper_jax.base.json_values import jsonable
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.quantities.quantity_names import quantity
from fitting.sensitivity import study
from fitting.sensitivity.differences import changed_values, slopes_of_runs
from fitting.sensitivity.study_runs import StudyRuns

SCENE = "edulis-longline"
DURATION = 20.0
RAMP = 5.0
SEEDS = 8
PARAMETERS = ("sea.current.speed",)
#: Quantities; the last, a maximum, is that of the study.
QUANTITIES = tuple(f"tension.west-leg.{name}" for name in ("mean", "std", "sustained", "mpm", "max"))


def storm(seed: int) -> Scene:
    """The scene with phases of a seed."""
    table = load_scene(SCENE).to_dict()
    waves = table["sea"]["waves"]
    waves["phase"] = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(waves["period"])).tolist()
    table["sea"]["ramp"] = RAMP
    table["run"] = {**table["run"], "duration": DURATION, "save_interval": 0.1}
    return load_scene(table)


def measure_seed(seed: int) -> list[dict[str, Any]]:
    """A row for each quantity: value, slopes with errors and status, and those of fresh runs, as p/Q dQ/dp."""
    problem = study(storm(seed), QUANTITIES[-1], PARAMETERS)
    base = StudyRuns(problem)
    quantities = [quantity(name, problem.model) for name in QUANTITIES]
    pairs = fresh_values(problem)
    rows = [*changed_values(problem), *(row for pair in pairs for row in pair)]
    runs, values = zip(*(run_all_of(base, quantities, row) for row in (problem.values, *rows)), strict=True)
    values = np.array(values)
    reach = np.array([(high - low).max() for low, high in pairs])
    found = []
    for k, of in enumerate(quantities):
        base.problem = replace(problem, of=of)
        base.value = float(values[0, k])
        own = [run._replace(value=float(x)) for run, x in zip(runs[1:], values[1:, k], strict=True)]
        count = len(own) - 2 * len(pairs)
        slopes = slopes_of_runs(base, own[:count])
        fresh = np.array([run.value for run in own[count:]])
        share = problem.values / slopes.value
        row = {"seed": seed, "of": of.name, "value": slopes.value, "status": slopes.slope_status}
        row |= {"slope": slopes.forward * share, "error": slopes.error * share}
        row["fresh"] = (fresh[1::2] - fresh[::2]) / reach * share
        found.append(row)
    return found


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each parameter and quantity over the seeds: mean and deviation of the stated slopes and of fresh ones, how
    many are known, and how many of all agree within two errors."""
    found = []
    for i, parameter in enumerate(PARAMETERS):
        for name in QUANTITIES:
            own = [row for row in rows if row["of"] == name]
            slope, error, fresh = (np.array([row[key][i] for row in own]) for key in ("slope", "error", "fresh"))
            known = np.array([row["status"][i] == "known" for row in own])
            within = np.abs(slope - fresh) <= 2.0 * np.abs(error)
            one = {"parameter": parameter, "of": name, "seeds": len(own)}
            one |= {"slope": np.nanmean(slope), "deviation": np.nanstd(slope), "fresh": np.mean(fresh)}
            one |= {"difference": np.nanmedian(np.abs(slope - fresh)), "error": np.median(error)}
            found.append(one | {"known": known.sum(), "within": within.sum(), "known_within": (known & within).sum()})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    rows = []
    for seed in range(SEEDS):
        rows += measure_seed(seed)
        found = jsonable({"summary": summary(rows), "rows": rows})
        args.out.write_text(json.dumps(found, indent=1))
        print(json.dumps(found["summary"]), flush=True)


if __name__ == "__main__":
    main()
