"""Buoyancy of bodies: volumes by brute force, metacentres by naval architecture, energy in calm water."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import build, build_model, equilibrium
from dropper_jax.effects.hydrostatics import Cylinders, sphere_energy, sphere_volume

RHO, G = 1025.0, 9.81


def brute(first, last, level, radius, count=300):
    """`int max(level - z, 0) dV` of a cylinder by midpoints."""
    axis = last - first
    length = np.linalg.norm(axis)
    axis = axis / length
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    middles = (np.arange(count) + 0.5) / count
    angle = 2 * np.pi * middles
    section = radius * np.sqrt(middles)[:, None] * (side[2] * np.cos(angle) + other[2] * np.sin(angle))
    z = first[2] + length * axis[2] * middles[:, None, None] + section[None]
    return np.mean(np.maximum(level - z, 0.0)) * np.pi * radius**2 * length


@pytest.mark.parametrize("axis", [(0.3, -0.2, 0.9), (0.9, 0.1, 0.2), (1.0, 0.0, 0.01), (0.6, 0.6, -0.5)])
def test_energy_of_a_cut_cylinder_is_that_of_its_volume(axis):
    ends = np.stack([-np.array(axis), np.array(axis)]) + [0.3, 0.1, -0.1]
    length = np.linalg.norm(ends[1] - ends[0])
    found = Cylinders.of(jnp.asarray(ends)[None], jnp.array([0.05]), jnp.array([0.4]), jnp.array([length])).energy()[0]
    assert found == pytest.approx(brute(*ends, 0.05, 0.4), rel=2e-5)


@pytest.mark.parametrize("tilt", [0.0, 1e-7, 1e-3, 0.4, np.pi / 2 - 1e-3, np.pi / 2])
def test_forces_and_stiffness_of_a_cylinder_are_derivatives_of_its_energy(tilt):
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    x = np.concatenate([-0.7 * axis, 1.1 * axis]) + np.tile([0.0, 0.0, -0.05], 2)
    args = jnp.zeros(1), jnp.array([0.5]), jnp.array([1.8])
    cut = jax.jit(lambda x, level=0.0: Cylinders.of(x.reshape(1, 2, 3), level + args[0], *args[1:]))
    energy, push = (lambda x: float(cut(x).energy()[0])), (lambda x: np.ravel(cut(x).push()))
    way, step = np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.3]), 1e-5
    slope = (energy(x + step * way) - energy(x - step * way)) / (2 * step)
    assert -push(x) @ way == pytest.approx(slope, rel=1e-7, abs=1e-9)
    change = (push(x + step * way) - push(x - step * way)) / (2 * step)
    np.testing.assert_allclose(jax.jvp(lambda x: cut(x).push().ravel(), (x,), (way,))[1], change, rtol=1e-5, atol=1e-6)
    level = [float(cut(x, side * step).energy()[0]) for side in (-1, 1)]
    assert cut(x).volume()[0] == pytest.approx((level[1] - level[0]) / (2 * step), rel=1e-7)


@pytest.mark.parametrize("deep", [-0.6, -0.3, 0.0, 0.2, 0.45, 0.8])
def test_energy_of_a_cut_sphere(deep):
    z = np.linspace(-0.5, 0.5, 20001)
    expected = np.trapezoid(np.maximum(deep - z, 0.0) * np.pi * (0.25 - z**2), z)
    sphere = jnp.array([[0.0, 0.0, -deep]]), jnp.zeros(1), jnp.array([0.5])
    assert sphere_energy(*sphere)[0] == pytest.approx(expected, abs=1e-8)
    volume = np.trapezoid(np.where(z < deep, np.pi * (0.25 - z**2), 0.0), z)
    assert sphere_volume(*sphere)[0] == pytest.approx(volume, abs=1e-4)


def test_a_body_in_calm_water_floats_at_the_level_of_the_sea(spar):
    def lift(height, **sea):
        model, state = build(spar(sea=sea))
        k = model.instant(state.r.at[:, 2].add(height), state.v, jnp.asarray(900.0))
        return model.effect("body_buoyancy").force(k)

    tide = {"offset": 0.5, "amplitude": [1.0], "period": [3600.0], "phase": [0.5 * np.pi]}  # 1.5 m at 900 s
    np.testing.assert_allclose(lift(1.5, level=tide), lift(0.0), atol=1e-6)


def righting(scene, tilt=1e-3):
    """Righting arm over the tilt [m]: GM of a body that floats in its scene, turned about x."""
    model = build_model(dj.load_scene(scene))
    start = np.asarray(equilibrium(scene).state.r)
    corners = model.constraints[0].body_nodes(model).ravel()
    centre = np.array(scene["body"][0]["centre_of_mass"])
    shares = np.append(centre, 1.0) @ np.asarray(model.constraints[0].affine[0])
    middle = shares @ start[corners]

    def potential(angle):
        c, s = jnp.cos(angle), jnp.sin(angle)
        turn = jnp.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        r = jnp.asarray(start).at[corners].set((start[corners] - middle) @ turn.T + middle)
        return model.potential_energy(model.instant(r, jnp.zeros_like(r), 0.0))

    mass = scene["body"][0]["mass"]
    return float(jax.jit(jax.grad(potential))(tilt)) / (mass * G * np.sin(tilt))


@pytest.mark.check
def test_metacentric_height_of_a_flat_cylinder(afloat):
    """D/h = 3: GM = KB + BM - KG, BM = D^2/(16 T)."""
    diameter, height, density = 3.0, 1.0, 0.6
    mass, draught, gravity = density * RHO * np.pi / 4 * diameter**2 * height, density * height, 0.45
    shape = {"cylinders": [{"from": [0, 0, 0], "to": [0, 0, height], "diameter": diameter}]}
    turned = {"centre": (0.0, 0.0, gravity), "inertia": (500.0, 500.0, 900.0)}
    scene = afloat(shape, mass=mass, **turned, position=(0.0, 0.0, -0.5))
    pose = equilibrium(scene)
    model = build_model(dj.load_scene(scene))
    assert model.constraints[0].pose(model, pose.state.r)[0][0, 2] == pytest.approx(-draught, rel=1e-6)
    expected = draught / 2 + diameter**2 / (16.0 * draught) - gravity
    assert righting(scene) == pytest.approx(expected, rel=1e-4)


@pytest.mark.check
def test_metacentric_heights_of_a_lying_drum(afloat):
    """Half under water: across GM = a - KG from the axis (its sections are circles), along BM = I_y/V."""
    radius, length, below = 0.5, 2.0, 0.1
    mass = RHO * np.pi * radius**2 * length / 2
    for axis, waterplane in (((1, 0, 0), length * (2 * radius) ** 3 / 12), ((0, 1, 0), 2 * radius * length**3 / 12)):
        half = 0.5 * length * np.array(axis)
        shape = {"cylinders": [{"from": list(-half), "to": list(half), "diameter": 2 * radius}]}
        scene = afloat(shape, mass=mass, centre=(0.0, 0.0, -below), inertia=(300.0, 300.0, 300.0))
        centroid = -4 * radius / (3 * np.pi)
        assert righting(scene) == pytest.approx(centroid + waterplane / (mass / RHO) + below, rel=1e-4)


@pytest.mark.check
def test_homogeneous_spar_capsizes_and_floats_on_its_side(spar):
    scene = spar(centre=4.5, attitude=[0.0, 0.05, 0.0])
    model = build_model(dj.load_scene(scene))
    pose = equilibrium(scene)
    assert pose.status == "ok"
    assert abs(model.constraints[0].pose(model, pose.state.r)[1][0, 2, 2]) < 1e-3  # its axis is level


@pytest.mark.check
def test_floating_body_keeps_its_energy_in_calm_water(spar):
    still = {"can": 0.0, "cdn": 0.0}
    scene = spar(attitude=[0.05, 0.3, 0.0], coefficients=still, position=(0, 0, -4.5), slices=4)
    solution = dj.simulate({**scene, "run": {"dt": 0.02, "duration": 20.0}})
    assert solution.status == "ok"
    assert np.ptp(solution.body("float")["body_attitude"][:, 1]) > 0.4
    assert solution.energy_drift < 1e-9 * solution.energy_scale


@pytest.mark.check
def test_gradient_of_a_rocking_spar_against_differences(spar, slopes_of):
    model, start = build(spar(attitude=[0.02, 0.3, 0.0], slices=2))
    stepper = dj.make_stepper(model).plain
    buoyancy = model.effect("body_buoyancy")

    def lean(radius):
        pieces = replace(buoyancy.pieces, radius=radius)
        changed = tuple(replace(e, pieces=pieces) if e.name == "body_buoyancy" else e for e in model.effects)
        last, _ = dj.integrate(stepper, replace(model, effects=changed), start, dt=0.05, steps=10)
        return jnp.sum(last.r[-4:] * jnp.arange(12.0).reshape(4, 3))

    slopes_of(lean, buoyancy.pieces.radius, 1e-5)


@pytest.mark.check
def test_second_derivatives_of_the_buoyancy_of_cylinders_under_in_and_above_the_surface_are_finite_and_exact():
    ends = np.array([[[0, 0, -5], [0.3, 0, -3]], [[0, 0, -1.2], [0.9, 0, 1]], [[0, 0, 2], [1, 0, 2.05]]], float)
    length = jnp.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))

    def lift(z):
        moved = jnp.asarray(ends).at[1, 1, 2].add(z)
        return jnp.sum(Cylinders.of(moved, jnp.zeros(3), jnp.full(3, 0.5), length).push()[..., 2])

    slope = jax.grad(lift)
    expected = (slope(1e-5) - slope(-1e-5)) / 2e-5
    assert abs(expected) > 0.01
    assert float(jax.grad(slope)(0.0)) == pytest.approx(float(expected), rel=1e-6)
