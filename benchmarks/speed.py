"""How fast a step is: solvers, sizes, gradients, first call. Ratios within one run, compilation apart, one thread.

    python benchmarks/speed.py [--out benchmarks/results/speed.json]

Each variant takes the fewest Newton iterations that keep the largest scaled residual of the run below the one
tolerance, so that a fast solver is not a sloppy one. Times are medians of interleaved repetitions.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp

import dropper_jax as dj
from dropper_jax.stepping.stepper import TOLERANCE

#: Step [s] and number of steps measured, by number of links of a 17 m, 238 kg dropper.
SIZES = {7: (0.03, 1000), 18: (0.03, 1000), 100: (0.003, 300), 1000: (0.0005, 100)}
REPETITIONS = 7


def dropper(links: int) -> dict[str, Any]:
    """A 17 m, 14 kg/m dropper with its ends 2.5 m apart, linear and quadratic damping."""
    return {
        "run": {"dt": SIZES[links][0], "duration": 1.0},
        "point": [{"name": "left", "position": [0.0, 0.0, 0.0]}, {"name": "right", "position": [2.5, 0.0, 0.0]}],
        "line": [
            {
                "name": "line",
                "from": "left",
                "to": "right",
                "links": links,
                "length": 17.0 / links,
                "mass": 238.0 / links,
            }
        ],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.5}, "quadratic_damping": {"b_q": 5.0}},
    }


def plucked(links: int) -> tuple[dj.Model, dj.State]:
    """The dropper at rest in its plane, thrown out of it with 1 m/s in the middle."""
    model, s = dj.build(dropper(links))
    shape = jnp.sin(jnp.linspace(0.0, jnp.pi, model.free_nodes))
    return model, dj.state(model, s.r, jnp.zeros_like(s.r).at[:, 1].set(shape), s.tension)


class Variant:
    """A compiled run of one integrator and solver on one size."""

    def __init__(self, links: int, integrator: str, solver: str, steps: int | None = None):
        self.links, self.integrator, self.solver = links, integrator, solver
        self.dt, planned = SIZES[links]
        self.steps = steps or planned
        self.model, self.start = plucked(links)
        self.iterations, self.residual, self.run = self._settle()
        self.times: list[float] = []

    def _settle(self) -> tuple[int, float, Any]:
        for iterations in range(2, 33):
            stepper = dj.make_stepper(self.model, self.integrator, self.solver, iterations=iterations, track_work=False)
            bare = dj.make_stepper(
                self.model, self.integrator, self.solver, iterations=iterations, extra=0, halvings=0, track_work=False
            )
            probe = jax.jit(lambda m, s, b=bare: dj.integrate(b, m, s, self.dt, self.steps)[1].residual)
            residual = float(jnp.max(probe(self.model, self.start)))
            if residual <= TOLERANCE["float64"]:
                run = jax.jit(lambda m, s, p=stepper: dj.integrate(p, m, s, self.dt, self.steps)[1].r[-1])
                return iterations, residual, run
        raise RuntimeError(f"{self.integrator} with {self.solver} does not reach the tolerance in 32 iterations")

    def measure(self) -> None:
        begun = time.perf_counter()
        jax.block_until_ready(self.run(self.model, self.start))
        self.times.append(time.perf_counter() - begun)

    @property
    def us_per_step(self) -> float:
        return 1e6 * statistics.median(self.times[1:]) / self.steps

    def row(self) -> dict[str, Any]:
        return {
            "links": self.links,
            "integrator": self.integrator,
            "solver": self.solver,
            "iterations": self.iterations,
            "max_residual": self.residual,
            "us_per_step": self.us_per_step,
            "us_per_link_step": self.us_per_step / self.links,
        }


def interleave(variants: list[Variant]) -> None:
    for _ in range(REPETITIONS + 1):
        for variant in variants:
            variant.measure()


def solver_rows() -> list[dict[str, Any]]:
    """One row per integrator, solver and size, with its speed-up over dense of the same size."""
    rows = []
    for links in SIZES:
        variants = [Variant(links, "energy_momentum", "condensed"), Variant(links, "rattle", "condensed")]
        if links <= 100:
            variants.append(Variant(links, "energy_momentum", "dense", steps=20 if links == 100 else None))
        variants.append(Variant(links, "energy_momentum", "banded", steps=50 if links >= 100 else None))
        interleave(variants)
        found = [variant.row() for variant in variants]
        dense = next((row["us_per_step"] for row in found if row["solver"] == "dense"), None)
        for row in found:
            row["times_faster_than_dense"] = dense / row["us_per_step"] if dense else None
            print(
                f"{links:5d} links  {row['integrator']:16s} {row['solver']:10s} {row['iterations']:2d} iterations  "
                f"{row['us_per_step']:9.2f} us/step  residual {row['max_residual']:.1e}  "
                + (f"{row['times_faster_than_dense']:6.1f} x dense" if dense else ""),
                flush=True,
            )
        rows += found
    return rows


def gradient_ratios() -> dict[str, float]:
    """Value and gradient of a scalar with respect to b_l and b_q over the forward run, lab dropper."""
    model, start = dj.build("dropper-release-a")
    found = {}
    for integrator in ("energy_momentum", "rattle"):
        stepper = dj.make_stepper(model, integrator, track_work=False)

        def value(b: jax.Array, stepper: Any = stepper) -> jax.Array:
            from dataclasses import replace

            weight, linear, quadratic = model.effects
            damped = replace(model, effects=(weight, replace(linear, b_l=b[0]), replace(quadratic, b_q=b[1])))
            return jnp.mean(dj.integrate(stepper, damped, start, 0.005, 400)[1].r[:, 2, 0])

        runs = [jax.jit(value), jax.jit(jax.value_and_grad(value)), jax.jit(jax.jacfwd(value))]
        times: list[list[float]] = [[], [], []]
        b = jnp.array([0.002, 0.001])
        for _ in range(REPETITIONS + 1):
            for run, taken in zip(runs, times, strict=True):
                begun = time.perf_counter()
                jax.block_until_ready(run(b))
                taken.append(time.perf_counter() - begun)
        forward, reverse, tangent = (statistics.median(taken[1:]) for taken in times)
        found[f"{integrator}_value_and_grad_over_forward"] = reverse / forward
        found[f"{integrator}_jacfwd_over_forward"] = tangent / forward
        print(f"{integrator:16s} value and gradient {reverse / forward:.2f}, jacfwd {tangent / forward:.2f} x forward")
    return found


def first_call() -> float:
    """Seconds of a fresh process: import, compilation and 1 s of simulation at the defaults."""
    code = "import dropper_jax as dj; assert dj.simulate('dropper-release-a', duration=1.0).status == 'ok'"
    begun = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "speed.json")
    out = parser.parse_args().out
    result = {
        "versions": {"jax": jax.__version__, "python": sys.version.split()[0]},
        "rows": solver_rows(),
        "gradients": gradient_ratios(),
        "first_call_s": first_call(),
    }
    print(f"first call {result['first_call_s']:.1f} s")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=1) + "\n")
    print(f"written: {out}")


if __name__ == "__main__":
    main()
