"""The paper's cases and a driven chain in MoorDyn v2 and here: motions, tensions, conventions, and speed on one thread.

    python benchmarks/against_moordyn.py [--only case_4|cases|step_sizes|schemes|speed|peaks]
        [--peaks hard|case_1|case_3|edulis]

Needs the extra `moordyn`; takes about 15 minutes, a few more with the explicit schemes,
an hour more with peaks, of which `--peaks` measures one scene.

Writes results/moordyn.json and prints what it finds. Both codes start
from the paper's positions. MoorDyn's component waves (WaveKin 7) carry no dynamic pressure: an upright cylinder held
in place then feels almost no heave force (measured in phase with the wave: -3 N where theory has 383 N, 374 N with a
wave grid). Motions and tensions are therefore compared on its wave grid (WaveKin 3); component waves are for speed
only.

`schemes`: semi-implicit Euler against rk2 on the elastic chain, as the paper discusses them, and the implicit default.
The chain of case 1 (12 segments, EA 4.9e7 N), its top driven gently, one row per internal damping ratio: the largest
stable step of each scheme, and what it makes of mean and standard deviation of the fairlead tension at half of the
smaller one. Then the same chain without water or damper, set swinging across its plane: change of energy over its
kinetic energy at the start.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from moordyn_runs import GRID, SAMPLE, STEPS, TABLE_7, Ours, case, theirs
from moordyn_speed import PEAKS, SMOOTH, driven_chain, errors, peaks, speed
from study import Found, collect, command, describe, versions

from dropper_jax import (
    Kinematics,
    Scene,
    build,
    build_model,
    component,
    equilibrium,
    integrate,
    load_scene,
    make_stepper,
)
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.sea import Motion
from dropper_jax.stepping.observe import observe

# [s]: the whole run, and from where on it counts as settled
SPAN = 150.0
SETTLED = 50.0
EVERY = 5  # our steps in 0.1 s: dt = 0.02 s
#: Our steps in 0.1 s for the comparison of step sizes: dt = 0.05, 0.02, 0.01 and, as reference, 0.001 s.
STEP_COUNTS = (2, 5, 10, 100)
#: Numbers of links for the chain that reaches above the water.
FINER = (24, 96)
#: Schemes: runs of the driven chain and of the released one [s].
SHORT_SPAN = 30.0
FREE_SPAN = 10.0
#: Steps in 0.1 s that are tried, from large steps to small ones; rk4 at the last one is the reference.
COUNTS = (10, 20, 40, 50, 60, 70, 80, 100, 120, 150, 200, 300, 400, 600, 800, 1200, 1600)
#: A run whose deviation is off by more than this rings at its limit and does not count as stable.
RINGING = 0.5
EXPLICIT = ("rk2", "semi_implicit_euler")
#: Released chain: steps [s], and the largest velocity at the start [m/s].
FREE_STEPS = (1e-3, 5e-4, 2.5e-4)
SWING = 0.5


def both(number: int, ratio: float) -> Found:
    """One case in both codes: statistics of the whole run and of its settled part."""
    scene = case(number, ratio)
    runs = {
        "ours": Ours.of(scene).run(EVERY, SPAN),
        "moordyn": theirs(scene, STEPS[ratio], SPAN, look=0.01, across=GRID),
    }
    found = {name: {"whole": rows.statistics(), "settled": rows.statistics(SETTLED)} for name, rows in runs.items()}
    return {"case": number, "damping_ratio": ratio, **found}


def step_sizes(ratio: float) -> list[Found]:
    """Case 1 here at several steps: mean anchor tension after SETTLED, and its difference from the smallest step's."""
    ours = Ours.of(case(1, ratio))
    settled = {every: ours.run(every, SPAN).statistics(SETTLED) for every in STEP_COUNTS}
    right = settled[STEP_COUNTS[-1]]["anchor"]["mean"]
    return [
        {
            "damping_ratio": ratio,
            "dt_s": SAMPLE / every,
            **row,
            "mean_against_smallest_step": row["anchor"]["mean"] / right - 1.0,
        }
        for every, row in settled.items()
    ]


@component
class SurfaceCurrent(SparBuoys):
    """The whole buoy feels the current at the surface."""

    def prepare(self, k: Kinematics) -> Motion:
        return _everywhere(self, k, super().prepare(k), surface=True)


@component
class BaseCurrent(SparBuoys):
    """The whole buoy feels the current at its base."""

    def prepare(self, k: Kinematics) -> Motion:
        return _everywhere(self, k, super().prepare(k), surface=False)


def _everywhere(buoys: SparBuoys, k: Kinematics, around: Motion, surface: bool) -> Motion:
    r = k.r[buoys.nodes(k.model)]
    if surface:
        height = jnp.zeros_like(r[:, 2])
    else:
        height = r[:, 2] - buoys.attachment
    u = k.model.sea.at(r.at[:, 2].set(height), k.t).velocity
    return around._replace(velocity=jnp.broadcast_to(u[:, None, :], around.velocity.shape))


