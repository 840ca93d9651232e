"""Morison's inertia: added mass, a wet pendulum, a particle that goes with the water."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj

RHO, G = 1000.0, 9.81
LOOSE = {"axial": {"law": "elastic", "EA": 1e-12}}


def test_forced_oscillation_in_still_water_costs_morisons_force(hanging, in_water):
    """Cylinder on `x = A sin wt`: drag -1/2 rho D L Cd x'|x'|, added mass -rho V Ca x'' (and no rho V of its own)."""
    effects = {"weight": {}, "morison_drag": {"cdn": 1.2}, "morison_inertia": {"can": 0.8}}
    model, state = dj.build(hanging(effects, {}))
    A, w = 0.3, 2.0
    for t in np.linspace(0.0, 3.0, 7):
        v, a = A * w * np.cos(w * t), -A * w**2 * np.sin(w * t)
        k = in_water(model, state.r, [[v, 0.0, 0.0]], t)
        drag = -0.5 * RHO * 0.05 * 1.2 * abs(v) * v
        assert float(model.effect("morison_drag").force(k)[0, 0]) == pytest.approx(drag, rel=1e-8)
        found = model.effect("morison_inertia").inertia(k, jnp.array([[a, 0.0, 0.0]]))[0, 0]
        assert float(found) == pytest.approx(RHO * np.pi / 4 * 0.05**2 * 0.8 * a, rel=1e-8, abs=1e-12)
        assert float(model.effect("morison_inertia").force(k)[0, 0]) == 0.0


def test_wet_pendulum_has_the_period_of_added_mass_and_buoyancy(hanging, runs):
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


def particle(hanging, form):
    volume = np.pi / 4 * 0.2**2
    waves = {"kind": "regular", "amplitude": 0.5, "period": 8.33}
    inertia = {"can": 1.0, "cat": 1.0, "fluid_acceleration": form}
    effects = {"weight": {}, "buoyancy": {}, "morison_inertia": inertia}
    sea = {"depth": 30.0, "stretching": "none", "waves": waves}
    scene = hanging(effects, sea, diameter=0.2, mass=RHO * volume, **LOOSE)
    at = np.asarray(dj.build(scene)[0].sea.at(jnp.array([[0.0, 0.0, -6.0]]), jnp.array(0.0)).velocity)
    nodes = {"positions": [[0, 0, -5.0], [0, 0, -6.0]], "velocities": [[0, 0, 0], at[0].tolist()]}
    return scene | {"start": {"kind": "positions", **nodes}}


@pytest.mark.check
def test_a_neutral_particle_stays_with_the_water_only_with_the_material_acceleration(hanging, runs):
    period, steps = 8.33, 8000
    dt = 10 * period / steps
    strays = {}
    for form in ("material", "local"):
        model, found = runs(particle(hanging, form), dt, steps, "energy_momentum_4", every=steps // 10)
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


@pytest.mark.check
def test_the_kinetic_energy_of_added_mass_is_that_of_the_free_nodes_in_systems_with_anchors():
    """`1/2 v . M_a v`, up to the stretch of links: half of the first link is at the anchor, which does not move."""
    model, s = dj.build("paper-case-1")
    effect = model.effect("morison_inertia")
    v = jnp.asarray(np.random.default_rng(0).normal(size=s.r.shape))
    k = model.instant(s.r, v, s.t)
    np.testing.assert_allclose(effect.kinetic(k), 0.5 * jnp.sum(v * effect.inertia(k, v)), rtol=2e-3)
