"""Random sequences of public calls in one process, each call compared with the same call alone in a fresh process.

    python tests/faults/sequences.py [--sequences 20] [--calls 6] [--seed 1] [--jobs 1] [--alone FILE] [--out TABLE]
    python tests/faults/sequences.py --one NAME ...      these calls in this order, a line of JSON each

A call must give the same numbers after any other calls, and from the traces and programs that another process has kept.
Each sequence starts with an empty cache folder; a second process repeats its calls in reverse order from that folder.
Results of single calls are kept in the file `--alone` by a digest of the sources, so that long series run each of them
once. The exit status is 1 where a result differs or a call fails.
"""

import argparse
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
#: Relative difference of two numbers that count as equal: programs of one call may be compiled in different forms.
TOLERANCE = 1e-6
#: First word of a line with a result.
RESULT = "RESULT"
#: Seconds after which a process of some calls hangs.
LONGEST = 1800.0

LAB, SEA = "dropper-release-a", "paper-case-4"
FRICTION = {
    "run": {"dt": 0.01, "duration": 0.15},
    "point": [
        {"name": "hook", "position": [0.0, 0.0, 0.0]},
        {"name": "weight", "kind": "free", "position": [0.0, 0.0, -0.4]},
    ],
    "line": [{"name": "rods", "from": "hook", "to": "weight", "links": 2, "length": 0.2, "mass": 0.05}],
    "effects": {"weight": {}, "joint_friction": {"dry": 2e-3, "axis": [0.0, 1.0, 0.0]}},
    "start": {"kind": "static", "release_nodes": [2], "release_force": [[0.3, 0.0, 0.1]]},
}
ROPES = {
    "run": {"dt": 0.005, "duration": 0.1},
    "point": [
        {"name": "left", "position": [0.0, 0.0, 0.0]},
        {"name": "middle", "kind": "free", "position": [1.0, 0.0, -0.5]},
        {"name": "right", "position": [2.0, 0.0, 0.0]},
    ],
    "line": [
        {"name": name, "from": ends[0], "to": ends[1], "links": 2, "length": 1.2, "mass": 0.4}
        | {"axial": {"law": "rope", "EA": 2000.0}}
        for name, ends in (("a", ("left", "middle")), ("b", ("middle", "right")))
    ],
    "effects": {"weight": {}},
    "start": {"kind": "points"},
}


def in_numbers(*arrays: Any) -> list[list[float]]:
    """Two numbers for each array, which change with any of its values."""
    flat = [np.asarray(a, float).ravel() for a in arrays]
    return [[float(np.abs(a).sum()), float(a @ np.sin(1.0 + np.arange(a.size)))] for a in flat]


def run(scene: Any, **settings: Any) -> list[Any]:
    import dropper_jax as dj

    found = dj.simulate(scene, **settings)
    return [found.status, *in_numbers(found.positions[-1], found.tension[-1])]


def marched(scene: Any, integrator: str, gamma: float | None = None) -> list[Any]:
    """A run by the program that schemes share in studies."""
    import dropper_jax as dj
    from dropper_jax.study.march import grid_run

    model, s = dj.build(scene)
    found = grid_run(dj.make_stepper(model, integrator, gamma=gamma), model, s, 0.04, 4, 3)
    return in_numbers(found.r[-1], found.rows.tension[-1])


def stepped(scene: Any, integrator: str, **options: float) -> list[Any]:
    import dropper_jax as dj

    model, s = dj.build(scene)
    stepper = dj.make_stepper(model, integrator, **options)
    for _ in range(2):
        s, _ = dj.step(stepper, model, s, 0.005)
    return in_numbers(s.r, s.v)


def derivative(scene: Any, kind: str, integrator: str = "energy_momentum") -> list[Any]:
    import jax
    import jax.numpy as jnp

    import dropper_jax as dj

    model, s = dj.build(scene)
    stepper = dj.make_stepper(model, integrator)

    def spread(share: jax.Array) -> jax.Array:
        line = replace(model.lines[0], mass=model.lines[0].mass * (1.0 + share))
        end, _ = dj.integrate(stepper, replace(model, lines=(line, *model.lines[1:])), s, 0.01, 6, 6)
        return jnp.sum(end.r**2)

    match kind:
        case "reverse":
            return in_numbers(jax.jit(jax.grad(spread))(0.0))
        case "forward":
            return in_numbers(jax.jvp(spread, (0.0,), (1.0,))[1])
    return in_numbers(jax.vmap(jax.grad(spread))(jnp.array([0.0, 0.1])))


