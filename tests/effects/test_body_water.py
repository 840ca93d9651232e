"""Drag, added mass and waves on bodies: coupled eigenvalues, decay and wave response against independent equations."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, line_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import dropper_jax as dj
from dropper_jax import build_model, equilibrium, mooring_stiffness, natural_modes

RHO, G = 1025.0, 9.81
D, H, DRAUGHT, KG, AREA = 1.0, 9.0, 5.0, 2.0, np.pi / 4
MASS = RHO * AREA * DRAUGHT
TURNED = MASS * H**2 / 12.0
END = RHO * 2.0 / 3.0 * np.pi * (D / 2) ** 3


@pytest.mark.check
def test_coupled_surge_heave_and_pitch_of_a_moored_spar(spar):
    """A rope of EA from below to the base, taut: 3 x 3 eigenvalues by hand, added mass Can = 1 and Cat = 1 stated."""
    length, stiffness, pull = 30.0, 4.0e4, 4000.0
    draught = DRAUGHT + pull / (RHO * G * AREA)
    scene = spar(attachments={"base": [0.0, 0.0, 0.0]}, coefficients={"cat": 1.0}, slices=90)
    tight = length / (1.0 + pull / stiffness)
    own = {"mass": 1e-3, "diameter": 1e-3, "axial": {"law": "rope", "EA": stiffness}}
    scene |= {"point": [fixed("anchor", 0.0, 0.0, -draught - length)], "start": {"kind": "static"}}
    scene["line"] = [line_of("rope", "anchor", "base", 1, tight, **own)]
    pose = equilibrium(scene)
    model = build_model(dj.load_scene(scene))
    base, axes = model.constraints[0].pose(model, pose.state.r)
    assert pose.status == "ok"
    assert base[0, 2] == pytest.approx(-draught, rel=1e-6)
    # about the base: x of the base, z, pitch
    added = RHO * AREA * draught
    inertia = np.zeros((3, 3))
    inertia[0, 0], inertia[1, 1] = MASS + added, MASS + END
    inertia[0, 2] = inertia[2, 0] = MASS * KG + added * draught / 2
    inertia[2, 2] = TURNED + MASS * KG**2 + added * draught**2 / 3
    displaced = RHO * AREA * draught
    upright = G * (displaced * (draught / 2 + (D**2 / 16) / draught) - MASS * KG)
    spring = np.diag([pull / length, RHO * G * AREA + stiffness / tight, upright])
    own = mooring_stiffness(model, pose.state, ["float"]).matrix[np.ix_([0, 2, 4], [0, 2, 4])]
    np.testing.assert_allclose(own, spring, rtol=2e-3, atol=1e-3 * np.min(np.diag(spring)))
    expected = 2 * np.pi / np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia, spring)).real)
    modes = natural_modes(model, pose.state)
    # sway and roll have the periods of surge and pitch, and any mixture of a pair is a mode
    for period in expected:
        assert np.sum(np.abs(modes.period / period - 1.0) < 2e-3) >= 1, period


@pytest.mark.check
def test_heave_decays_as_its_equation_predicts(spar):
    scene = spar(coefficients={"cat": 1.0, "cdt": 5.0}, position=(0.0, 0.0, -4.2), slices=8)
    solution = dj.simulate({**scene, "run": {"dt": 0.02, "duration": 20.0}})
    heave = solution.body("float")["body_position"][:, 2] + DRAUGHT

    def rates(_, y):
        drag = -0.5 * RHO * 5.0 * AREA * abs(y[1]) * y[1]
        return [y[1], (-RHO * G * AREA * y[0] + drag) / (MASS + END)]

    expected = solve_ivp(rates, (0.0, 20.0), [0.8, 0.0], rtol=1e-9, atol=1e-10, t_eval=solution.t).y[0]
    assert solution.status == "ok"
    assert np.max(np.abs(heave - expected)) < 0.01 * 0.8
    assert solution.energy_drift < 1e-6 * solution.energy_scale


@pytest.mark.check
def test_spar_in_small_waves_pitches_and_surges_as_its_linear_equations_say(spar):
    """`(-w^2 M + C) x = f` of a free spar, f from the wave's accelerations over its length."""
    amplitude, period, depth = 0.01, 6.0, 100.0
    sea = {"waves": {"kind": "regular", "amplitude": amplitude, "period": period}, "stretching": "none", "ramp": 60.0}
    scene = spar(coefficients={"cat": 1.0, "cdn": 0.0}, sea=sea, slices=20)
    scene["body"][0]["cylinders"][0]["cdn"] = 0.0
    solution = dj.simulate({**scene, "run": {"dt": 0.05, "duration": 120.0}})
    omega = 2 * np.pi / period
    k = brentq(lambda k: G * k * np.tanh(k * depth) - omega**2, 1e-3, 2.0)
    z = -DRAUGHT + (np.arange(400) + 0.5) / 400 * DRAUGHT
    speed = amplitude * omega**2 * np.cosh(k * (z + depth)) / np.sinh(k * depth)  # of sin(w t) at x = 0
    added, cell = RHO * AREA * DRAUGHT, RHO * AREA * DRAUGHT / 400
    force = 2.0 * cell * np.array([np.sum(speed), np.sum(speed * (z + DRAUGHT))])
    between = MASS * KG + added * DRAUGHT / 2
    turned = TURNED + MASS * KG**2 + added * DRAUGHT**2 / 3
    inertia = np.array([[MASS + added, between], [between, turned]])
    restoring = np.diag([0.0, MASS * G * (DRAUGHT / 2 + D**2 / 16 / DRAUGHT - KG)])
    expected = np.linalg.solve(restoring - omega**2 * inertia, force)
    late = solution.t > 84.0
    t, moved = solution.t[late], solution.body("float")

    def first_harmonic(x):
        columns = np.stack([np.cos(omega * t), np.sin(omega * t), np.ones_like(t), t], axis=1)
        return np.hypot(*np.linalg.lstsq(columns, x[late], rcond=None)[0][:2])

    assert solution.status == "ok"
    assert first_harmonic(moved["body_attitude"][:, 1]) == pytest.approx(abs(expected[1]), rel=0.02)
    assert first_harmonic(moved["body_position"][:, 0]) == pytest.approx(abs(expected[0]), rel=0.02)


