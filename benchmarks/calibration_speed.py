"""What a calibration costs: cold start, work per iteration, and SciPy's finite differences on the same windows."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from dropper_jax.stepping.integrate import integrate
from fitting.calibration.fit import estimate, summarise
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.windows import Starts
from fitting.traces import planar

#: Windows of the side-by-side comparison; SciPy's cost grows with their square.
FEW = 8


def compare_speed(twin: Any) -> dict:
    """All of it on one twin (see calibration.py)."""
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    begun, cpu = time.perf_counter(), time.process_time()
    prepared = twin.prepare(0)
    solution = estimate(prepared, "shooting")
    cold = {"wall_s": time.perf_counter() - begun, "cpu_s": time.process_time() - cpu}
    result = summarise(prepared, "shooting", solution)
    return {
        "machine": {"cores": cores, "load_before": load},
        "cold_start": {**cold, "compile_s": result.seconds["compile"], "status": result.status},
        "iteration": iteration_cost(prepared, solution.values),
        "finite_differences": against_scipy(prepared),
    }


def iteration_cost(prepared: Any, values: np.ndarray) -> dict:
    """CPU seconds of one evaluation with all derivatives, and of the plain run of the same trace by the same scheme."""
    simulator, windows = prepared.simulator, prepared.windows
    full = best_cpu(lambda: simulator(values, prepared.starts, windows))
    model = simulator.model_at(values)
    start = planar.to_state(model, jnp.asarray(prepared.starts.theta[0]), jnp.asarray(prepared.starts.omega[0]))
    steps = windows.steps * windows.count
    run = jax.jit(lambda s: integrate(simulator.stepper, model, s, windows.dt, steps)[1].r[-1])
    forward = best_cpu(lambda: run(start).block_until_ready())
    return {"evaluation_cpu_s": full, "forward_run_cpu_s": forward, "forward_runs": full / forward}


def best_cpu(call: Any, times: int = 5) -> float:
    """Least CPU time of several calls, after one that compiles."""
    call()
    found = []
    for _ in range(times):
        begun = time.process_time()
        call()
        found.append(time.process_time() - begun)
    return min(found)


def against_scipy(prepared: Any) -> dict:
    """CPU seconds of our Gauss-Newton and of SciPy's trust region with finite differences, from the same start."""
    simulator = prepared.simulator
    few = prepared.windows.pick(np.arange(FEW))
    starts = Starts(prepared.starts.theta[:FEW], prepared.starts.omega[:FEW])
    begun = time.process_time()
    ours = fit_windows(replace(prepared.problem(), windows=few), prepared.values, starts)
    mine = time.process_time() - begun
    m = simulator.freedoms // 2
    bases = jnp.asarray(planar.chart(simulator.model_at(prepared.values), starts.theta))
    scale = np.abs(prepared.values)
    program = jax.jit(jax.vmap(partial(_value, simulator, few.dt, few.steps), in_axes=(None, 0, 0, 0, 0, 0, 0, 0)))

    def residual(x: np.ndarray) -> np.ndarray:
        z = x[2:].reshape(FEW, 2 * m)
        parts = program(x[:2] * scale, z, starts.theta, starts.omega, bases, few.theta, few.weight, few.index)
        return np.nan_to_num(np.asarray(parts).ravel(), nan=1e3)

    x0 = np.concatenate([np.ones(2), np.zeros(FEW * 2 * m)])
    residual(x0)
    begun = time.process_time()
    low = np.concatenate([np.zeros(2), np.full(FEW * 2 * m, -np.inf)])
    theirs = least_squares(residual, x0, bounds=(low, np.inf), x_scale="jac", max_nfev=60, ftol=1e-6)
    other = time.process_time() - begun
    return {
        "ours_cpu_s": mine,
        "ours_cost": ours.cost,
        "scipy_cpu_s": other,
        "scipy_cost": float(theirs.cost),
        "scipy_evaluations": int(theirs.nfev),
        "ratio": other / mine,
    }


def _value(simulator, dt, steps, values, z, theta, omega, basis, measured, weight, index):
    """Residuals of one window, no derivatives."""
    m = basis.shape[1]
    model = simulator.model_at(values)
    start = planar.closed(model, theta + basis @ z[:m], omega + basis @ z[m:])
    _, run = integrate(simulator.stepper, model, planar.to_state(model, *start), dt, steps)
    angles, _ = jax.vmap(partial(planar.from_nodes, model))(run.r, run.v)
    return planar.wrap(jnp.concatenate([start[0][None], angles])[index] - measured) * weight
