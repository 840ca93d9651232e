"""What a rigid body costs per step, and blocks against a dense matrix where lines on it bend.

The chain of `ballasted-spar` in 20 links, with bending: both solvers alternately in one process,
medians of processor time, compilation aside. Beside it the same chain without the body, its end held.

    python benchmarks/body_speed.py
"""

from __future__ import annotations

import json
import statistics
import time
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import dropper_jax as dj
from dropper_jax.stepping.integrate import advance, begin

RESULTS = Path(__file__).parent / "results" / "body_speed.json"
LINKS, STEPS, ROUNDS = (20,), 40, 7


def scene(links: int, body: bool) -> dj.Scene:
    """The spar on its chain, or the chain alone between two held points."""
    table = dj.load_scene("ballasted-spar").to_dict()
    table["line"][0]["links"] = links
    table["effects"]["bending"] = {"EI": 50.0}
    table["start"] = {"kind": "points"}
    if not body:
        del table["body"]
        table["point"].append({"name": "base", "position": [0.0, 0.0, -8.0]})
        table["line"][0]["nodes"] = "shared"
    return dj.load_scene(table)


def run_of(links: int, body: bool, solver: str) -> Any:
    """A compiled run of `STEPS` steps, as a function without arguments."""
    model, start = dj.build(scene(links, body))
    stepper = dj.make_stepper(model, solver=solver).plain
    first, dt = begin(stepper, model, start), jnp.asarray(0.01)
    program = jax.jit(partial(advance, stepper, saves=1, save_every=STEPS)).lower(model, first, dt).compile()
    return lambda: jax.block_until_ready(program(model, first, dt))


def measure() -> dict[str, Any]:
    kinds = {"network": (True, "network"), "dense": (True, "dense"), "without the body": (False, "auto")}
    rows = []
    for links in LINKS:
        runs = {name: run_of(links, *kind) for name, kind in kinds.items()}
        spent: dict[str, list[float]] = {name: [] for name in runs}
        for run in runs.values():
            run()
        for _ in range(ROUNDS):
            for name, run in runs.items():
                begun = time.process_time()
                run()
                spent[name].append(time.process_time() - begun)
        rows.append({"links": links, **{name: 1e6 * statistics.median(s) / STEPS for name, s in spent.items()}})
    return {"schema": 1, "unit": "us per step", "rows": rows}


if __name__ == "__main__":
    found = measure()
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found, indent=1))
