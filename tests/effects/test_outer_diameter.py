"""Outer diameter of lines: drag and added mass use it, buoyancy does not."""

import copy

import jax
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax import build_model

#: Half-grown mussel dropper (Zhu et al. 2020), its displaced diameter at 1300 kg/m^3.
OUTER, DISPLACED, MASS, CDN = 0.13, 0.0859, 7.53, 1.3
LOW = free("low", 0.0, 0.0, -9.0, mass=1.0, volume=0.0)
CROP = {"name": "crop", "mass": MASS, "diameter": DISPLACED, "EA": 4e5, "cdn": CDN, "cdt": 0.02, "can": 1.0, "cat": 0.1}
ROPE = {"name": "rope", "mass": 0.5, "diameter": 0.03, "EA": 4e5, "cdn": 1.2, "cdt": 0.0, "can": 1.1, "cat": 0.0}
SCENE = system(
    [fixed("left", 0.0, 0.0, -5.0), LOW, fixed("right", 4.0, 0.0, -5.0)],
    [line_of("dropper", "left", "low", 4, 4.0, type="crop"), line_of("rope", "low", "right", 3, 6.0, type="rope")],
    line_type=[CROP, ROPE],
    sea={"depth": 20.0, "current": {"kind": "power", "speed": 0.5, "direction": 0.5 * np.pi, "exponent": 0.0}},
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
)


def instant(crop: dict[str, float]):
    """Model and instant of the droppers with other values of the crop; all nodes move at 0.3 m/s."""
    scene = copy.deepcopy(SCENE)
    scene["line_type"][0] |= crop
    model = build_model(dj.load_scene(scene))
    geometry = model.geometry
    r = np.zeros((geometry.free, 3))
    for path, ends in zip(geometry.paths, ([[0, 0, -5], [0, 0, -9]], [[0, 0, -9], [4, 0, -5]]), strict=True):
        free = path < geometry.free
        r[path[free]] = np.linspace(*np.array(ends, float), len(path))[free]
    return model, model.instant(r, 0.3 * np.ones_like(r), 0.0)


def forces(crop: dict[str, float]) -> list[np.ndarray]:
    """Forces, and inertia forces of unit accelerations."""
    model, k = instant(crop)
    return [np.asarray(x) for x in evaluate(model, k.r, k.v)]


@jax.jit
def evaluate(model, r, v):
    k = model.instant(r, v, 0.0)
    return model.force(k), model.inertia(k, 0 * r + 1.0)


@pytest.mark.parametrize("outer", [OUTER, DISPLACED])
def test_drag_and_added_mass_scale_with_the_outer_diameter_buoyancy_does_not(outer):
    ratio = outer / DISPLACED
    scaled = {"cdn": CDN * ratio, "cdt": 0.02 * ratio, "can": ratio**2, "cat": 0.1 * ratio**2}
    for found, same, without in zip(forces({"outer_diameter": outer}), forces(scaled), forces({}), strict=True):
        np.testing.assert_allclose(found, same, rtol=1e-12, atol=1e-12)
        assert np.any(np.abs(found - without) > 0.1) == (outer == OUTER)


def test_outer_diameter_survives_the_plain_form_and_needs_a_displaced_one(refusal):
    scene = copy.deepcopy(SCENE)
    scene["line_type"][0]["outer_diameter"] = OUTER
    loaded = dj.load_scene(scene)
    again = dj.load_scene(loaded.to_dict())
    np.testing.assert_array_equal(again.line.outer_diameter, [OUTER] * 4 + [0.03] * 3)
    own = line_of("line", "a", "b", 2, 1.0, mass=1.0, outer_diameter=0.1)
    bare = system([fixed("a", 0.0, 0.0, 0.0), free("b", 2.0, 0.0, 0.0)], [own])
    assert "line.0.outer_diameter: needs `diameter`" in refusal(dj.load_scene, bare)