def refused() -> list[Any]:
    import dropper_jax as dj

    try:
        dj.simulate(LAB, dt=-1.0)
    except dj.SceneError:
        return ["refused"]
    return ["accepted"]


def interrupted() -> list[Any]:
    import dropper_jax as dj

    def stop(fraction: float, text: str) -> None:
        if fraction > 0.0:
            raise KeyboardInterrupt

    try:
        return [dj.simulate(LAB, duration=0.4, progress=stop).status]
    except KeyboardInterrupt:
        return ["interrupted"]


def in_two_threads() -> list[Any]:
    found: dict[str, list[Any]] = {}

    def work(name: str, call: Callable[[], list[Any]]) -> None:
        found[name] = call()

    works = {"lab": lambda: run(LAB, duration=0.2), "ropes": lambda: run(ROPES)}
    threads = [threading.Thread(target=work, args=item) for item in works.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [*found["lab"], *found["ropes"]]


def fitted(method: str) -> list[Any]:
    from fitting import Camera, fit, observe, simulate_truth

    trace = observe(simulate_truth(LAB, 1.0), Camera(angle_noise=0.005), seed=0)
    return in_numbers(fit(trace, LAB, ["b_l"], method=method).values)


def swept() -> list[Any]:
    from fitting.sweep import open_sweep, sweep

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cases.zarr"
        sweep(LAB, {"b_l": [0.001, 0.002]}, out, duration=0.2)
        return in_numbers(np.asarray(open_sweep(out)["tension_max"]))


def sensitivity() -> list[Any]:
    import dropper_jax as dj
    from fitting.sensitivity.derivatives import local_derivatives
    from fitting.sensitivity.problem import study

    scene = dj.load_scene(LAB).with_values({"run.duration": 0.1})
    return in_numbers(local_derivatives(study(scene, "tension.max", ["effects.weight.gravity"])).forward)


def at_rest() -> list[Any]:
    import dropper_jax as dj

    return in_numbers(dj.equilibrium(SEA).tension)


def coupled() -> list[Any]:
    import dropper_jax as dj

    lines = dj.Coupled(ROPES, points=["left"])
    return in_numbers(lines.init(), lines.step(np.array([[0.01, 0.0, 0.0]]), np.array([[0.1, 0.0, 0.0]]), 0.01))


CALLS: dict[str, Callable[[], list[Any]]] = {
    "lab": lambda: run(LAB, duration=0.2),
    "lab theta 0.8": lambda: run(LAB, duration=0.2, integrator="theta", gamma=0.8),
    "lab theta_midpoint 0.8": lambda: run(LAB, duration=0.2, integrator="theta_midpoint", gamma=0.8),
    "lab rattle_4": lambda: run(LAB, duration=0.2, integrator="rattle_4"),
    "lab float32": lambda: run(LAB, duration=0.2, dtype="float32"),
    "lab dense": lambda: run(LAB, duration=0.2, solver="dense"),
    "lab tolerance": lambda: run(LAB, duration=0.2, accuracy=0.05),
    "lab marched": lambda: marched(LAB, "energy_momentum"),
    "lab marched theta_midpoint 0.9": lambda: marched(LAB, "theta_midpoint", 0.9),
    "lab marched theta 1": lambda: marched(LAB, "theta", 1.0),
    "lab steps thesis_angles": lambda: stepped(LAB, "thesis_angles", gamma=0.6),
    "lab reverse": lambda: derivative(LAB, "reverse"),
    "lab forward": lambda: derivative(LAB, "forward"),
    "lab batch": lambda: derivative(LAB, "batch"),
    "friction": lambda: run(FRICTION),
    "friction theta_midpoint 0.9": lambda: run(FRICTION, integrator="theta_midpoint", gamma=0.9),
    "friction tolerance": lambda: run(FRICTION, accuracy=0.05),
    "friction marched": lambda: marched(FRICTION, "energy_momentum"),
    "friction marched theta_midpoint 0.9": lambda: marched(FRICTION, "theta_midpoint", 0.9),
    "friction reverse": lambda: derivative(FRICTION, "reverse"),
    "friction forward": lambda: derivative(FRICTION, "forward"),
    "friction forward theta_midpoint": lambda: derivative(FRICTION, "forward", "theta_midpoint"),
    "ropes": lambda: run(ROPES),
    "ropes generalized_alpha": lambda: run(ROPES, integrator="generalized_alpha"),
    "ropes rk4": lambda: run(ROPES, dt=0.001, integrator="rk4"),
    "ropes adaptive": lambda: run(ROPES, accuracy=0.01),
    "ropes steps generalized_alpha": lambda: stepped(ROPES, "generalized_alpha"),
    "sea": lambda: run(SEA, duration=0.2),
    "waves": lambda: run("wet-pendulum-wave", duration=0.2),
    "bed friction tolerance": lambda: run("paper-case-2", duration=0.2, accuracy=0.05),
    "rest": at_rest,
    "coupled": coupled,
    "refused": refused,
    "interrupted": interrupted,
    "two threads": in_two_threads,
    "fit": lambda: fitted("windows"),
    "fit by gradient": lambda: fitted("gradient"),
    "sweep": swept,
    "sensitivity": sensitivity,
}


def result_of(name: str) -> list[Any]:
    try:
        return CALLS[name]()
    except BaseException as error:
        return [f"failed: {type(error).__name__}: {str(error)[:200]}"]


def in_process(names: list[str], folder: str) -> list[list[Any]]:
    """Results of calls in one process with that cache folder."""
    environment = {"XDG_CACHE_HOME": folder, "JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3"}
    environment["PYTHONPATH"] = str(ROOT)
    call = [sys.executable, __file__, "--one", *names]
    try:
        done = subprocess.run(
            call, env={**os.environ, **environment}, capture_output=True, text=True, timeout=LONGEST, check=False
        )
        out, end = done.stdout, f"ended with {done.returncode}: {done.stderr[-200:]}"
    except subprocess.TimeoutExpired as error:
        out, end = (error.stdout or b"").decode(), "took too long"
    found = [json.loads(line.removeprefix(RESULT)) for line in out.splitlines() if line.startswith(RESULT)]
    return found + [[f"failed: the process {end}"]] * (len(names) - len(found))


def is_same(a: Any, b: Any) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(is_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) <= TOLERANCE * max(abs(a), abs(b), TOLERANCE) or (math.isnan(a) and math.isnan(b))
    return a == b


def has_failed(result: list[Any]) -> bool:
    return bool(result) and isinstance(result[0], str) and result[0].startswith("failed")


@cache
def alone(name: str) -> list[Any]:
    """The result of a single call in a fresh process with an empty cache folder."""
    with tempfile.TemporaryDirectory() as folder:
        return in_process([name], folder)[0]


def run_sequence(names: list[str]) -> list[str]:
    """One line for each result that differs from that of the call alone."""
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, order in (("empty cache", names), ("kept programs", names[::-1])):
            for name, found in zip(order, in_process(order, folder), strict=True):
                if has_failed(found) or not is_same(found, alone(name)):
                    wrong.append(f"{name} ({kind}, in {', '.join(order)}): {found}, alone {alone(name)}")
    return wrong


def judge(names: list[str]) -> bool:
    """Run a sequence, and print whether each call gives what it gives alone."""
    wrong = run_sequence(names)
    print(f"{'ok' if not wrong else 'WRONG'}: {', '.join(names)}", *wrong, sep="\n    ", flush=True)
    return not wrong


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sequences", type=int, default=20, help="number of sequences")
    parser.add_argument("--calls", type=int, default=6, help="calls of each")
    parser.add_argument("--seed", type=int, default=1, help="of the first sequence")
    parser.add_argument("--jobs", type=int, default=1, help="sequences at a time")
    parser.add_argument("--one", nargs="+", choices=CALLS, metavar="NAME", help="run these in this process")
    args = parser.parse_args(argv)
    for name in args.one or ():
        print(RESULT, json.dumps(result_of(name)), flush=True)
    if args.one:
        return 0
    seeds = range(args.seed, args.seed + args.sequences)
    sequences = [np.random.default_rng(seed).choice(list(CALLS), args.calls).tolist() for seed in seeds]
    with ThreadPoolExecutor(args.jobs) as pool:
        # first the single calls, once each: two sequences would otherwise run the same one
        names = sorted(set(itertools.chain.from_iterable(sequences)))
        failed = [name for name, found in zip(names, pool.map(alone, names), strict=True) if has_failed(found)]
        good = list(pool.map(judge, sequences))
    print(*(f"alone: {name}: {alone(name)}" for name in failed), sep="\n")
    print(f"{good.count(False)} of {len(good)} sequences with another result than alone, {len(failed)} calls fail")
    return int(bool(failed) or not all(good))


if __name__ == "__main__":
    sys.exit(main())
