"""Forces of the water against closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.effects import MorisonDrag

RHO, G = 1000.0, 9.81


def hanging(effects: dict, sea: dict, length=1.0, mass=10.0, diameter=0.05, links=1, start=None, **line) -> dict:
    """A line of `links` from (0, 0, -5) straight down, its end free."""
    return {
        "run": {"dt": 0.001, "duration": 1.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, -5.0]},
            {"name": "end", "kind": "free", "position": [0.0, 0.0, -5.0 - length * links]},
        ],
        "line": [
            {"name": "line", "from": "top", "to": "end", "links": links, "length": length, "mass": mass}
            | ({} if diameter is None else {"diameter": diameter})
            | line
        ],
        "effects": effects,
        "start": start or {"kind": "angles", "zero": "down", "polar": [0.0] * links},
        "sea": {"depth": 50.0, "density": RHO, **sea},
    }


LOOSE = {"axial": {"law": "elastic", "EA": 1e-12}}


@partial(jax.jit, static_argnames=("stepper", "steps", "every"))
def run(stepper, model, state, dt, steps, every=1):
    return dj.integrate(stepper, model, state, dt, steps, save_every=every)


def runs(scene: dict, dt: float, steps: int, integrator="energy_momentum", every=1):
    model, state = dj.build(scene)
    return model, run(dj.make_stepper(model, integrator, halvings=0, extra=0), model, state, dt, steps, every)[1]


def kinematics(model, r, v, t):
    """One instant with its water."""
    k = model.kinematics(jnp.asarray(r), jnp.asarray(v), jnp.asarray(t))
    return model.kinematics(k.r, k.v, k.t, prepared=model.prepare(k))


def test_forced_cylinder_meets_morisons_equation_across_and_along():
    waves = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}
    effects = {"weight": {}, "morison_drag": {"cdn": 1.3, "cdt": 0.2}, "morison_inertia": {"can": 0.9, "cat": 0.3}}
    model, state = dj.build(hanging(effects, {"waves": waves}, links=3, length=2.0))
    rng = np.random.default_rng(0)
    r = np.asarray(state.r) + rng.normal(size=(3, 3))
    v, t, D, L = rng.normal(size=(3, 3)), 1.3, 0.05, 2.0
    k = kinematics(model, r, v, t)
    water = model.sea.at(jnp.asarray(r), jnp.asarray(t))
    links = np.diff(np.concatenate([[[0.0, 0.0, -5.0]], r]), axis=0)
    for i in range(3):
        q = links[i] / np.linalg.norm(links[i])
        u, a = np.asarray(water.velocity[i]) - v[i], np.asarray(water.acceleration[i])
        un, ut = u - (u @ q) * q, (u @ q) * q
        an, at = a - (a @ q) * q, (a @ q) * q
        drag = 0.5 * RHO * L * D * (1.3 * np.linalg.norm(un) * un + 0.2 * np.pi * np.linalg.norm(ut) * ut)
        inertia = RHO * np.pi / 4 * D**2 * L * (1.9 * an + 1.3 * at)
        np.testing.assert_allclose(model.effect("morison_drag").force(k)[i], drag, rtol=1e-8)
        np.testing.assert_allclose(model.effect("morison_inertia").force(k)[i], inertia, rtol=1e-8)


def test_forced_oscillation_in_still_water_costs_morisons_force():
    """Cylinder on `x = A sin wt`: drag -1/2 rho D L Cd x'|x'|, added mass -rho V Ca x'' (and no rho V of its own)."""
    effects = {"weight": {}, "morison_drag": {"cdn": 1.2}, "morison_inertia": {"can": 0.8}}
    model, state = dj.build(hanging(effects, {}))
    A, w = 0.3, 2.0
    for t in np.linspace(0.0, 3.0, 7):
        v, a = A * w * np.cos(w * t), -A * w**2 * np.sin(w * t)
        k = kinematics(model, state.r, [[v, 0.0, 0.0]], t)
        drag = -0.5 * RHO * 0.05 * 1.2 * abs(v) * v
        assert float(model.effect("morison_drag").force(k)[0, 0]) == pytest.approx(drag, rel=1e-8)
        found = model.effect("morison_inertia").inertia(k, jnp.array([[a, 0.0, 0.0]]))[0, 0]
        assert float(found) == pytest.approx(RHO * np.pi / 4 * 0.05**2 * 0.8 * a, rel=1e-8, abs=1e-12)
        assert float(model.effect("morison_inertia").force(k)[0, 0]) == 0.0


def test_a_falling_node_reaches_terminal_speed_as_tanh():
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


def test_a_free_ended_line_in_a_uniform_current_hangs_straight_at_the_angle_of_the_balance():
    effects = {"weight": {"wet_weight": 4.0}, "morison_drag": {"cdn": 1.1, "cdt": 0.02}}
    scene = hanging(effects, {"current": {"speed": 0.4, "direction": 1.0}}, links=8, start={"kind": "static"})
    pose = dj.equilibrium(scene)
    assert pose.status == "ok"
    kappa = RHO * 1.1 * 0.05 * 0.4**2 / (2 * 4.0)
    sine = (np.sqrt(1 + 4 * kappa**2) - 1) / (2 * kappa)
    links = np.diff(pose.positions, axis=0)
    expected = [sine * np.cos(1.0), sine * np.sin(1.0), -np.sqrt(1 - sine**2)]
    np.testing.assert_allclose(links, np.tile(expected, (8, 1)), atol=1e-10)


def test_the_quadratically_damped_pendulum_keeps_its_integral_at_turning_points():
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
        d = q[i + 1] - q[i]
        h = share
        turns.append(
            q[i] + d * (3 * h**2 - 2 * h**3) + dt * (rate[i] * h * (1 - h) ** 2 - rate[i + 1] * h**2 * (1 - h))
        )
    first, second = (4 * turns[1] - turns[0]) / 3

    def integral(q, c):
        return (np.cos(q) + 2 * c * np.sin(q)) * np.exp(-2 * c * q)

    assert integral(1.2, c) - integral(first, c) == pytest.approx(0.0, abs=1e-8)
    assert integral(first, -c) - integral(second, -c) == pytest.approx(0.0, abs=1e-8)


def test_wet_pendulum_has_the_period_of_added_mass_and_buoyancy():
    effects = {"weight": {}, "buoyancy": {}, "morison_inertia": {"can": 1.2, "cat": 1.2}}
    scene = hanging(effects, {}, start={"kind": "angles", "zero": "down", "polar": [1e-3]}, mass=5.0)
    dt = 1e-3
    _, found = runs(scene, dt, 12000)
    x = np.asarray(found.r[:, 0, 0])
    i = np.flatnonzero(x[:-1] * x[1:] < 0)
    t = dt * (i + 1 + x[i] / (x[i] - x[i + 1]))
    volume = np.pi / 4 * 0.05**2
    exact = 2 * np.pi * np.sqrt((5.0 + 1.2 * RHO * volume) / ((5.0 - RHO * volume) * G))
    assert (t[-1] - t[-3]) == pytest.approx(exact, rel=1e-6)


def particle(form: str) -> dict:
    volume = np.pi / 4 * 0.2**2
    waves = {"kind": "regular", "amplitude": 0.5, "period": 8.33}
    effects = {"weight": {}, "buoyancy": {}}
    effects["morison_inertia"] = {"can": 1.0, "cat": 1.0, "fluid_acceleration": form}
    scene = hanging(
        effects, {"depth": 30.0, "stretching": "none", "waves": waves}, diameter=0.2, mass=RHO * volume, **LOOSE
    )
    model, _ = dj.build(scene)
    at = np.asarray(model.sea.at(jnp.array([[0.0, 0.0, -6.0]]), jnp.array(0.0)).velocity)
    scene["start"] = {
        "kind": "positions",
        "positions": [[0, 0, -5.0], [0, 0, -6.0]],
        "velocities": [[0, 0, 0], at[0].tolist()],
    }
    return scene


def test_a_neutral_particle_stays_with_the_water_only_with_the_material_acceleration():
    period, steps = 8.33, 8000
    dt = 10 * period / steps
    strays = {}
    for form in ("material", "local"):
        model, found = runs(particle(form), dt, steps, "energy_momentum_4", every=steps // 10)
        strays[form] = np.asarray(found.r[:, 0])

    def water(r, t):
        return model.sea.at(r[None], t)[1][0]

    def rk4(r, i):
        t = i * dt
        a = water(r, t)
        b = water(r + 0.5 * dt * a, t + 0.5 * dt)
        c = water(r + 0.5 * dt * b, t + 0.5 * dt)
        d = water(r + dt * c, t + dt)
        return r + dt / 6 * (a + 2 * b + 2 * c + d), None

    last, _ = jax.jit(lambda r: jax.lax.scan(rk4, r, jnp.arange(steps)))(jnp.array([0.0, 0.0, -6.0]))
    assert np.linalg.norm(strays["material"][-1] - last) < 1e-6
    assert np.linalg.norm(strays["local"][-1] - last) == pytest.approx(11.8, abs=0.1)


def test_a_node_out_of_the_water_has_its_dry_weight_back_and_a_deep_one_its_wet_weight():
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0}, "morison_inertia": {"can": 1.0}}
    model, state = dj.build(hanging(effects, {}))
    volume = np.pi / 4 * 0.05**2
    for z, lift in ((5.0, 0.0), (-7.0, RHO * G * volume)):
        k = kinematics(model, [[0.0, 0.0, z]], [[1.0, 0.0, 0.0]], 0.0)
        assert float(model.effect("buoyancy").force(k)[0, 2]) == pytest.approx(lift, rel=1e-12)
        drag = np.asarray(model.effect("morison_drag").force(k)[0])
        assert np.all(drag == 0.0) if z > 0 else drag[0] < 0.0


def test_volume_follows_from_dry_and_wet_weight():
    scene = hanging({"weight": {}, "buoyancy": {"wet_weight": 60.0}}, {}, diameter=None)
    model, state = dj.build(scene)
    k = kinematics(model, state.r, state.v, 0.0)
    assert float(model.force(k)[0, 2]) == pytest.approx(-60.0, rel=1e-12)
    assert float(model.line.volume[0]) == pytest.approx((10.0 * G - 60.0) / (RHO * G), rel=1e-12)


def test_compound_links_share_the_water_forces_between_their_nodes():
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.1}, "morison_inertia": {"can": 1.0}}
    line = {"centre_of_mass": 0.5, "inertia": 10.0 / 12}
    model, state = dj.build(hanging(effects, {"current": {"speed": 1.0}}, links=3, **line))
    point, _ = dj.build(hanging(effects, {"current": {"speed": 1.0}}, links=3))
    shares = np.array([1.0, 1.0, 0.5])
    for name in ("buoyancy", "morison_drag", "morison_inertia"):
        whole = point.effect(name).force(kinematics(point, state.r, state.v, 0.0))
        parts = model.effect(name).force(kinematics(model, state.r, state.v, 0.0))
        np.testing.assert_allclose(parts, shares[:, None] * whole, atol=1e-10)


def test_the_thesis_force_is_that_of_the_water_at_the_origin_on_every_node():
    waves = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}
    scene = hanging({"weight": {}, "thesis_wave_force": {"c_d": 2.0, "c_m": 1.5}}, {"waves": waves}, links=2)
    model, state = dj.build(scene)
    water = model.sea.at(jnp.zeros((1, 3)), jnp.array(1.3))
    u, a = np.asarray(water.velocity[0]), np.asarray(water.acceleration[0])
    force = np.pi / 4 * RHO * 0.05**2 * 1.5 * a + 0.5 * RHO * 0.05 * 2.0 * np.abs(u) * u
    found = model.effect("thesis_wave_force").force(kinematics(model, state.r, state.v + 3.0, 1.3))
    np.testing.assert_allclose(found, [force, force], rtol=1e-12)


def test_an_end_that_follows_the_sea_moves_with_the_water_at_the_surface():
    waves = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}
    scene = hanging(
        {"weight": {}, "sea_following_end": {"point": "top"}}, {"waves": waves, "ramp": 2.0, "stretching": "none"}
    )
    scene["point"][0]["position"], scene["point"][1]["position"] = [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]
    model, _ = dj.build(scene)
    place, t = jnp.zeros((1, 3)), jnp.array(5.0)
    ends = model.ends(t)
    np.testing.assert_allclose(ends.start[2], model.sea.elevation(place, t)[0], atol=1e-12)
    np.testing.assert_allclose(ends.start_velocity, model.sea.at(place, t).velocity[0], atol=1e-12)
    assert np.all(np.asarray(model.ends(jnp.array(0.0)).start) == 0.0)


def test_frozen_and_implicit_directions_agree_to_second_order(march):
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.02}}
    start = {"kind": "angles", "zero": "down", "polar": [0.9, 0.7, 0.4, 0.2]}
    scene = hanging(effects, {"current": {"speed": 0.5}}, links=4, start=start)
    model, state = dj.build(scene)
    implicit = replace(
        model,
        effects=tuple(replace(e, tangents="implicit") if isinstance(e, MorisonDrag) else e for e in model.effects),
    )
    pairs = [
        (m, dj.make_stepper(m, solver=solver, halvings=0, extra=0))
        for m, solver in ((model, "condensed"), (implicit, "banded"))
    ]
    gaps = []
    for steps in (50, 100):
        ends = [march(stepper, m, state, 1.0, steps)[0] for m, stepper in pairs]
        gaps.append(float(np.max(np.abs(ends[0] - ends[1]))))
    assert gaps[0] < 5e-3
    assert gaps[0] / gaps[1] > 3.0
