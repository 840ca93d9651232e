"""Whether two checkouts step equally fast and compile equally fast: medians of interleaved pairs, processor time.

    python benchmarks/same_speed.py OTHER_CHECKOUT [--pairs 7] [--cases NAME ...]
    python benchmarks/same_speed.py --pairs 5       what this one gains by one kernel: with the tag and without

Each checkout runs in a process of its own, one thread, on the same processor; the two take turns, so that a machine
which slows down slows both. One that can make a run one kernel does (`--plain`: neither does). A row per case:
microseconds per step of the other checkout and of this one, their ratio (median of the pairs' ratios, and the range of
the middle half), and the same of compilation. The loop of a run is that of `simulate`, which halves steps that do not
converge. Without another checkout rows are stored in results/one_kernel.json, compiled once.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from study import RESULTS, Found, collect, command, describe, versions

HERE = Path(__file__).parents[1]
#: Environment variable of the processes whose functions are one kernel by the tag.
TAGGED = "SAME_SPEED_TAGGED"
#: Cases: links of a dropper or a packaged scene, scheme, step [s], steps; `gradient` takes value and gradient.
CASES: dict[str, dict[str, Any]] = {
    "7 links": {"links": 7, "dt": 0.03, "steps": 4000},
    "7 links, rattle": {"links": 7, "dt": 0.03, "steps": 8000, "integrator": "rattle"},
    "18 links": {"links": 18, "dt": 0.03, "steps": 3000},
    "18 links, rattle": {"links": 18, "dt": 0.03, "steps": 6000, "integrator": "rattle"},
    "100 links": {"links": 100, "dt": 0.003, "steps": 1000},
    "100 links, rattle": {"links": 100, "dt": 0.003, "steps": 2000, "integrator": "rattle"},
    "1000 links": {"links": 1000, "dt": 0.0005, "steps": 100},
    "1000 links, rattle": {"links": 1000, "dt": 0.0005, "steps": 300, "integrator": "rattle"},
    "lab dropper, gradient": {"scene": "dropper-release-a", "dt": 0.005, "steps": 1000, "gradient": True},
    "lab dropper, rattle, gradient": {
        "scene": "dropper-release-a", "dt": 0.005, "steps": 2000, "integrator": "rattle", "gradient": True,
    },
    "paper-case-1": {"scene": "paper-case-1", "dt": 0.02, "steps": 1000},
    "paper-case-1, generalized_alpha": {
        "scene": "paper-case-1", "dt": 0.01, "steps": 1000, "integrator": "generalized_alpha",
    },
    "edulis-longline": {"scene": "edulis-longline", "dt": 0.03, "steps": 100},
}  # fmt: skip


def dropper(links: int, dt: float) -> dict[str, Any]:
    """A 17 m, 14 kg/m dropper with its ends 2.5 m apart, linear and quadratic damping."""
    line = {"name": "line", "from": "left", "to": "right", "links": links}
    return {
        "run": {"dt": dt, "duration": 1.0},
        "point": [{"name": "left", "position": [0.0, 0.0, 0.0]}, {"name": "right", "position": [2.5, 0.0, 0.0]}],
        "line": [line | {"length": 17.0 / links, "mass": 238.0 / links}],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.5}, "quadratic_damping": {"b_q": 5.0}},
    }


def serve(case: dict[str, Any]) -> None:
    """Answer each line of the input, `compile` or `run`, with processor time [s]."""
    import jax
    import jax.numpy as jnp

    import dropper_jax as dj
    from dropper_jax.stepping.integrate import advance
    from dropper_jax.stepping.progress import begin

    model, start = dj.build(case.get("scene") or dropper(case["links"], case["dt"]))
    if "links" in case:  # thrown out of its plane with 1 m/s in the middle
        shape = jnp.sin(jnp.linspace(0.0, jnp.pi, model.free_nodes))
        start = dj.state(model, start.r, jnp.zeros_like(start.r).at[:, 1].set(shape), start.tension)
    stepper = dj.make_stepper(model, case.get("integrator", "energy_momentum"), track_work=False)
    if hasattr(stepper.integrator, "begin"):
        start = stepper.integrator.begin(model, start)

    def run(model: Any, s: Any) -> Any:
        if case.get("gradient"):
            return dj.integrate(stepper.plain, model, s, case["dt"], case["steps"])[1].r[-1].sum()
        return advance(stepper, model, begin(stepper, model, s), jnp.asarray(case["dt"]), case["steps"])[1].r[-1].sum()

    compiled: Callable[..., Any] = None
    for word in sys.stdin:
        begun = time.process_time()
        if word.strip() == "compile":
            jax.clear_caches()
            function = jax.value_and_grad(run) if case.get("gradient") else run
            compile_ = dj.one_kernel if os.environ.get(TAGGED) else jax.jit
            compiled = compile_(function).lower(model, start).compile()
        else:
            jax.block_until_ready(compiled(model, start))
        print(time.process_time() - begun, flush=True)


class Side:
    """A checkout at work."""

    def __init__(self, tree: Path, case: str, plain: bool) -> None:
        flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        tagged = not plain and (tree / "dropper_jax/backend/one_kernel.py").exists()
        paths = os.pathsep.join([str(tree), str(Path(__file__).parent)])
        environment = {**os.environ, "PYTHONPATH": paths, "XLA_FLAGS": flags, TAGGED: "1" if tagged else ""}
        call = [sys.executable, "-c", f"import same_speed; same_speed.serve(same_speed.CASES[{case!r}])"]
        self.process = subprocess.Popen(
            call, cwd=tree, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def ask(self, word: str) -> float:
        given = self.process.stdin
        answered = self.process.stdout
        given.write(word + "\n")
        given.flush()
        return float(answered.readline())


def pairs(other: Side, own: Side, word: str, count: int) -> tuple[float, float, list[float]]:
    """Median times of both and the sorted ratios of the pairs; who begins changes from pair to pair."""
    theirs = []
    ours = []
    for i in range(count):
        for side, times in ((other, theirs), (own, ours))[:: 1 if i % 2 else -1]:
            times.append(side.ask(word))
    return statistics.median(theirs), statistics.median(ours), sorted(b / a for a, b in zip(theirs, ours, strict=True))


def measure_both(other: Side, own: Side, compilations: int, runs: int) -> tuple:
    """What `pairs` finds of compilations and of runs, the first of which is left out."""
    built = pairs(other, own, "compile", compilations)
    pairs(other, own, "run", 1)
    ran = pairs(other, own, "run", runs)
    for side in (other, own):
        side.process.communicate()  # its input ends, and so does it
    return built, ran


def one_kernel(name: str, count: int) -> Found:
    """Microseconds per step and seconds of compilation, without and with the tag."""
    compiled, ran = measure_both(Side(HERE, name, True), Side(HERE, name, False), 1, count)
    scale = 1e6 / CASES[name]["steps"]
    return {
        "case": name,
        "plain_us": ran[0] * scale,
        "one_kernel_us": ran[1] * scale,
        "times_faster": 1.0 / statistics.median(ran[2]),
        "plain_compile_s": compiled[0],
        "one_kernel_compile_s": compiled[1],
    }


@command({"other": [Path]}, pairs=7, compilations=3, cases=list(CASES), plain=False, out=RESULTS / "one_kernel.json")
def main(args) -> None:
    if not args.other:
        rows = (one_kernel(name, args.pairs) for name in args.cases)
        collect(args.out, {"rows": rows}, machine=describe(), **versions("jax"))
        return
    (other,) = args.other
    print(f"{'case':34s} {'us/step':>9s} {'now':>9s} {'ratio':>7s} {'middle half':>13s}   compile    now ratio")
    for name in args.cases:
        built, ran = measure_both(
            Side(other, name, args.plain), Side(HERE, name, args.plain), args.compilations, args.pairs
        )
        scale = 1e6 / CASES[name]["steps"]
        ratios = ran[2]
        quarter = len(ratios) // 4
        steps = f"{ran[0] * scale:9.2f} {ran[1] * scale:9.2f} {statistics.median(ratios):7.3f}"
        spread = f"{ratios[quarter]:6.3f}-{ratios[-1 - quarter]:.3f}"
        compiled = f"{built[0]:7.2f} {built[1]:6.2f} {statistics.median(built[2]):.3f}"
        print(f"{name:34s} {steps} {spread}   {compiled}", flush=True)
