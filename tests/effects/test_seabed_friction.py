"""Coulomb friction on the bed: sliding, sticking, stretching, and its derivative."""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import Effect, build, component, integrate, load_scene, make_stepper, parameter
from dropper_jax.stepping.halving import advance_over

G = 9.81


def on_the_bed(one_line, links, length, kind, **more):
    bed = {"seabed": {"depth": 10.0, "stiffness": 1e6, "damping": 1e5}, "weight": {}}
    return one_line(length, links, [0.0, 0.0, -10.0], [length, 0.0, -10.0], kind, {**bed, **more})


def dragged(one_line, friction, speed):
    """A chain of 8 m that a moving end drags along the bed, its other end free."""
    motion = {"point": "b", "time": [0.0, 100.0], "displacement": [[0.0, 0.0, 0.0], [100.0 * speed, 0.0, 0.0]]}
    kind = {"mass": 10.0, "diameter": 0.04, "EA": 1e5, "damping_ratio": 1.0}
    scene = on_the_bed(one_line, 4, 8.0, kind, seabed_friction={"kinetic": 0.5, **friction}, end_motion=motion)
    scene["point"][0]["kind"] = "free"
    return scene


@pytest.mark.check
@pytest.mark.parametrize("integrator", ["energy_momentum", "generalized_alpha"])
def test_a_sliding_weight_stops_after_v2_over_2_mu_g(one_line, integrator):
    mu, speed = 0.4, 2.0
    kind = {"mass": 1e-3, "diameter": 0.02, "EA": 1e4}
    scene = on_the_bed(one_line, 2, 10.0, kind, seabed_friction={"kinetic": mu})
    scene["point"][1] = {"name": "b", "kind": "free", "position": [4.0, 0.0, -10.0], "mass": 50.0, "volume": 1e-3}
    scene["line"][0]["length"] = 20.0  # slack throughout
    model, s = build(scene)
    s = replace(s, v=s.v.at[-1, 0].set(speed))
    stepper = make_stepper(model, integrator)
    _, path = jax.jit(lambda m, s: integrate(stepper, m, stepper.integrator.begin(m, s), 0.001, 1000))(model, s)
    distance = float(path.r[-1, -1, 0] - s.r[-1, 0])
    assert distance == pytest.approx(speed**2 / (2 * mu * G), rel=1e-3)
    stopped = np.flatnonzero(np.abs(np.asarray(path.v[:, -1, 0])) == 0.0)
    assert stopped[0] * 0.001 == pytest.approx(speed / (mu * G), abs=0.003)
    np.testing.assert_array_equal(path.r[stopped[0] + 1 :, -1, 0], path.r[stopped[0] + 1, -1, 0])  # and stays


@pytest.mark.check
def test_grounded_chain_does_not_creep_across_a_current_below_the_limit(one_line):
    kind = {"mass": 10.91, "diameter": 0.042, "EA": 48.884e6, "damping_ratio": 0.1, "cdn": 1.4, "cdt": 0.2}
    scene = on_the_bed(one_line, 6, 20.0, kind, seabed_friction={"kinetic": 0.5}, buoyancy={}, morison_drag={})
    scene["point"][1]["kind"] = "free"
    scene["sea"] = {"depth": 10.0, "current": {"kind": "uniform", "speed": 0.3, "direction": np.pi / 2}}
    scene["start"] = {"kind": "points"}
    solution = dj.simulate(scene, dt=0.1, duration=300.0, save_every=100)
    assert solution.status == "ok", solution.failure
    across = solution.positions[:, :, 1]
    assert np.max(np.abs(across - across[0])) < 1e-4  # asked: 1 mm
    late = solution.t > 100.0  # what moved at first was the tension of the start
    np.testing.assert_allclose(across[late], np.broadcast_to(across[-1], across[late].shape), rtol=0, atol=1e-12)


@pytest.mark.check
def test_pulled_chain_stretches_against_friction_and_keeps_half_of_it_on_unloading(one_line):
    # T^2/(2 mu w EA): a bar in Coulomb friction; after slow unloading the outer half slips back, half the stretch stays
    mu, pull, mass, EA, length, links = 0.5, 1000.0, 10.0, 1e5, 40.0, 100
    kind = {"mass": mass, "diameter": 0.04, "EA": EA, "damping_ratio": 1.0}
    scene = on_the_bed(one_line, links, length, kind, seabed_friction={"kinetic": mu})
    scene["point"][1]["kind"] = "free"
    scene["start"] = {"kind": "points"}
    model, s = build(scene)
    s = replace(s, work=jnp.zeros(0))  # no energy balance here
    grip = mu * mass * G  # friction per metre [N/m]
    stepper = make_stepper(model)
    end = model.geometry.point_node[1]
    rise = 40.0

    def run(model, s):
        def one(s, i):
            t = (i + 0.5) * 0.05
            force = pull * jnp.where(t < rise, t / rise, jnp.maximum(2.0 - t / rise, 0.0))
            taken = advance_over(stepper, with_force(model, end, force), s, jnp.asarray(0.05))
            return taken.state, (taken.state.r[end, 0], taken.row)

        return jax.lax.scan(one, s, jnp.arange(1600))[1]

    x, residual = jax.jit(run)(model, s)
    assert float(jnp.max(residual)) < 1e-9
    stretch = np.asarray(x) - length
    full = pull**2 / (2 * grip * EA)
    assert np.max(stretch) == pytest.approx(full, rel=3e-3)  # 0.17 % at this rate of pulling, 0.04 % at a quarter of it
    assert stretch[-1] / np.max(stretch) == pytest.approx(0.5, abs=0.01)


