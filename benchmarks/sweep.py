"""How fast a sweep is: the 7-link lab dropper with rattle in float64, saving included, on all cores of this machine.

    python benchmarks/sweep.py [--cases 1000] [--duration 50] [--out benchmarks/results/sweep.json]
    python benchmarks/sweep.py --cases 65536 --out benchmarks/results/sweep_gpu.json   (with a GPU)

Prints steps per second, the gain over a Python loop over single compiled runs, and memory against the number of cases.
"""

import os
import resource
import tempfile
from functools import partial

import jax
import numpy as np
from study import RESULTS, Found, command, describe, say, store, timed, versions

import dropper_jax as dj
from fitting.cli.sweep import use_cores
from fitting.sweep import sweep

DT = 0.0065


def scene(duration: float) -> dj.Scene:
    """The lab dropper of scenario A."""
    return dj.load_scene("dropper-release-a").with_values(
        {"run.integrator": "rattle", "run.dt": DT, "run.duration": duration}
    )


def measure(cases: int, duration: float, folder: str) -> Found:
    """One sweep over a damping coefficient."""
    values = {"b_l": np.linspace(0.001, 0.004, cases)}
    found, times = timed(partial(sweep, scene(duration), values, f"{folder}/{cases}.zarr"))
    return {
        "cases": cases,
        "steps_per_case": found.steps,
        "compile_s": found.compile_s,
        "run_s": found.run_s,
        "cpu_s": times["processor_s"],
        "million_steps_per_s": found.steps_per_s / 1e6,
        "ok": found.counts["ok"],
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def loop(runs: int, duration: float) -> float:
    """Million steps per second of a Python loop over single compiled runs."""
    model, start = dj.build(scene(duration))
    stepper = dj.make_stepper(model, "rattle", track_work=False)
    steps = round(duration / DT)
    one = jax.jit(lambda m, s: dj.integrate(stepper, m, s, DT, steps)[1].tension.max())
    spent = [timed(lambda: one(model, start).block_until_ready())[1]["seconds"] for _ in range(runs + 1)]
    return steps / np.mean(spent[1:]) / 1e6  # the first one compiles


@command(cases=1000, duration=50.0, out=RESULTS / "sweep.json")
def main(args) -> None:
    use_cores(None)
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(cases, args.duration, folder) for cases in (max(args.cases // 4, 1), args.cases)]
    single = loop(5, args.duration)
    found = {
        "machine": describe(),
        "device": jax.devices()[0].device_kind,
        "load": os.getloadavg()[0],
        "versions": versions("jax"),
        "rows": rows,
        "single_runs_million_steps_per_s": single,
        "times_faster_than_single_runs": rows[-1]["million_steps_per_s"] / single,
    }
    say(found)
    store(args.out, found)
