"""Every effect has derivatives held against differences, a row in `dropper cost`, a place in the docs, a hard case.

Of effects that scenes name and of those that come with bodies, vessels and buoys: one added later fails here until it
has them.
"""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_cases import sticky
from hard_scenes import BED
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax import build, build_model
from dropper_jax.effects import EFFECTS
from dropper_jax.stability import all_cases
from dropper_jax.stability.case import scene_of as hard_scene
from dropper_jax.study.cost import model_variants

ROOT = Path(__file__).parents[1]
PACKAGED = [name for name, cls in EFFECTS.items() if cls.__module__.startswith("dropper_jax.")]
#: Effects that no `[effects.NAME]` makes, and the docs' word for them.
MADE = {
    "rigid_bodies": "[[body]]",
    "body_buoyancy": "body_buoyancy",
    "body_water": "body_water",
    "body_bed": "body_bed",
    "vessel_motion": "[[vessel]]",
    "spar_buoys": "[[buoy]]",
    "point_bodies": "added_mass",
}
ALL = [*PACKAGED, *MADE]
CASES = {case.name: case for case in all_cases()}
#: Hard cases whose scenes have the effect.
HARD = {
    "weight": "strong-current",
    "linear_damping": "heavy-damping-position",
    "quadratic_damping": "quadratic-damping-fast",
    "joint_friction": "dry-friction-two-joints",
    "end_motion": "clamped-rod",
    "buoyancy": "strong-current",
    "morison_drag": "flow-coefficients",
    "morison_inertia": "pendulum-in-waves",
    "seabed": "bed-impact-depth",
    "seabed_friction": "stick-slip",
    "bending": "clamped-rod",
    "line_contact": "rope-on-rope",
    "torsion": "twisted-rod",
    "rigid_bodies": "pinned-arm",
    "body_buoyancy": "dropped-spar",
    "body_water": "dropped-spar",
    "body_bed": "sliding-drum",
    "spar_buoys": "buoy-under",
    "point_bodies": "many-floats",
}
#: Effects that push or move points as prescribed, or repeat a source: no hard case of their own, but a scene.
PRESCRIBED = (
    "clamp_motion",
    "nodal_force",
    "recorded_motion",
    "sea_following_end",
    "thesis_wave_force",
    "vessel_motion",
)
#: Those whose derivatives have a test of their own too, or take long.
CHECKED = ("bending", "body_bed", "body_buoyancy", "body_water", "buoyancy", "end_motion", "joint_friction", "torsion")
CHECKED += ("line_contact", "morison_drag", "morison_inertia", "rigid_bodies", "seabed_friction", "sea_following_end")
ROPE = {"length": 20.0, "mass": 20.0, "diameter": 0.05, "axial": {"law": "rope", "EA": 1e6}}
TIMES = [0.0, 0.5, 1.0, 1.5, 2.0]


def recorded():
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [0.6, 0.0, 0.0]}],
        "line": [{"name": "loop", "from": "a", "to": "b", "links": 4, "length": 0.3, "mass": 0.1}],
        "effects": {
            "weight": {},
            "recorded_motion": {"points": ["a"], "time": TIMES, "positions": [[t * t, 0.1 * t, 0] for t in TIMES]},
        },
    }


def pushed():
    force = {"nodes": [2, 3], "force_n": [[0.1, 0.0, 0.3], [0.0, 0.2, 0.1]], "time": [0.0, 0.5, 1.0]}
    return {**recorded(), "effects": {"weight": {}, "nodal_force": {**force, "scale": [0.0, 1.0, 0.5]}}}


def clamped():
    directions = [[np.cos(0.2 * t), 0.1, np.sin(0.2 * t)] for t in TIMES]
    clamp = {
        "point": "a",
        "time": TIMES,
        "direction": [(d / np.linalg.norm(d)).tolist() for d in directions],
    }
    return {**recorded(), "effects": {"weight": {}, "bending": {"EI": 0.02}, "clamp_motion": clamp}}


def vessel():
    rao = {"frequency": [0.4, 1.2], "headings": [0.0], "phases": "lead", "heave": [1.0, 0.5], "heave_phase": [0.0, 0.4]}
    rao |= {"pitch": [0.02, 0.03], "pitch_phase": [0.1, 0.2]}
    return {
        "run": {"dt": 0.05, "duration": 1.0},
        "point": [{"name": "anchor", "position": [0.0, 0.0, -15.0]}],
        "line": [{"name": "rope", "from": "anchor", "to": "fairlead", "links": 4, "nodes": "shared", **ROPE}],
        "vessel": [
            {"name": "barge", "position": [5.0, 0.0, 0.0], "attachments": {"fairlead": [2.0, 1.0, 1.0]}, "rao": rao}
        ],
        "sea": {"depth": 15.0, "ramp": 0.5, "waves": {"kind": "regular", "amplitude": 0.4, "period": 8.0}},
        "effects": {"weight": {}},
    }


def scene_of(name: str) -> dj.Scene:
    """A scene that has the effect."""
    if name in HARD:
        return sticky([0.3, 0.2]) if name == "joint_friction" else hard_scene(CASES[HARD[name]].scene)
    made = {"clamp_motion": clamped, "nodal_force": pushed, "recorded_motion": recorded, "vessel_motion": vessel}
    scene = made.get(name)
    packaged = {"sea_following_end": "platform-longline", "thesis_wave_force": "dropper-north-sea-thesis"}
    return dj.load_scene(packaged[name] if scene is None else scene())


