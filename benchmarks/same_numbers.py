"""Whether two checkouts step the packaged scenes to the same numbers: for changes that are to change none.

    python benchmarks/same_numbers.py record FILE.npz [SCENE ...]     where the numbers are right  (about 5 minutes)
    python benchmarks/same_numbers.py compare FILE.npz [SCENE ...]    in the other checkout        (about 5 minutes)

`record` runs every packaged scene for a while with its own stepper in equal steps and keeps 20 states of that run, the
state one step after each, the end of the run, and what a small change of the first velocities has grown to there. A
scene that would stay at rest is pushed sideways first. `compare` steps from the kept states and prints a row per scene:

    start           r and v that the scene is built with, against those built before
    r, v, tension   after one step: over the length of all lines, over the largest speed of the run (at least
                    sqrt(g length)), over the largest tension of the run
    work            likewise over the largest work of the run; `-` where none or other works than before are counted
    run             r at the end of the run, over that length and over the growth of a small change (at least 1)
    retried         whether the same steps were halved
    noise           what the last bits of r and v make of one step, as recorded: the largest of r, v, tension, work

All but the last are to stay within 1e-12, or the exit status is 1. A verdict `rounding` names columns above that which
are still within 30 times their own noise: as good as anything that sums in another order can be (a tension follows
from second differences of positions); `--rounding` lets them pass. Only public names are used, so that the script runs
in old checkouts: there with PYTHONPATH set to them.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from study import command, timed

import dropper_jax as dj
from dropper_jax.stepping.halving import advance_over

LIMIT = 1e-12
STATES = 20
#: Steps of a run, and of one with more than `MANY` nodes; multiples of `STATES`.
STEPS = 400
FEWER = 100
MANY = 40
GRAVITY = 9.81
#: Change of the first velocities whose growth is measured, over the speed.
SMALL = 1e-10
#: A run that has less than `REST` of the speed at its end starts again with `PUSH` of it, along y.
REST = 1e-4
PUSH = 0.02
#: Equal steps in an interval of a scene whose own steps follow an accuracy.
STEPS_PER_INTERVAL = 20
#: Differences up to this many times the noise may be rounding.
ROUNDING = 30.0
STEPPED = ("r", "v", "tension", "work")
COLUMNS = ("start", *STEPPED, "run")

Arrays = Mapping[str, np.ndarray]
#: What is kept of a scene: arrays by group.
Groups = Mapping[str, Arrays]


class Case(NamedTuple):
    """A packaged scene, ready to be stepped."""

    stepper: dj.Stepper
    model: dj.Model
    start: dj.State
    dt: jax.Array


def case_of(name: str) -> Case:
    """The case of a packaged scene, in equal steps."""
    run = dj.load_scene(name).run
    dt = run.interval / STEPS_PER_INTERVAL if run.dt is None else run.dt
    model, start = dj.build(name)
    stepper = dj.make_stepper(model, run.integrator, run.solver, **run.options)
    return Case(stepper, model, rebuilt(start, arrays(start)), jnp.asarray(dt, start.r.dtype))


@partial(jax.jit, static_argnums=0)
def march(stepper: dj.Stepper, model: dj.Model, s: dj.State, dt: jax.Array, steps: int) -> tuple[dj.State, jax.Array]:
    """The state after some steps, and whether one was retried. One program for any number: a scene compiles once."""

    def one(_: jax.Array, now: tuple[dj.State, jax.Array]) -> tuple[dj.State, jax.Array]:
        taken = advance_over(stepper, model, now[0], dt)
        return taken.state, now[1] | taken.retried

    return jax.lax.fori_loop(0, steps, one, (s, jnp.zeros((), bool)))


def single_steps(case: Case, states: Sequence[dj.State]) -> dict[str, np.ndarray]:
    """States one step after each of some, and whether the step was halved."""
    after = [march(case.stepper, case.model, s, case.dt, 1) for s in states]
    return {**stacked([arrays(s) for s, _ in after]), "retried": np.array([retried for _, retried in after])}


def arrays(s: dj.State) -> dict[str, np.ndarray]:
    """Arrays of a state by field and number, as float64; options are not kept."""
    found = {}
    for field in dataclasses.fields(s):
        value = getattr(s, field.name)
        if isinstance(value, bool):
            continue
        for i, leaf in enumerate(jax.tree.leaves(value)):
            found[f"{field.name}.{i}"] = np.asarray(leaf, np.float64)
    return found


def rebuilt(start: dj.State, kept: Arrays) -> dj.State:
    """The state of kept arrays; fields that are not kept, or in other shapes, stay those of `start`."""
    fields = {}
    for field in dataclasses.fields(start):
        leaves, tree = jax.tree.flatten(getattr(start, field.name))
        pairs = [(kept.get(f"{field.name}.{i}"), jnp.asarray(leaf)) for i, leaf in enumerate(leaves)]
        if all(a is not None and a.shape == leaf.shape for a, leaf in pairs):
            fields[field.name] = jax.tree.unflatten(tree, [jnp.asarray(a, leaf.dtype) for a, leaf in pairs])
    return dataclasses.replace(start, **fields)


def stacked(states: Sequence[Arrays]) -> dict[str, np.ndarray]:
    """Arrays of several states, one after another."""
    return {key: np.stack([s[key] for s in states]) for key in states[0]}


def largest(a: np.ndarray, b: np.ndarray, scale: Any) -> float:
    """Largest difference over a scale: 0 of nothing, not a number where shapes or numbers are none to compare."""
    if a.shape == b.shape:
        return float(np.max(np.abs(a - b), initial=0.0) / scale)
    return np.nan


def differences(a: Arrays, b: Arrays, scales: Arrays) -> dict[str, float]:
    """Largest differences of what a step finds, each over its scale."""
    return {key: largest(a[f"{key}.0"], b[f"{key}.0"], scales[key]) for key in STEPPED}


def record(name: str) -> dict[str, dict[str, np.ndarray]]:
    """What is kept of one scene: states of a run, steps from them, the run's end, scales, growth and noise."""
    case = case_of(name)
    steps = STEPS if len(case.start.r) <= MANY else FEWER
    states = run_of(case, steps)
    scales = scales_of(case.model, states)
    if np.max(np.abs(states[-1].v)) < REST * scales["v"]:
        push = jnp.asarray([0.0, PUSH, 0.0], case.start.v.dtype) * scales["v"]
        states = run_of(case._replace(start=dataclasses.replace(case.start, v=case.start.v + push)), steps)
        scales = scales_of(case.model, states)
    *before, end = states
    after = single_steps(case, before)
    run = {"dt": case.dt, "steps": steps, "growth": growth(case, states, steps, scales)}
    return {
        "run": {key: np.asarray(value) for key, value in run.items()},
        "start": arrays(case.start),
        "before": stacked([arrays(s) for s in before]),
        "after": after,
        "end": arrays(end),
        "scale": scales,
        "noise": noise(case, before, after, scales),
    }