def static_tension(scene: Scene, buoys: type[SparBuoys] = SparBuoys) -> float:
    """Static tension at the anchor [N]."""
    model = build_model(scene)
    swapped = tuple(
        buoys(**{f.name: getattr(e, f.name) for f in fields(e)}) if isinstance(e, SparBuoys) else e
        for e in model.effects
    )
    pose = equilibrium(replace(model, effects=swapped))
    if pose.status == "ok":
        return float(pose.tension[0])
    return float("nan")


def conventions() -> Iterator[Found]:
    """Rows of the table."""
    scene = load_scene("paper-case-4")
    centre = scene.with_values({"buoy.0.attachment": 0.5 * scene.buoys[0].height})
    variants = {
        "chain at the base, current over the draught, axial drag on pi D": (scene,),
        "buoy feels the current at the surface": (scene, SurfaceCurrent),
        "buoy feels the current at its base": (scene, BaseCurrent),
        "axial drag of the chain on D": (scene.with_values({"line_type.chain.cdt": 0.2 / np.pi}),),
        "chain at half the buoy's height": (centre,),
        # the point is then above the water: how much of the last link is wet depends on the number of links
        **{f"the same, {links} links": (centre.with_values({"line.chain.links": links}),) for links in FINER},
    }
    for name, given in variants.items():
        yield {"convention": name, "anchor_n": static_tension(*given)}
    last = theirs(scene.with_values({"start.kind": "points"}), 0.0005, 300.0)
    if last.status == "ok":
        value = float(np.mean(last.mean[-100:, 0]))
    else:
        value = float("nan")
    yield {"convention": "MoorDyn v2, after 300 s", "anchor_n": value}


def scheme_row(ratio: float) -> Found:
    """The driven chain: what each scheme makes of it."""
    base = Ours.of(driven_chain(case(1, ratio), SMOOTH))
    runners = {
        name: replace(base, stepper=make_stepper(base.model, name, track_work=False)) for name in ("rk4", *EXPLICIT)
    }
    reference = runners["rk4"].run(COUNTS[-1], SHORT_SPAN)

    def errors_of(ours: Ours, count: int) -> Found | None:
        return errors(ours.run(count, SHORT_SPAN), reference)

    def is_stable(ours: Ours, count: int) -> bool:
        found = errors_of(ours, count)
        return bool(found and max(found["mean"], found["std"]) < RINGING)

    found: Found = {"damping_ratio": ratio, "energy_momentum": errors_of(base, EVERY)}
    largest = {name: next(n for n in COUNTS if is_stable(runners[name], n)) for name in EXPLICIT}
    common = next(count for count in COUNTS if count >= 2 * max(largest.values()))
    for name, count in largest.items():
        found[name] = {
            "largest_stable_dt_s": SAMPLE / count,
            "common": {"dt_s": SAMPLE / common, **errors_of(runners[name], common)},
        }
    return found


def released() -> Found:
    """Change of energy of the chain without damper or water between fixed ends, set swinging across its plane."""
    table = driven_chain(case(1, 0.0), SMOOTH).to_dict()
    table["effects"] = {"weight": {"gravity": table.pop("sea").get("gravity", 9.81)}}
    table["line"][0]["axial"].pop("damping", None)
    table["point"][1]["position"] = [40.0, 0.0, -2.0]
    model, s = build(Scene.from_dict({**table, "name": "released-chain"}))
    nodes = s.r.shape[0]
    s = replace(s, v=s.v.at[:, 1].set(SWING * np.sin(np.pi * np.arange(1, nodes + 1) / (nodes + 1))))
    first = observe(model, s.r, s.v, s.t)
    rows = []
    for name in (*EXPLICIT, "energy_momentum"):
        stepper = make_stepper(model, name, track_work=False)
        run = jax.jit(partial(integrate, stepper), static_argnames=("steps", "save_every"))
        for dt in FREE_STEPS:
            steps = round(FREE_SPAN / dt)
            path = run(model, s, dt, steps=steps, save_every=steps // 100)[1]
            seen = jax.vmap(partial(observe, model))(path.r, path.v, FREE_SPAN * np.arange(1, 101) / 100)
            change = (seen.kinetic + seen.potential - first.kinetic - first.potential) / first.kinetic
            rows.append({"scheme": name, "dt_s": dt, "largest": float(jnp.max(jnp.abs(change)))})
    return {"released": rows}


@command(only=(None, "case_4", "cases", "step_sizes", "schemes", "speed", "peaks"), peaks=(None, *PEAKS))
def main(given) -> None:
    parts = {
        "case_4": conventions(),
        "cases": (
            both(number, ratio) for number, ratio in [*((1, ratio) for ratio in STEPS), (2, 0.1), (3, 0.1), (5, 0.1)]
        ),
        "step_sizes": (row for ratio in STEPS for row in step_sizes(ratio)),
        "schemes": (make() for make in (*(partial(scheme_row, ratio) for ratio in STEPS), released)),
        "speed": speed(),
    }
    packages = versions("moordyn", "jax", "dropper-jax", "numpy")
    head = {"schema": 1, "machine": describe(), "versions": packages, "table_7": TABLE_7}
    collect("moordyn", parts, given.only, **head)
    if given.only in (None, "peaks"):
        collect("moordyn", {"peaks": peaks(given.peaks)}, by="name", **head)
