"""The paper's cases and a driven chain in MoorDyn v2 and here: motions, tensions, conventions, and speed on one thread.

    python benchmarks/against_moordyn.py [--only case_4|cases|step_sizes|schemes|speed|peaks]
        [--peaks hard|case_1|case_3]

Needs the extra `moordyn`; takes about 15 minutes, a few more with the explicit schemes,
an hour more with peaks, of which `--peaks` measures one scene.

Writes results/moordyn.json and prints what it finds. Both codes start
from the paper's positions. MoorDyn's component waves (WaveKin 7) carry no dynamic pressure: an upright cylinder held
in place then feels almost no heave force (measured in phase with the wave: -3 N where theory has 383 N, 374 N with a
wave grid). Motions and tensions are therefore compared on its wave grid (WaveKin 3); component waves are for speed
only.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from collections.abc import Iterator
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
from explicit_schemes import schemes
from moordyn_runs import GRID, TABLE_7, Ours, case, theirs
from moordyn_speed import PEAKS, peaks, speed
from study import Found, collect, command, describe, versions

from dropper_jax import Kinematics, Scene, component, load_scene
from dropper_jax.effects.spar_buoys import Around, SparBuoys
from dropper_jax.run.build import build_model
from dropper_jax.statics.static_pose import equilibrium

SPAN, SETTLED = 150.0, 50.0  # [s]: the whole run, and from where on it counts as settled
RATIOS = (1.0, 0.1, 0.0)
EVERY = 5  # our steps in 0.1 s: dt = 0.02 s
#: Our steps in 0.1 s for the comparison of step sizes: dt = 0.05, 0.02, 0.01 and, as reference, 0.001 s.
STEP_COUNTS = (2, 5, 10, 100)
#: MoorDyn's step [s] for each internal damping ratio: stronger dampers need smaller ones.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}
#: Numbers of links for the chain that reaches above the water.
FINER = (24, 96)


def both(number: int, ratio: float) -> Found:
    """One case in both codes: statistics of the whole run and of its settled part."""
    scene = case(number, ratio)
    here = Ours.of(scene).run(EVERY, SPAN)
    there = theirs(scene, STEPS[ratio], SPAN, look=0.01, across=GRID)
    found = {"case": number, "damping_ratio": ratio}
    for name, rows, dt in (("ours", here, 0.1 / EVERY), ("moordyn", there, STEPS[ratio])):
        found[name] = {
            "dt_s": dt,
            "wall_s": rows.wall_s,
            "whole": rows.statistics(),
            "settled": rows.statistics(SETTLED),
        }
    return found


def step_sizes(ratio: float) -> list[Found]:
    """Case 1 here at several steps: mean anchor tension after SETTLED, and its difference from the smallest step's."""
    ours = Ours.of(case(1, ratio))
    rows = []
    for every in STEP_COUNTS:
        run = ours.run(every, SPAN)
        settled = run.statistics(SETTLED)
        rows.append({"damping_ratio": ratio, "dt_s": 0.1 / every, "wall_s": run.wall_s, **settled})
    for row in rows:
        row["mean_against_smallest_step"] = row["anchor"]["mean"] / rows[-1]["anchor"]["mean"] - 1.0
    return rows


@component
class SurfaceCurrent(SparBuoys):
    """The whole buoy feels the current at the surface."""

    def prepare(self, k: Kinematics) -> Around:
        return _everywhere(self, k, super().prepare(k), surface=True)


@component
class BaseCurrent(SparBuoys):
    """The whole buoy feels the current at its base."""

    def prepare(self, k: Kinematics) -> Around:
        return _everywhere(self, k, super().prepare(k), surface=False)


def _everywhere(buoys: SparBuoys, k: Kinematics, around: Around, surface: bool) -> Around:
    r = k.r[buoys.nodes(k.model)]
    height = jnp.zeros_like(r[:, 2]) if surface else r[:, 2] - buoys.attachment
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
    return float(pose.tension[0]) if pose.status == "ok" else float("nan")


def _with_links(table: Found, links: int) -> Scene:
    """The scene of these plain values with another number of links of the same line."""
    line = dict(table["line"][0])
    share = line["links"] / links
    axial = {**line["axial"], "damping": line["axial"]["damping"] * share}
    line |= {"links": links, "length": line["length"] * share, "mass": line["mass"] * share, "axial": axial}
    effects = {name: {key: _one(value) for key, value in values.items()} for name, values in table["effects"].items()}
    return Scene.from_dict({**table, "line": [line], "effects": effects})


def _one(value):
    """One number of a list of equal ones, which then serves any number of links."""
    return value[0] if isinstance(value, list) else value


def conventions() -> Iterator[Found]:
    """Rows of the table."""
    scene = load_scene("paper-case-4")
    on_diameter = np.asarray(scene.effects["morison_drag"]["cdt"]) / np.pi
    centre = scene.with_values({"buoy.0.attachment": 0.5 * scene.buoys[0].height})
    variants = {
        "chain at the base, current over the draught, axial drag on pi D": lambda: static_tension(scene),
        "buoy feels the current at the surface": lambda: static_tension(scene, SurfaceCurrent),
        "buoy feels the current at its base": lambda: static_tension(scene, BaseCurrent),
        "axial drag of the chain on D": lambda: static_tension(
            scene.with_values({"effects.morison_drag.cdt": on_diameter})
        ),
        "chain at half the buoy's height": lambda: static_tension(centre),
    }
    # the point is then above the water: how much of the last link is wet depends on the number of links
    table = centre.to_dict()
    for links in FINER:
        fine = _with_links(table, links)
        variants[f"the same, {links} links"] = lambda fine=fine: static_tension(fine)
    for name, tension in variants.items():
        yield {"convention": name, "anchor_n": tension()}
    last = theirs(scene.with_values({"start.kind": "points"}), 0.0005, 300.0)
    value = float(np.mean(last.mean[-100:, 0])) if last.status == "ok" else float("nan")
    yield {"convention": "MoorDyn v2, after 300 s", "anchor_n": value}


@command(only=(None, "case_4", "cases", "step_sizes", "schemes", "speed", "peaks"), peaks=(None, *PEAKS))
def main(given) -> None:
    parts = {
        "case_4": conventions(),
        "cases": (
            both(number, ratio) for number, ratio in [*((1, ratio) for ratio in RATIOS), (2, 0.1), (3, 0.1), (5, 0.1)]
        ),
        "step_sizes": (row for ratio in RATIOS for row in step_sizes(ratio)),
        "schemes": schemes(case),
        "speed": speed(case),
        "peaks": peaks(case, given.peaks),
    }
    packages = versions("moordyn", "jax", "dropper-jax", "numpy")
    collect("moordyn", parts, given.only, schema=1, machine=describe(), versions=packages, table_7=TABLE_7)
