"""Held points that jump: velocities, tensions, impulses and energy after it, against a pendulum by SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_line
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.effects import EndMotion
from dropper_jax.integrators.consistent_velocities import make_consistent, solve_instant

MASS, LENGTH, GRAVITY = 0.1, 1.0, 9.81


def pendulum(dt: float, motion: dict, duration: float = 1.0, links: int = 1) -> dict:
    """A mass on rigid links, at rest under a point that moves."""
    return hung_line(links, LENGTH / links, MASS / links) | {
        "run": {"dt": dt, "duration": duration},
        "effects": {"weight": {"gravity": GRAVITY}, "end_motion": {"point": "top", **motion}},
    }


def table(dt: float) -> dict:
    """Moves at once and stops at once, both at 0.3 of a step."""
    return {
        "time": [0.1 + 0.3 * dt, 0.2, 0.3 + 0.3 * dt],
        "displacement": [[0.0] * 3, [0.03, 0.0, 0.01], [0.05, 0.0, 0.0]],
    }


def angle_and_tension(motion: dict, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle from the vertical and tension after the table's end, by SciPy from the equation of a driven pendulum."""
    effect = EndMotion(time=jnp.array(motion["time"]), displacement=jnp.array(motion["displacement"]))
    first, last = motion["time"][0], motion["time"][-1]
    velocity = jax.jit(jax.jacfwd(effect.displace))
    acceleration = jax.jit(jax.jacfwd(jax.jacfwd(effect.displace)))
    just = 1e-9

    def fall(t, y, moving):
        ax, _, az = acceleration(t) if moving else (0.0, 0.0, 0.0)
        return [y[1], -((GRAVITY + az) * np.sin(y[0]) + ax * np.cos(y[0])) / LENGTH]

    def jump(y, before, after):
        """The velocity across the link stays, so that the rate changes as the point's does."""
        dx, _, dz = np.asarray(after) - np.asarray(before)
        return [y[0], y[1] - (dx * np.cos(y[0]) + dz * np.sin(y[0])) / LENGTH]

    exact = {"rtol": 1e-11, "atol": 1e-12}
    y = jump([0.0, 0.0], np.zeros(3), velocity(first + just))
    y = solve_ivp(fall, (first, last), y, args=(True,), **exact).y[:, -1]
    y = jump(y, velocity(last - just), np.zeros(3))
    found = solve_ivp(fall, (last, times[-1] + 1e-6), y, args=(False,), t_eval=times, **exact).y
    return found[0], MASS * (LENGTH * found[1] ** 2 + GRAVITY * np.cos(found[0]))


@pytest.mark.check
@pytest.mark.parametrize(
    ("integrator", "drift"),  # of shorter substeps corrections end at the tolerance, which 800 steps add up
    [("energy_momentum", 1e-12), ("energy_momentum_4", 1e-9)],
)
def test_tensions_after_a_jump_within_a_step_are_those_of_the_pendulum(integrator, drift):
    errors, alternations = [], []
    for dt in (0.005, 0.0025, 0.00125):
        run = dj.simulate(pendulum(dt, table(dt)), integrator=integrator)
        assert run.status == "ok"
        late = run.t_tension > 0.31 + dt
        _, tension = angle_and_tension(table(dt), run.t_tension[late])
        errors.append(np.max(np.abs(run.tension[late, 0] - tension)) / (MASS * GRAVITY))
        miss = run.tension[late, 0] - tension
        alternations.append(np.max(np.abs(miss[1:] - miss[:-1])) / (MASS * GRAVITY))
        assert run.energy_drift < drift * run.energy_scale
    assert max(alternations) < 1e-3
    assert alternations[1] < 0.6 * alternations[0]
    assert alternations[2] < 0.6 * alternations[1]
    assert errors[2] < 2e-3


def test_the_jump_itself_is_an_impulse_in_the_tension():
    """The mass of a vertical link is jerked up by what the point's vertical velocity changes: m dv over the step."""
    dt, speed = 0.01, 0.2
    motion = {"time": [0.1 + 0.3 * dt, 1.0], "displacement": [[0.0] * 3, [0.0, 0.0, speed * (0.9 - 0.3 * dt)]]}
    run = dj.simulate(pendulum(dt, motion, 0.5), integrator="energy_momentum")
    weight = MASS * GRAVITY
    struck = np.argmax(run.tension[:, 0])
    assert run.t_tension[struck] == pytest.approx(0.105)
    assert dt * (run.tension[struck, 0] - weight) == pytest.approx(MASS * speed, rel=1e-9)
    np.testing.assert_allclose(run.tension[struck + 1 :, 0], weight, rtol=1e-9)
    gained = 0.5 * MASS * speed**2
    assert run.kinetic[-1] == pytest.approx(gained, rel=1e-9)
    assert run.energy_drift < 1e-12 * run.energy_scale


