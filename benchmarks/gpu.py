"""The same numbers on a GPU as on the processor, and what a GPU is good for.

    JAX_PLATFORMS=cpu python benchmarks/gpu.py /tmp/processor.npz         on the processor of that machine, first
    python benchmarks/gpu.py /tmp/gpu.npz --against /tmp/processor.npz    on its GPU

Runs that choose their steps, derivatives of a run by every field of the model, equilibria and a fit are kept as arrays;
the second call prints their largest differences from the first, and both print times. Writes results/gpu.json where a
file is compared with.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from study import Found, Rows, command, say, store, table_of

import dropper_jax as dj
from dropper_jax.backend.batches import map_members
from fitting import Trace, fit

LAB = "dropper-release-a"
SCENES = (LAB, "double-pendulum-periodic", "dropper-release-a-compound", "paper-case-4")
SCHEMES = ("energy_momentum", "rattle", "theta_midpoint")
DURATION = 1.0
#: Step [s] and steps of runs that are timed and differentiated.
STEP = 0.0025
STEPS = 200
DAMPING = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
AT_REST = ("paper-case-1", "edulis-longline")
#: Kinds of results, by the first word of their arrays' names.
KINDS = ("runs", "derivatives of runs", "fit", "equilibrium")
#: How names of times begin in the kept file.
TIME = "time "
#: Members of batches.
CASES = (256, 4096, 16384)

Arrays = dict[str, np.ndarray]


def runs() -> Arrays:
    """Positions and tensions of runs that choose their steps."""
    found = {}
    for name in SCENES:
        run = dj.simulate(name, duration=DURATION, accuracy=0.01)
        found[f"runs {name} positions"] = run.positions
        found[f"runs {name} tensions"] = run.tension
    return found


def end_of(integrator: str, model: dj.Model, start: dj.State, steps: int = STEPS) -> jax.Array:
    """Sum of the last positions [m] of a run of constant steps."""
    stepper = dj.make_stepper(model, integrator, track_work=False)
    last, _ = dj.integrate(stepper, model, start, STEP, steps)
    return jnp.sum(last.r)


def derivatives() -> Arrays:
    """Derivatives of the end of a run by all numbers of the model."""
    model, start = dj.build(LAB)
    found = {}
    for scheme in SCHEMES:
        slope = jax.jit(jax.grad(lambda model, scheme=scheme: end_of(scheme, model, start), allow_int=True))(model)
        numbers = [np.ravel(leaf) for leaf in jax.tree.leaves(slope) if leaf.dtype == np.float64]
        found[f"derivatives {scheme}"] = np.concatenate(numbers)
    return found


def statics() -> Arrays:
    """Poses at rest."""
    return {
        f"equilibrium {name}": np.asarray(dj.equilibrium(name).positions)
        for name in ("paper-case-1", "edulis-longline")
    }


def fits() -> Arrays:
    """Damping fitted to angles of a run, from values three times too large."""
    run = dj.simulate(LAB, duration=4.0, accuracy=1e-3)
    trace = Trace("run", run.t, np.arctan2(np.diff(run.positions[:, :, 2]), np.diff(run.positions[:, :, 0])))
    found = fit(trace, LAB, list(DAMPING), start={name: 3.0 * run.scene.value(name) for name in DAMPING})
    return {"fit values": np.asarray(found.values)}


def seconds_of(work: Callable[[], Any]) -> float:
    """Time [s] of a second call."""
    jax.block_until_ready(work())
    begun = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - begun


def times() -> Found:
    """Milliseconds per step of single runs, and million steps per second of batches."""
    found: Found = {}
    for name in (LAB, "edulis-longline"):
        model, start = dj.build(name)
        one = dj.one_kernel(partial(end_of, "energy_momentum"))
        found[f"{name} [ms per step]"] = 1e3 * seconds_of(partial(one, model, start)) / STEPS
    model, start = dj.build(LAB)

    def member(share: jax.Array) -> jax.Array:
        scaled = jax.tree.map(lambda leaf: leaf * share if leaf.dtype == start.r.dtype else leaf, model.effects)
        return end_of("rattle", replace(model, effects=scaled), start)

    batch = dj.one_kernel(map_members(member))
    for cases in CASES:
        shares = jnp.linspace(0.5, 1.5, cases)
        if jax.default_backend() == "cpu" and cases > CASES[0]:
            continue
        found[f"{cases} cases [million steps per s]"] = 1e-6 * cases * STEPS / seconds_of(partial(batch, shares))
    return found


def kept_times(measured: Found) -> Arrays:
    return {f"{TIME}{name}": np.asarray(value) for name, value in measured.items()}


def differences(found: Arrays, expected: Arrays) -> dict[str, float]:
    """Largest difference of each array over its largest number."""
    apart = {}
    for name in expected:
        if not name.startswith(TIME):
            apart[name] = float(np.max(np.abs(found[name] - expected[name])) / np.max(np.abs(expected[name])))
    return apart


@command({"kept": Path}, against=Path)
def main(args: Any) -> None:
    found: Arrays = {}
    for work in (runs, derivatives, statics, fits):
        begun = time.perf_counter()
        found |= work()
        say({work.__name__: round(time.perf_counter() - begun, 1)})
        np.savez(args.kept, **found)
    measured = times()
    say(measured)
    np.savez(args.kept, **found, **kept_times(measured))
    if args.against is not None:
        with np.load(args.against) as expected:
            apart = differences(found, dict(expected))
            processor = {name.removeprefix(TIME): float(expected[name]) for name in expected if name.startswith(TIME)}
        say(apart)
        device = jax.devices()[0].device_kind
        head = {"device": device, "jax": jax.__version__, "differences": apart}
        store("gpu", {**head, "times": measured, "processor_times": processor})


@table_of("gpu")
def gpu(found: Found) -> Rows:
    """The largest difference of each kind of result, and times on both."""

    def largest(kind: str) -> str:
        return f"{max(value for name, value in found['differences'].items() if name.startswith(kind)):.0e}"

    def of(kept: Found, name: str) -> str:
        if name not in kept:
            return "-"
        return f"{kept[name]:.3g}"

    head = ("", f"{found['device']} (JAX {found['jax']})", "one core of its machine")
    apart = [(f"{kind}: largest difference, relative", largest(kind.split()[0]), "") for kind in KINDS]
    both = [(name, of(found["times"], name), of(found["processor_times"], name)) for name in found["times"]]
    return [head, *apart, *both]