def run_of(case: Case, steps: int) -> list[dj.State]:
    """States of a run at `STATES` times from its start on, and its end."""
    states = [case.start]
    for _ in range(STATES):
        states.append(march(case.stepper, case.model, states[-1], case.dt, steps // STATES)[0])
    return states


def scales_of(model: dj.Model, states: Sequence[dj.State]) -> dict[str, np.ndarray]:
    """What differences are measured by."""
    run = stacked([arrays(s) for s in states])
    most = {key: float(np.max(np.abs(run[f"{key}.0"]), initial=0.0)) for key in STEPPED}
    length = float(np.sum(model.line.length))
    speed = max(most["v"], float(np.sqrt(GRAVITY * length)))
    energy = float(np.sum(model.line.mass)) * speed**2
    sizes = {"r": length, "v": speed, "tension": most["tension"] or energy / length, "work": most["work"] or energy}
    return {key: np.asarray(size) for key, size in sizes.items()}


def growth(case: Case, states: Sequence[dj.State], steps: int, scales: Arrays) -> float:
    """What a small change of the first velocities, over the speed, makes of the last positions, over the length."""
    draw = np.random.default_rng(0).uniform(-1.0, 1.0, case.start.v.shape)
    changed = dataclasses.replace(states[0], v=states[0].v + SMALL * scales["v"] * draw)
    end, _ = march(case.stepper, case.model, changed, case.dt, steps)
    return largest(np.asarray(end.r), np.asarray(states[-1].r), scales["r"]) / SMALL


def noise(case: Case, before: Sequence[dj.State], after: Arrays, scales: Arrays) -> dict[str, np.ndarray]:
    """What the last bits of positions and velocities make of one step."""
    random = np.random.default_rng(1)

    def shaken(a: jax.Array) -> jax.Array:
        return a * (1.0 + jnp.finfo(a.dtype).eps * random.choice([-1.0, 1.0], a.shape))

    again = single_steps(case, [dataclasses.replace(s, r=shaken(s.r), v=shaken(s.v)) for s in before])
    return {key: np.asarray(value) for key, value in differences(again, after, scales).items()}


def compare(name: str, kept: Groups) -> tuple[str, str]:
    """One scene stepped again from the states kept of it: the row's text, and the verdict."""
    case = case_of(name)._replace(dt=jnp.asarray(kept["run"]["dt"]))
    after = kept["after"]
    scales = kept["scale"]
    noise = kept["noise"]
    states = [rebuilt(case.start, {key: a[i] for key, a in kept["before"].items()}) for i in range(STATES)]
    again = single_steps(case, states)
    built = arrays(case.start)
    end, _ = march(case.stepper, case.model, states[0], case.dt, int(kept["run"]["steps"]))
    found = {
        "start": max(largest(built[f"{key}.0"], kept["start"][f"{key}.0"], scales[key]) for key in ("r", "v")),
        **differences(again, after, scales),
        "run": largest(np.asarray(end.r), kept["end"]["r.0"], scales["r"]) / max(1.0, float(kept["run"]["growth"])),
    }
    if not after["work.0"].size or again["work.0"].shape != after["work.0"].shape:
        del found["work"]
    same = np.array_equal(again["retried"], after["retried"])
    verdict = judged(found, same, noise)
    cells = [f"{found[key]:8.1e}" if key in found else f"{'-':>8}" for key in COLUMNS]
    retried = "equal" if same else "OTHER"
    return " ".join([*cells, f"{retried:>8}", f"{max(map(float, noise.values())):8.1e}", f" {verdict}"]), verdict


def judged(found: Mapping[str, float], same: bool, noise: Arrays) -> str:
    """`same`, `rounding` or `differs`, with the columns above the limit."""
    above = [key for key, value in found.items() if not value <= LIMIT]
    if same and not above:
        return "same"
    if same and all(found[key] <= ROUNDING * noise.get(key, 0.0) for key in above):
        return f"rounding: {' '.join(above)}"
    return f"differs: {' '.join([*above, *([] if same else ['retried'])])}"


def record_all(path: str, names: Sequence[str]) -> int:
    """Record scenes into a file."""
    kept: dict[str, np.ndarray] = {}
    for name in names:
        one, times = timed(partial(record, name))
        kept |= {f"{name}/{group}/{key}": value for group, part in one.items() for key, value in part.items()}
        steps = one["run"]["steps"]
        growth = one["run"]["growth"]
        retried = int(np.sum(one["after"]["retried"]))
        print(f"{name:36} {steps:4d} steps, growth {growth:8.1e}, {retried:2d} retried, {times['seconds']:4.1f} s")
    np.savez_compressed(path, **kept)
    return 0


def compare_all(path: str, names: Sequence[str], rounding: bool) -> int:
    """Compare the scenes of a file; the exit status."""
    kept: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    with np.load(path) as file:
        for place, value in file.items():
            name, group, key = place.split("/")
            kept.setdefault(name, {}).setdefault(group, {})[key] = value
    print(f"{'':36} " + " ".join([f"{key:>8}" for key in COLUMNS] + [" retried", "   noise"]))
    verdicts = []
    for name in names or sorted(kept):
        text = verdict = "differs: is no packaged scene here"
        if name in dj.scene_names():
            text, verdict = compare(name, kept[name])
        verdicts.append(verdict)
        print(f"{name:36} {text}", flush=True)
    if new := sorted(set(dj.scene_names()) - set(kept)):
        print("not recorded:", *new)
    counts = {kind: sum(v.startswith(kind) for v in verdicts) for kind in ("same", "rounding", "differs")}
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()))
    return int(counts["differs"] > 0 or (counts["rounding"] > 0 and not rounding))


@command({"command": ("record", "compare"), "file": str, "scene": [str]}, rounding=False)
def main(given) -> int:
    print(f"{given.command}: {dj.__file__}, jax {jax.__version__}")
    if given.command == "record":
        return record_all(given.file, given.scene or dj.scene_names())
    return compare_all(given.file, given.scene, given.rounding)