def with_force(model, node, force):
    """The model with a force along x on one free node."""
    pull = jnp.zeros((model.free_nodes, 3)).at[node, 0].set(force)
    return replace(model, effects=(*model.effects, Pull(pull)))


@component
class Pull(Effect):
    """Forces on the free nodes, as given."""

    name: ClassVar[str] = "pull"
    pull: jax.Array = parameter("force on each free node", unit="N", shape="vectors")

    def force(self, k):
        return self.pull


@pytest.mark.check
def test_gradient_of_a_dragged_chains_tension_to_friction_is_the_weight_it_drags(one_line):
    # every node slides one way throughout, so no switch moves: T = mu times the weight behind, in a steady state
    mu, speed, EA, length, links = 0.5, 0.2, 1e5, 8.0, 4
    model = dj.build_model(load_scene(dragged(one_line, {}, speed)))
    path = model.geometry.paths[0][:-1]  # from the free end on
    weight = np.asarray(model.node_mass)[path] * G
    tension = mu * np.cumsum(weight)
    r = np.zeros((links, 3))
    r[path, 0] = length - np.cumsum((length / links * (1 + tension / EA))[::-1])[::-1]
    r[path, 2] = -10.0 - weight / (1e6 * 0.04 * np.array([0.5, 1.0, 1.0, 1.0]) * length / links)
    v = np.zeros((links, 3))
    v[:, 0] = speed
    s, stepper = dj.state(model, r, v, tension=tension), make_stepper(model, halvings=0)

    def lead(mu):
        rough = (replace(e, kinetic=mu) if e.name == "seabed_friction" else e for e in model.effects)
        path = integrate(stepper, replace(model, effects=tuple(rough)), s, 0.01, 200)[1]
        return jnp.mean(path.tension[:, -1]), jnp.min(path.v[:, :, 0])

    both = jax.jit(lambda mu: jax.jvp(lead, (mu,), (1.0,)))
    (value, slowest), (slope, _) = both(mu)
    assert slowest > 0.99 * speed
    assert float(value) == pytest.approx(mu * weight.sum(), rel=1e-3)
    assert float(slope) == pytest.approx(weight.sum(), rel=2e-3)  # the lead link is a little inclined
    ahead, behind = both(mu + 1e-4)[0][0], both(mu - 1e-4)[0][0]
    assert float(slope) == pytest.approx(float(ahead - behind) / 2e-4, rel=1e-6)


@pytest.mark.check
@pytest.mark.parametrize("law", [{"law": "moordyn", "damping": 200.0}, {"law": "regularised", "speed": 0.5}])
@pytest.mark.parametrize(("scheme", "dt"), [("energy_momentum", 0.02), ("rk2", 0.005)])
def test_laws_of_speed_grow_up_to_mu_times_the_weight_in_implicit_and_explicit_schemes(one_line, law, scheme, dt):
    # a chain dragged along the bed at a constant speed: each node is held by mu min(c v, N), or mu N min(v / v0, 1),
    # tensions are their sums
    model, s = build(dragged(one_line, law, 0.01))
    behind = model.geometry.paths[0][:-1]  # from the free end on
    weight = np.asarray(model.node_mass)[behind] * G
    stepper = make_stepper(model, scheme)

    def drag(model, s):
        return integrate(stepper, model, stepper.integrator.begin(model, s), dt, round(10.0 / dt))[1].tension[-1]

    run = jax.jit(drag)
    for speed in (0.05, 0.4, 3.0):  # below, between (the free end's node weighs half), above the limit
        moved = (
            replace(e, displacement=100.0 * speed * e.displacement) if e.name == "end_motion" else e
            for e in model.effects
        )
        start = replace(s, v=s.v.at[:, 0].set(speed))
        tension = run(replace(model, effects=tuple(moved)), start)
        share = np.minimum(law["damping"] * speed, weight) if "damping" in law else weight * min(speed / 0.5, 1.0)
        np.testing.assert_allclose(tension, np.cumsum(0.5 * share), rtol=2e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"law": "moordyn", "statics": "outward"}, "friction at rest"),
        ({"law": "regularised", "static": 0.5}, "no friction at rest"),
        ({"law": "viscous"}, "allowed: coulomb, regularised, moordyn"),
    ],
)
def test_friction_laws_that_do_not_go_together_are_refused(one_line, values, message, refusal):
    assert message in refusal(load_scene, dragged(one_line, values, 0.0))
