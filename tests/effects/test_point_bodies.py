"""Bodies at points: weight, buoyancy and drag of a clump or float, closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj

RHO, G, MASS, VOLUME, DRAG_AREA, ADDED = 1025.0, 9.81, 100.0, 0.02, 0.3, 0.7


@pytest.fixture
def body(one_line, in_water):
    """`body(z)`: the model of a body at the free end of a line, at height z, and one instant with its water."""

    def make(z, v=0.0, volume=VOLUME):
        thread = {"mass": 1e-3, "diameter": 1e-3, "EA": 1e3}
        scene = one_line(10.0, 2, [0.0, 0.0, -2.0], [8.0, 0.0, z], thread, {"weight": {}})
        values = {"mass": MASS, "volume": volume, "drag_area": DRAG_AREA, "added_mass": ADDED}
        scene["point"][1] |= {"kind": "free", **values}
        scene["sea"] = {"depth": 50.0, "density": RHO}
        scene["start"] = {"kind": "points"}
        model, s = dj.build(scene)
        end = model.geometry.point_node[1]
        return model, in_water(model, s.r, s.v.at[end, 0].set(v), s.t), end

    return make


#: A body in the surface is half wet, by symmetry.
HEIGHTS = pytest.mark.parametrize(("z", "wet"), [(-10.0, 1.0), (0.0, 0.5), (10.0, 0.0)])


@HEIGHTS
def test_a_body_has_its_weight_less_that_of_the_water_it_displaces(body, z, wet):
    model, k, end = body(z)
    force = np.asarray(model.effect("point_bodies").force(k))
    np.testing.assert_allclose(force[end], [0.0, 0.0, (wet * RHO * VOLUME - MASS) * G], rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(np.delete(force, end, axis=0), 0.0)


def test_a_body_in_still_water_is_braked_by_half_rho_cda_u2_and_carries_added_mass(body):
    model, k, end = body(-10.0, v=0.8)
    effect = model.effect("point_bodies")
    assert float(effect.force(k)[end, 0]) == pytest.approx(-0.5 * RHO * DRAG_AREA * 0.8**2, rel=1e-9)
    a = jnp.ones_like(k.r)
    assert float(effect.inertia(k, a)[end, 1]) == pytest.approx(RHO * VOLUME * ADDED, rel=1e-12)
    assert float(effect.point_mass(model)[end]) == MASS


@HEIGHTS
def test_water_brakes_a_body_without_volume_only_where_it_is_under_water(body, z, wet):
    model, k, end = body(z, v=0.8, volume=0.0)
    drag = float(model.effect("point_bodies").force(k)[end, 0])
    assert drag == pytest.approx(-wet * 0.5 * RHO * DRAG_AREA * 0.8**2, rel=1e-9)


@pytest.mark.parametrize("radius", [0.0, 0.005, 0.3])
def test_the_contact_area_of_a_body_is_that_of_a_sphere_of_any_size(body, radius):
    model, _, end = body(-10.0, volume=4.0 / 3.0 * np.pi * radius**3)
    area = model.effect("point_bodies").contact_area(model)
    assert float(area[end]) == pytest.approx(np.pi * radius**2, rel=1e-12)