@pytest.mark.check
def test_drag_of_a_towed_sphere(afloat):
    """A neutral sphere in a current: `(m + m_a) v' = 1/2 rho Cd A |u - v| (u - v)`."""
    radius, current = 0.5, 1.2
    volume = 4 / 3 * np.pi * radius**3
    scene = afloat(
        {"spheres": [{"centre": [0, 0, 0], "diameter": 2 * radius, "cd": 0.6, "ca": 0.5}]},
        mass=RHO * volume,
        centre=(0, 0, 0),
        inertia=(50.0, 50.0, 50.0),
        position=(0.0, 0.0, -20.0),
        sea={"current": {"kind": "uniform", "speed": current}},
    )
    solution = dj.simulate({**scene, "run": {"dt": 0.02, "duration": 10.0}})
    rate = 0.5 * RHO * 0.6 * np.pi * radius**2 / (1.5 * RHO * volume)
    expected = current - current / (1.0 + rate * current * solution.t)
    assert solution.status == "ok"
    np.testing.assert_allclose(solution.body("float")["body_velocity"][:, 0], expected, atol=2e-3 * current)


@pytest.mark.check
def test_gradient_of_a_spar_in_waves_against_differences(spar, slopes_of):
    sea = {"waves": {"kind": "regular", "amplitude": 0.8, "period": 6.0}}
    model, start = dj.build(spar(attitude=[0.02, 0.2, 0.0], slices=3, coefficients={"cdt": 1.0, "cat": 1.0}, sea=sea))
    stepper, water = dj.make_stepper(model).plain, model.effect("body_water")

    def lean(given):
        drag, added = given
        own = {"body_water": replace(water, cdn=drag, can=added)}
        changed = replace(model, effects=tuple(own.get(e.name, e) for e in model.effects))
        last, _ = dj.integrate(stepper, changed, start, dt=0.05, steps=10)
        return jnp.sum(last.r[-4:] * jnp.arange(12.0).reshape(4, 3))

    slopes_of(lean, (water.cdn, water.can), floor=1.0)


def test_shape_needs_water(spar, refusal):
    scene = spar()
    del scene["sea"]
    assert "body.0: 'float' has cylinders" in refusal(dj.load_scene, scene)
