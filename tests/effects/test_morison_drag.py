"""Morison's drag and inertia by definition; terminal speed, angle in a current, turning points, frozen tangents."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.effects import MorisonDrag

RHO, G = 1000.0, 9.81
LOOSE = {"axial": {"law": "elastic", "EA": 1e-12}}


def test_forced_cylinder_meets_morisons_drag_and_inertia_across_and_along(hanging, in_water):
    waves = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}
    effects = {"morison_drag": {"cdn": 1.3, "cdt": 0.2}, "morison_inertia": {"can": 0.9, "cat": 0.3}}
    model, state = dj.build(hanging({"weight": {}, **effects}, {"waves": waves}, links=3, length=2.0))
    rng = np.random.default_rng(0)
    r = np.asarray(state.r) + rng.normal(size=(3, 3))
    v, t, D, L = rng.normal(size=(3, 3)), 1.3, 0.05, 2.0
    k = in_water(model, r, v, t)
    water = model.sea.at(jnp.asarray(r), jnp.asarray(t))
    links = np.diff(np.concatenate([[[0.0, 0.0, -5.0]], r]), axis=0)
    for i in range(3):
        q = links[i] / np.linalg.norm(links[i])
        u, a = np.asarray(water.velocity[i]) - v[i], np.asarray(water.acceleration[i])
        un, ut = u - (u @ q) * q, (u @ q) * q
        an, at = a - (a @ q) * q, (a @ q) * q
        drag = 0.5 * RHO * L * D * (1.3 * np.linalg.norm(un) * un + 0.2 * np.pi * np.linalg.norm(ut) * ut)
        np.testing.assert_allclose(model.effect("morison_drag").force(k)[i], drag, rtol=1e-8)
        inertia = RHO * np.pi / 4 * D**2 * L * (1.9 * an + 1.3 * at)
        np.testing.assert_allclose(model.effect("morison_inertia").force(k)[i], inertia, rtol=1e-8)


def test_a_falling_node_reaches_terminal_speed_as_tanh(hanging, runs):
    """`v = v_t tanh(t/tau)`: w = 1/2 rho pi D L Cdt v_t^2 along the link, tau = (m + m_a) v_t / w."""
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.5}}
    effects["morison_inertia"] = {"can": 1.0, "cat": 0.7}
    scene = hanging(effects, {}, **LOOSE)
    _, found = runs(scene, 0.002, 1000, "energy_momentum_4", every=100)
    volume = np.pi / 4 * 0.05**2
    w = 10.0 * G - RHO * G * volume
    top = np.sqrt(w / (0.5 * RHO * np.pi * 0.05 * 0.5))
    tau = (10.0 + 0.7 * RHO * volume) * top / w
    t = 0.2 * np.arange(1, 11)
    np.testing.assert_allclose(found.v[:, 0, 2], -top * np.tanh(t / tau), rtol=1e-8)


def test_a_free_ended_line_in_a_uniform_current_hangs_straight_at_the_angle_of_the_balance(hanging):
    effects = {"weight": {"wet_weight": 4.0}, "morison_drag": {"cdn": 1.1, "cdt": 0.02}}
    scene = hanging(effects, {"current": {"speed": 0.4, "direction": 1.0}}, links=8, start={"kind": "static"})
    pose = dj.equilibrium(scene)
    assert pose.status == "ok"
    kappa = RHO * 1.1 * 0.05 * 0.4**2 / (2 * 4.0)
    sine = (np.sqrt(1 + 4 * kappa**2) - 1) / (2 * kappa)
    links = np.diff(pose.positions, axis=0)
    expected = [sine * np.cos(1.0), sine * np.sin(1.0), -np.sqrt(1 - sine**2)]
    np.testing.assert_allclose(links, np.tile(expected, (8, 1)), atol=1e-10)


def test_the_quadratically_damped_pendulum_keeps_its_integral_at_turning_points(hanging, runs):
    """`q'' + sin q + c |q'| q' = 0`: `(cos q +- 2c sin q) exp(-+2 c q)` is equal at successive turning points."""
    effects = {"weight": {}, "morison_drag": {"cdn": 2.0}}
    scene = hanging(effects, {}, mass=100.0, start={"kind": "angles", "zero": "down", "polar": [1.2]})
    c = 0.5 * RHO * 2.0 * 0.05 / 100.0
    turns = []
    for dt, steps in ((1e-3, 6000), (5e-4, 12000)):
        model, found = runs(scene, dt, steps)
        q = np.arctan2(np.asarray(found.r[:, 0, 0]), -5.0 - np.asarray(found.r[:, 0, 2]))
        rate = (found.v[:, 0, 0] * np.cos(q) + found.v[:, 0, 2] * np.sin(q)) / 1.0
        i = np.flatnonzero(rate[:-1] * rate[1:] < 0)[:2]
        share = rate[i] / (rate[i] - rate[i + 1])
        # between the samples: cubic Hermite, since the angle is stationary there
        smooth = (q[i + 1] - q[i]) * (3 * share**2 - 2 * share**3)
        turns.append(q[i] + smooth + dt * share * (1 - share) * (rate[i] * (1 - share) - rate[i + 1] * share))
    first, second = (4 * turns[1] - turns[0]) / 3

    def integral(q, c):
        return (np.cos(q) + 2 * c * np.sin(q)) * np.exp(-2 * c * q)

    assert integral(1.2, c) - integral(first, c) == pytest.approx(0.0, abs=1e-8)
    assert integral(first, -c) - integral(second, -c) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.check
def test_frozen_and_implicit_directions_agree_to_second_order(hanging, march):
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.02}}
    start = {"kind": "angles", "zero": "down", "polar": [0.9, 0.7, 0.4, 0.2]}
    scene = hanging(effects, {"current": {"speed": 0.5}}, links=4, start=start)
    model, state = dj.build(scene)
    effects = (replace(e, tangents="implicit") if isinstance(e, MorisonDrag) else e for e in model.effects)
    solvers = {"condensed": model, "banded": replace(model, effects=tuple(effects))}
    pairs = [(m, dj.make_stepper(m, solver=solver, halvings=0)) for solver, m in solvers.items()]
    gaps = []
    for steps in (50, 100):
        ends = [march(stepper, m, state, 1.0, steps)[0] for m, stepper in pairs]
        gaps.append(float(np.max(np.abs(ends[0] - ends[1]))))
    assert gaps[0] < 5e-3
    assert gaps[0] / gaps[1] > 3.0