def test_a_ramp_is_twice_differentiable_and_a_table_between_its_rows():
    ramp = EndMotion(amplitude=jnp.ones(3), period=jnp.asarray(1.3), ramp=jnp.asarray(0.7), phase=jnp.asarray(0.4))
    rows = EndMotion(
        time=jnp.array([0.0, 0.3, 0.7, 1.2]), displacement=jnp.array([[0.0] * 3, [1.0] * 3, [-1.0] * 3, [2.0] * 3])
    )
    for effect, times in ((ramp, (0.0, 0.7)), (rows, (0.3, 0.7))):
        rate = jax.jacfwd(effect.displace)
        motion = jax.jit(jax.vmap(lambda t, e=effect, v=rate: (e.displace(t), v(t), jax.jacfwd(v)(t))))
        before, after = (motion(jnp.array(times) + side) for side in (-1e-9, 1e-9))
        np.testing.assert_allclose(before, after, atol=1e-5)


def test_a_projection_takes_energy_and_leaves_no_stretching():
    model, s = dj.build("dropper-release-b")
    v = 0.1 * jnp.sin(jnp.arange(s.r.size, dtype=float)).reshape(s.r.shape)
    k = model.instant(s.r, v, s.t)
    found, impulse = make_consistent(k)
    after = k.with_velocity(found)
    np.testing.assert_allclose(jnp.sum(k.links * after.link_velocities, axis=-1), 0.0, atol=1e-14)
    np.testing.assert_allclose(
        model.nodal_inertia(found - v), model.tension_force(impulse, k.links / model.line.length[:, None]), atol=1e-14
    )
    assert model.kinetic_energy(after) < model.kinetic_energy(k)


def test_the_instant_tension_is_that_of_a_swinging_pendulum():
    scene = pendulum(0.01, {"amplitude": [0.0, 0.0, 0.0], "period": 1.0})
    model = build_model(dj.load_scene(scene))
    angle, rate = 0.6, 1.7
    r = jnp.array([[np.sin(angle), 0.0, -np.cos(angle)]])
    v = rate * jnp.array([[np.cos(angle), 0.0, np.sin(angle)]])
    a, tension = solve_instant(model.instant(r, v, 0.0), jnp.zeros((1, 3)))
    np.testing.assert_allclose(tension, MASS * (LENGTH * rate**2 + GRAVITY * np.cos(angle)), rtol=1e-12)
    across = -GRAVITY * np.sin(angle) * v[0] / rate
    np.testing.assert_allclose(a[0], across - rate**2 * r[0], rtol=1e-12, atol=1e-14)


@pytest.mark.check
@pytest.mark.parametrize("added_mass", ["morison", "lagrangian"])
def test_a_jump_under_water_leaves_tensions_that_do_not_alternate(added_mass):
    dt = 0.002
    scene = pendulum(dt, table(dt), links=3, duration=0.5)
    scene["sea"] = {"depth": 50.0}
    scene["point"] = [p | {"position": [0.0, 0.0, p["position"][2] - 2.0]} for p in scene["point"]]
    scene["line"][0]["diameter"] = 0.01
    scene["effects"]["morison_inertia"] = {"can": 1.0, "cat": 0.2, "added_mass": added_mass}
    scene["start"] = {"kind": "angles", "polar": [np.pi / 2 - 0.1] * 3}
    run = dj.simulate(scene)
    assert run.status == "ok"
    assert run.energy_drift < 1e-12 * run.energy_scale
    late = run.tension[run.t_tension > 0.31 + dt]
    bend = late[2:] - 2.0 * late[1:-1] + late[:-2]
    assert np.max(np.abs(bend)) < 1e-2 * np.max(late)
    # the first instant's tension stands before the first step's, as its neighbour does after it
    assert np.abs(run.tension[0] - run.tension[1]) == pytest.approx(np.zeros(3), abs=0.02 * np.max(late))


@pytest.mark.check
@pytest.mark.parametrize("dt", [0.03, 0.015])
def test_added_mass_that_turns_does_not_feed_a_velocity_that_alternates(dt):
    """Ten minutes of a regular wave are periodic; tensions grew from 1.1 kN at 100 s to 300 kN at 400, 4 MN at 600."""
    found = dj.simulate("dropper-regular-wave", dt=dt, duration=500.0)
    early, late = ((found.t >= at) & (found.t < at + 83.3) for at in (100.0, 410.0))
    assert found.status == "ok"
    assert found.energy_drift < 1e-6 * found.energy_scale
    for extreme in (np.max, np.min):
        assert extreme(found.tension[late]) == pytest.approx(extreme(found.tension[early]), rel=0.02)
    assert np.abs(found.velocities[late]).max() == pytest.approx(np.abs(found.velocities[early]).max(), rel=0.01)
    saw = np.abs(np.diff(found.tension[late], 2, axis=0)).max() / 4
    assert saw < 0.01 * found.tension[late].max()
