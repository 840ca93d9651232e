"""The paper's Table 7 measured again: all five cases from Table 6's poses, and what single conventions change in them.

    python benchmarks/table7.py [--only cases|moordyn|conventions|edulis]

Needs the extra `moordyn`; takes about an hour on one core. Writes results/table7.json beside this file, from which
`python benchmarks/tables.py` makes the tables of docs/moordyn-compared.md.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import argparse
import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe
from moordyn_runs import theirs
from paper_cases import TABLE_7, case
from table7_conventions import CONVENTIONS
from table7_edulis import edulis

import dropper_jax as dj
from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import jsonable
from dropper_jax.moordyn.writing.outputs import channel_values
from dropper_jax.run.solution import Solution

TARGET = Path(__file__).parent / "results" / "table7.json"
NUMBERS = (1, 2, 3, 4, 5)
#: The paper gives no durations; its figures and texts speak of times up to 143.9 s.
SPAN, LONGEST = 150.0, 200.0  # [s]
#: Lengths of the record [s] for which means and extremes are given.
LENGTHS = (50.0, 80.0, 100.0, SPAN, LONGEST)
#: Settled part [s] and batches of the standard error of its mean.
SETTLED, BATCHES = 50.0, 8
#: MoorDyn's step [s] for each internal damping ratio.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}


def loads(values: np.ndarray) -> dict[str, float]:
    """Least, mean and largest [N]."""
    return {"min": float(np.min(values)), "mean": float(np.mean(values)), "max": float(np.max(values))}


def of_run(run: Solution, span: float) -> dict[str, Any]:
    """Loads at both ends up to a time: tension of the end link, and size of the force on the anchor's node."""
    kept, shown = run.t_tension <= span, run.t <= span
    settled = run.tension[kept & (run.t_tension > SETTLED), 0]
    batches = [float(part.mean()) for part in np.array_split(settled, BATCHES)] if settled.size else []
    place = run.positions[shown, -1]
    found = {
        "span_s": span,
        "anchor": loads(run.tension[kept, 0]),
        "anchor_node": loads(channel_values(run, "AnchTen1")[0][kept]),
        "fairlead": loads(run.tension[kept, -1]),
        "place": {"min": place.min(axis=0).tolist(), "max": place.max(axis=0).tolist()},
    }
    if batches:
        found["standard_error"] = float(np.std(batches, ddof=1) / np.sqrt(BATCHES))
    return found


def ours(scene: dj.Scene, spans: tuple[float, ...]) -> dict[str, Any]:
    """A scene here: loads up to each time, or why there are none."""
    try:
        run = dj.simulate(scene.with_values({"run.duration": max(spans)}))
    except SceneError as error:
        return {"status": str(error), "spans": []}
    if run.status not in ("ok", "energy_drift"):
        return {"status": run.status, "spans": []}
    return {"status": run.status, "spans": [of_run(run, span) for span in spans]}


def show(name: str, found: dict[str, Any]) -> None:
    spans = [
        f"{s['anchor']['mean']:.0f} ({s['anchor']['min']:.0f} to {s['anchor']['max']:.0f})" for s in found["spans"]
    ]
    print(f"  {name}: {found['status']}, anchor {', '.join(spans)} N", flush=True)


def in_moordyn(number: int, ratio: float) -> dict[str, Any]:
    """A case in MoorDyn v2: tensions of the end segments with their sign, and as sizes."""
    rows = theirs(case(number, ratio), STEPS[ratio], SPAN, look=0.01, grid=number != 4)
    found = rows.statistics()
    if rows.status == "ok":
        print(f"  case {number}, ratio {ratio:g}: {found['anchor']}", flush=True)
    return {"case": number, "damping_ratio": ratio, "dt_s": STEPS[ratio], **found}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("cases", "moordyn", "conventions", "edulis")
    parser.add_argument("--only", choices=parts, help="measure this part, keep the others")
    parser.add_argument("--missing", action="store_true", help="of the conventions, only rows that are not there yet")
    given = parser.parse_args()
    only = given.only
    found: dict[str, Any] = json.loads(TARGET.read_text()) if only and TARGET.exists() else {}
    versions = {name: metadata.version(name) for name in ("moordyn", "jax", "dropper-jax", "numpy")}
    found |= {"schema": 1, "machine": describe(), "versions": versions, "table_7": TABLE_7, "span_s": SPAN}

    def keep() -> None:
        atomic_write(TARGET, json.dumps(jsonable(found), indent=1) + "\n")

    def wanted(part: str) -> bool:
        return only in (None, part)

    if wanted("cases"):
        found["cases"] = []
        for number in NUMBERS:
            row = {"case": number, **ours(case(number), LENGTHS)}
            show(f"case {number}", row)
            found["cases"].append(row)
            keep()
    if wanted("moordyn"):
        found["moordyn"] = []
        for ratio in STEPS:
            for number in NUMBERS:
                found["moordyn"].append(in_moordyn(number, ratio))
                keep()
    if wanted("conventions"):
        known = found.get("conventions", []) if given.missing else []
        found["conventions"] = known
        for one in CONVENTIONS:
            print(one.name, flush=True)
            there = {row["case"] for row in known if row["convention"] == one.name}
            for number in (n for n in one.cases if n not in there):
                row = {"convention": one.name, "case": number, **ours(one.changed(case(number)), (SPAN,))}
                show(f"case {number}", row)
                found["conventions"].append(row)
                keep()
        order = [one.name for one in CONVENTIONS]
        known.sort(key=lambda row: (order.index(row["convention"]), row["case"]))
        keep()
    if wanted("edulis"):
        found["edulis"] = edulis()
        keep()
    return 0


if __name__ == "__main__":
    sys.exit(main())