@cache
def model_of(name: str) -> dj.Model:
    """Its model; the start, which takes longer, only where it is needed."""
    return build_model(scene_of(name))


def touching(name: str, r: jax.Array) -> jax.Array:
    """Places at which what touches does touch, a little."""
    if name in ("seabed", "seabed_friction"):
        return r.at[:, 2].add(-BED - 1e-3 - jnp.min(r[:, 2]))
    if name == "line_contact":  # the rope that falls, next to the one it falls on
        return r.at[:, 2].add(jnp.where(r[:, 2] > 0.5, -0.97, 0.0))
    return r


def answers(model, e, leaves, r, v, a, law, kept):
    """All that an effect gives a step: forces, inertia, rows of its unknowns, moved ends, own state; flat."""
    parts = jax.tree.flatten(e)
    changed = jax.tree.unflatten(parts[1], leaves)
    model = replace(model, effects=tuple(changed if other is e else other for other in model.effects))
    model = model.with_internal_state(kept)
    k = model.instant(r, v, jnp.asarray(0.7))
    found = [model.force(k), model.inertia(k, a), model.ends(0.7).positions, model.ends(0.7).velocities]
    for one, z in zip(model.laws, law, strict=False):
        found += [one.law_force(k, z), one.law_residual(k, z, jnp.asarray(0.01))]
    for tie in model.constraints:
        found.append(tie.gap(model, r))
    if kept:
        found.append(jax.tree.leaves(model.advance_internal_state(k, k, jnp.ones(model.line.links), jnp.asarray(0.01))))
    return ravel_pytree(found)[0]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.check] if name in CHECKED else []) for name in ALL]
)
def test_its_derivatives_are_those_of_differences(name):
    model, s = build(scene_of(name))
    e = next(e for e in model.effects if e.name == name)
    rng = np.random.default_rng(3)
    shaken = lambda x, size: jnp.asarray(x + size * rng.normal(size=np.shape(x)))  # noqa: E731
    r, v, a = shaken(touching(name, s.r), 3e-4), shaken(s.v, 0.2), shaken(s.v, 1.0)
    law = tuple(shaken(z, 1.0) for z in s.law)
    leaves = jax.tree.leaves(e)
    inputs = [jnp.asarray(leaf, float) for leaf in leaves], r, v
    # what no step differentiates by: times of tables, and what a scheme holds while it solves
    way = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)) * jnp.maximum(jnp.abs(x), 1e-3), inputs)
    if name == "recorded_motion":
        way[0][next(i for i, leaf in enumerate(leaves) if np.array_equal(leaf, TIMES))] *= 0.0
    give = jax.jit(lambda x: answers(model, e, x[0], x[1], x[2], a, law, s.own))
    across = jnp.asarray(rng.normal(size=jax.eval_shape(give, inputs).shape))

    @jax.jit
    def value_and_both_modes(x):  # one program: three would be compiled one by one
        value, forward = jax.jvp(give, (x,), (way,))
        return value, forward, jax.vjp(give, x)[1](across)[0]

    _, forward, back = jax.tree.map(np.asarray, value_and_both_modes(inputs))
    best = np.inf
    for step in (1e-5, 1e-6, 1e-7):
        moved = (jax.tree.map(lambda x, w, h=h: x + h * w, inputs, way) for h in (step, -step))
        above, below = (value_and_both_modes(x)[0] for x in moved)
        slope = np.asarray(above - below) / (2.0 * step)
        best = min(best, np.max(np.abs(forward - slope)) / np.max(np.abs(slope)))
    assert np.max(np.abs(forward)) > 0.0
    assert best < 1e-6
    both = sum(float(np.sum(g * w)) for g, w in zip(jax.tree.leaves(back), jax.tree.leaves(way), strict=True))
    assert both == pytest.approx(float(across @ forward), rel=1e-9)


@pytest.mark.parametrize("name", ALL)
def test_it_keeps_single_precision(name):
    model = build_model(scene_of(name), "float32")
    places = jax.ShapeDtypeStruct((model.free_nodes, 3), jnp.float32)
    force = jax.eval_shape(lambda r, v: model.force(model.instant(r, v, jnp.float32(0.7))), places, places)
    assert force.dtype == jnp.float32


@pytest.mark.parametrize("name", ALL)
def test_it_has_a_row_of_costs(name):
    model = model_of(name)
    rows = [row.removeprefix("without ") for row, _ in model_variants(model)]
    assert (name in rows) != bool(
        model.constraints and name == model.constraints[0].name
    )  # bodies without it would be four masses


def test_every_effect_has_a_hard_case_in_the_catalogue():
    assert set(HARD).isdisjoint(PRESCRIBED)
    assert {*HARD, *PRESCRIBED} == set(ALL)
    assert [case for case in HARD.values() if case not in CASES] == []
    assert [name for name in HARD if name not in {e.name for e in model_of(name).effects}] == []


@cache
def pages() -> str:
    return "\n".join(p.read_text() for p in sorted((ROOT / "docs").glob("*.md")) if p.name != "reference.md")


@pytest.mark.parametrize("name", ALL)
def test_the_docs_speak_of_it(name):
    word = MADE.get(name, name)
    assert re.search(rf"`{re.escape(word)}`|\[effects\.{re.escape(word)}\]|{re.escape(word)}\b", pages())
