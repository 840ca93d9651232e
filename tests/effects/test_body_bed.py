"""Contact of bodies with the seabed: depths by geometry, forces by differences, a drum and a ball at rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import by_a_rope

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.effects.body_bed import BodyBed

RHO, G, DEPTH = 1025.0, 9.81, 20.0
SOFT = 1e5


def scene(attitude=(0.0, 0.0, 0.0), height=-19.0, **body):
    """A drum of 1 m diameter and 2 m length along its x axis, heavier than water, beside a light rope."""
    drum = {"name": "drum", "position": [0.0, 0.0, height], "attitude": list(attitude), "touches_bed": True}
    drum |= {"mass": 3000.0, "centre_of_mass": [0.0, 0.0, 0.0], "inertia": [400.0, 1200.0, 1200.0]}
    drum["cylinders"] = [{"from": [-1.0, 0.0, 0.0], "to": [1.0, 0.0, 0.0], "diameter": 1.0, "slices": 4}]
    effects = {"weight": {"gravity": G}, "seabed": {"stiffness": SOFT, "damping": 5e4}}
    run, sea = {"dt": 0.02, "duration": 12.0}, {"depth": DEPTH, "density": RHO}
    return by_a_rope({**drum, **body}, run=run, sea=sea, effects=effects)


def contact(table):
    model = build_model(dj.load_scene(table))
    effect = next(e for e in model.effects if isinstance(e, BodyBed))
    start = jnp.asarray(dj.build(table)[1].r)
    return model, effect, start


@pytest.mark.parametrize(
    ("attitude", "deepest"),
    [
        ((0.0, 0.0, 0.0), 0.5),
        ((0.0, 0.3, 0.0), np.sin(0.3) + 0.5 * np.cos(0.3)),
        ((0.4, -0.7, 1.1), np.sin(0.7) + 0.5 * np.cos(0.7)),
        ((0.0, np.pi / 2, 0.0), 1.0),
    ],
)
def test_the_deepest_point_is_that_of_the_turned_drum(attitude, deepest):
    model, effect, start = contact(scene(attitude))
    assert float(jnp.max(effect.depths(model, start))) == pytest.approx(deepest - 1.0, abs=6e-3)


@pytest.mark.parametrize("attitude", [(0.0, 0.3, 0.0), (0.4, -0.7, 1.1)])
def test_forces_at_rest_are_the_slope_of_the_springs_energy(attitude):
    model, effect, start = contact(scene(attitude, height=-19.4))
    half = effect.pieces.radius * effect.pieces.length
    area = jnp.concatenate([half, half])

    @jax.jit
    def energy(r):
        return 0.5 * SOFT * jnp.sum(area * jnp.maximum(effect.depths(model, r), 0.0) ** 2)

    force = jax.jit(lambda r: effect.force(model.instant(r, jnp.zeros_like(r), 0.0)))
    way = jax.random.normal(jax.random.PRNGKey(1), start.shape)
    step = 1e-6
    slope = (energy(start + step * way) - energy(start - step * way)) / (2 * step)
    assert float(jnp.sum(force(start) * way)) == pytest.approx(-float(slope), rel=1e-6)


@pytest.mark.check
def test_a_drum_that_sinks_comes_to_rest_on_the_bed():
    ran = dj.simulate(scene((0.0, 0.1, 0.0), height=-18.5), halvings=0)
    weight = G * (3000.0 - RHO * np.pi / 4 * 2.0)
    deep = weight / (SOFT * 1.0 * 2.0)  # over its plan area D L
    assert ran.status == "ok"
    assert ran.body_position[-1, 0, 2] == pytest.approx(-DEPTH + 0.5 - deep, abs=1e-3)
    assert ran.body_attitude[-1, 0, 1] == pytest.approx(0.0, abs=1e-3)
    # what touches down loses energy and never gains any
    total = ran.kinetic + ran.potential - ran.work.sum(axis=1)
    assert np.ptp(total) < 1e-3 * np.max(ran.kinetic)


def test_touching_needs_a_bed_and_a_shape(refusal):
    table = scene()
    del table["effects"]["seabed"]
    assert "body.0.touches_bed: 'drum' lacks [effects.seabed]" in refusal(dj.load_scene, table)
    assert "body.0.touches_bed: 'drum' lacks cylinders or spheres" in refusal(dj.load_scene, scene(cylinders=[]))
    kept = dj.load_scene(scene())
    assert dj.load_scene(kept.to_dict()) == kept
    assert "touches_bed" not in dj.load_scene(scene(touches_bed=False)).to_dict()["body"][0]
