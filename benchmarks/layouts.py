"""Random longlines at rest: how many static poses are found, whether they balance and stay, and where runs end.

    python benchmarks/layouts.py [--count 300] [--first 0] [--only SEED,SEED] [--check 30] [--out results/layouts.json]

Layout i is drawn from seed i: a topology, a bed (flat, sloping, with hills), ropes and chains from floating to heavy,
lengths from taut to slack, floats and spar buoys from too small to much too large, depths of 5 to 60 m, currents of 0
to 2 m/s. Prints a row for each that is not found, and the share that is.

- Balance: forces of the effects and `EA max(e, 0)` of every link, summed anew in NumPy, over the weight of all lines.
- Stability: least real part of the eigenvalues of the whole stiffness, drag included (a pose to which every slow
  motion returns), over the weight of a mean link per its length. What nothing holds has zero.
- Check: a run with added damping from a pose pushed aside by up to 2 % of the size. Largest distance at its end over
  the length of the line, and largest difference of tensions over the largest tension; the smaller of them counts, as
  slack lines may lie in many ways and carry the same.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from layout_draws import DURATION, STEP, TOPOLOGIES, Scene, layout
from study import command, show, store, timed

import dropper_jax as dj
from dropper_jax.statics import rest
from dropper_jax.statics.tangent import stiffness

#: Largest unbalanced force, and most negative stiffness, of a pose that counts as found; largest misfit of a check.
BALANCED, STABLE, SAME = 1e-8, -1e-6, 0.01
#: Of added damping [kg/s per kg] of checks.
DAMPING = 0.5


def unbalanced(model: dj.Model, s: dj.State) -> np.ndarray:
    """Forces that are left on the free nodes (free, 3) [N], the ropes' tensions anew from where their ends are."""
    graph, line = model.geometry, model.line
    nodes = np.concatenate([s.r, model.ends(s.t).positions])
    d = nodes[graph.last] - nodes[graph.first]
    now = np.linalg.norm(d, axis=1)
    pull = line.axial.EA * np.maximum(now / line.length - 1.0, 0.0) / now
    total = np.zeros_like(nodes)
    np.add.at(total, graph.first, pull[:, None] * d)
    np.add.at(total, graph.last, -pull[:, None] * d)
    return total[: graph.free] + model.force(model.instant(s.r, jnp.zeros_like(s.r), s.t))


def judged(seed: int) -> Scene:
    """Layout `seed` solved: what `dj.equilibrium` says, balance and stability of the pose, and the time it took."""
    found: Scene = {"seed": seed, "name": layout(seed)["name"]}
    try:
        scene = dj.load_scene(layout(seed))
        pose, times = timed(partial(dj.equilibrium, scene))
    except dj.SceneError as error:
        return found | {"ok": False, "why": f"refused: {error}"}
    model, s = rest(dj.build_model(scene)), pose.state
    weight = 9.81 * np.asarray(model.line.mass)
    values = np.linalg.eigvals(stiffness(model, s, jnp.zeros_like(s.r)).toarray())
    found |= {
        "seconds": times["seconds"],
        "residual": float(np.max(np.abs(unbalanced(model, s))) / np.sum(weight)),
        "stiffness": float(np.min(values.real) / np.mean(weight) * np.mean(model.line.length)),
    }
    reasons = {
        pose.message: pose.status != "ok",
        "out of balance": not found["residual"] <= BALANCED,
        "not stable": not found["stiffness"] >= STABLE,
    }
    return found | {"ok": not any(reasons.values()), "why": "; ".join(why for why, bad in reasons.items() if bad)}


run = jax.jit(dj.integrate, static_argnames=("stepper", "steps", "save_every"))


def checked(seed: int) -> Scene:
    """Misfits of a pose and the end of a damped run that begins beside it."""
    scene = dj.load_scene(layout(seed))
    pose = dj.equilibrium(scene)
    model = dj.build_model(scene)
    damping = dj.effects.LinearDamping(b_l=DAMPING * model.node_mass)
    model = replace(model, effects=(*model.effects, damping))
    size = float(np.max(np.ptp(pose.positions, axis=0)))
    r = pose.state.r
    bow = np.sin(np.pi * np.asarray(r) / size + np.arange(3)) * 0.02 * size
    start = dj.state(model, r + jnp.asarray(bow), tension=pose.state.tension)
    stepper = dj.make_stepper(model, "energy_momentum", "network", track_work=False)
    steps = round(DURATION / STEP)
    end, path = run(stepper, model, start, STEP, steps, save_every=steps // 10)
    longest = max(float(np.sum(line.length)) for line in scene.lines)
    moved = float(np.max(np.abs(np.asarray(end.r - r)))) / longest
    most = max(float(np.max(pose.tension)), 9.81 * float(jnp.mean(model.line.mass)))
    pulled = float(np.max(np.abs(np.asarray(end.tension) - pose.tension))) / most
    return {"moved": moved, "pulled": pulled, "failed": int(np.sum(path.failed)), "same": min(moved, pulled) <= SAME}


@command(count=300, first=0, only="", check=0, out=Path)
def main(args) -> int:
    seeds = [int(seed) for seed in args.only.split(",") if seed] or range(args.first, args.first + args.count)
    write = lambda: args.out and store(args.out, {"rows": rows})  # noqa: E731
    show("layout", "residual", "stiffness", "s", "why")
    rows = []
    # layouts of one topology and one kind of bed share their programs
    for seed in sorted(seeds, key=lambda i: (i % (2 * len(TOPOLOGIES)), i)):
        rows.append(row := judged(seed))
        if not row["ok"] or args.only:
            numbers = (f"{row.get(key, np.nan):.1e}" for key in ("residual", "stiffness", "seconds"))
            show(row["name"], *numbers, row["why"])
        write()
    good = [row for row in rows if row["ok"]]
    print(f"found: {len(good)} of {len(rows)}, {len(good) / len(rows):.1%}")
    # evenly over topologies and beds, one after another as they stand
    for row in good[:: max(len(good) // args.check, 1)][: args.check] if args.check else ():
        row |= checked(row["seed"])
        show(row["name"], f"moved {row['moved']:.1e}", f"pulled {row['pulled']:.1e}", row["same"])
        write()
    return int(len(good) < 0.99 * len(rows))
