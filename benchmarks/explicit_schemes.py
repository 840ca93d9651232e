"""Semi-implicit Euler against rk2 on the elastic chain, as the paper discusses them, and the implicit default.

The chain of case 1 (12 segments, EA 4.9e7 N), its top driven gently, one row per internal damping ratio: the largest
stable step of each scheme, and what it makes of mean and standard deviation of the fairlead tension there, at half of
it, and at a common step. Then the same chain without water or damper, set swinging across its plane: change of energy
over its kinetic energy at the start.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import jax
import numpy as np
from moordyn_runs import SAMPLE, Ours, Rows
from moordyn_speed import SMOOTH, driven_chain
from study import Found

from dropper_jax import Scene, build, integrate, make_stepper
from dropper_jax.stepping.integrate import observe

SPAN, SETTLED = 30.0, 10.0  # [s]
RATIOS = (1.0, 0.1, 0.0)
#: Steps in 0.1 s that are tried, from large steps to small ones.
COUNTS = (10, 20, 40, 50, 60, 70, 80, 100, 120, 150, 200, 300, 400, 600, 800, 1200, 1600)
#: The reference: rk4 at this many steps in 0.1 s.
REFERENCE = 1600
#: A run whose deviation is off by more than this rings at its limit and does not count as stable.
RINGING = 0.5
EXPLICIT = ("rk2", "semi_implicit_euler")
#: Released chain: steps [s], simulated time [s], largest velocity at the start [m/s].
FREE_STEPS, FREE_SPAN, SWING = (1e-3, 5e-4, 2.5e-4), 10.0, 0.5


def schemes(case: Callable[[int, float], Scene]) -> Iterator[Found]:
    """One row per damping ratio, and one of the released chain, printed as they come."""
    for ratio in RATIOS:
        yield _driven(driven_chain(case(1, ratio), SMOOTH), ratio)
    yield _released(case(1, 0.0))


def _driven(scene: Scene, ratio: float) -> Found:
    base = Ours.of(scene)

    def runner(name: str) -> Ours:
        return Ours(make_stepper(base.model, name, track_work=False), base.model, base.start)

    reference = runner("rk4").run(REFERENCE, SPAN)
    found = {"damping_ratio": ratio, "reference": reference.statistics(SETTLED)}
    for name in EXPLICIT:
        ours = runner(name)
        rows, count = [], None
        for count in COUNTS:
            errors = _errors(ours.run(count, SPAN), reference, RINGING)
            if errors is not None:
                rows.append({"dt_s": SAMPLE / count, **errors})
            if len(rows) == 2:
                break
        found[name] = {"largest_stable_dt_s": rows[0]["dt_s"] if rows else None, "rows": rows}
    smallest = min(found[name]["largest_stable_dt_s"] for name in EXPLICIT)
    common = [c for c in COUNTS if SAMPLE / c <= 0.5 * smallest][0]
    for name in EXPLICIT:
        found[name]["common"] = {"dt_s": SAMPLE / common, **_errors(runner(name).run(common, SPAN), reference)}
    found["energy_momentum"] = {"dt_s": SAMPLE / 5, **_errors(base.run(5, SPAN), reference)}
    return found


def _errors(run: Rows, reference: Rows, limit: float = np.inf) -> dict[str, float] | None:
    """Relative errors of the fairlead tension; None where the run is not stable, or off by more than the limit."""
    if run.status != "ok" or not np.all(np.isfinite(run.mean)):
        return None
    a, b = (rows.statistics(SETTLED)["fairlead"] for rows in (run, reference))
    found = {key: abs(a[key] / b[key] - 1.0) for key in ("mean", "std")}
    return {**found, "cpu_per_s": run.cpu_s / SPAN} if max(found.values()) < limit else None


def _released(base: Scene) -> Found:
    """Change of energy of the chain without damper or water between fixed ends, set swinging across its plane."""
    table = driven_chain(base, SMOOTH).to_dict()
    table["effects"] = {"weight": {"gravity": table.pop("sea").get("gravity", 9.81)}}
    table["line"][0]["axial"].pop("damping", None)
    table["point"][1]["position"] = [40.0, 0.0, -2.0]
    model, s = build(Scene.from_dict({**table, "name": "released-chain"}))
    nodes = s.r.shape[0]
    s = replace(s, v=s.v.at[:, 1].set(SWING * np.sin(np.pi * np.arange(1, nodes + 1) / (nodes + 1))))
    rows = []
    for name in (*EXPLICIT, "energy_momentum"):
        stepper = make_stepper(model, name, track_work=False)
        run = jax.jit(partial(integrate, stepper), static_argnames=("steps", "save_every"))
        for dt in FREE_STEPS:
            steps = round(FREE_SPAN / dt)
            path = run(model, s, dt, steps=steps, save_every=steps // 100)[1]
            t = dt * (steps // 100) * np.arange(1, 101)
            seen = jax.vmap(partial(observe, model))(path.r, path.v, t)
            energy = np.asarray(seen.kinetic + seen.potential)
            first = observe(model, s.r, s.v, s.t)
            change = (energy - float(first.kinetic + first.potential)) / float(first.kinetic)
            largest = float(np.max(np.abs(change)))
            rows.append({"scheme": name, "dt_s": dt, "end": float(change[-1]), "largest": largest})
    return {"released": rows}
