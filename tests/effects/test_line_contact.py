"""Contact of lines: fifty random crossings, closed forms of a push, bodies and buoys, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.effects.nearest_points import contact_force, nearest_points
from dropper_jax.report.distance import segment_distance

LINKS, SPAN, THICK, STIFF, STEPS = 4, 1.0, 0.06, 2e4, 60


def crossing(damping=0.0, dt=0.005, **more):
    """Two slack ropes without weight that cross at a height of 0.2 m."""
    rope = {"name": "rope", "mass": 0.5, "diameter": THICK, "EA": 2000.0, "law": "rope"}
    points = [fixed("a", -SPAN, 0, 0), fixed("b", SPAN, 0, 0), fixed("c", 0, -SPAN, 0.2), fixed("d", 0, SPAN, 0.2)]
    lines = [line_of(name, *ends, LINKS, 2.05 * SPAN, type="rope") for name, ends in (("low", "ab"), ("high", "cd"))]
    contact = {"pairs": [["low", "high"]], "stiffness": STIFF, "damping": damping, **more}
    more = {"line_type": [rope], "effects": {"line_contact": contact}, "start": {"kind": "points"}}
    return system(points, lines, dt=dt, duration=0.5, **more)


def thrown(model, s, seed):
    """The upper rope turned and moved at random, and thrown down onto the lower one."""
    rng = np.random.default_rng(seed)
    turn, shift = rng.uniform(-0.9, 0.9), rng.uniform(-0.3, 0.3, 2)
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    moved = lambda r: r @ spin.T + np.array([*shift, 0.0])  # noqa: E731
    points = tuple(
        replace(p, position=jnp.asarray(moved(np.asarray(p.position)))) if p.name in "cd" else p for p in model.points
    )
    inner = LINKS - 1
    r = np.array(s.r)
    r[inner:] = moved(r[inner:])
    v = 0.5 * rng.normal(size=r.shape)
    v[inner:, 2] -= rng.uniform(1.0, 6.0)
    return replace(model, points=points), replace(s, r=jnp.asarray(r), v=jnp.asarray(v))


def linking(low, high):
    """Sum over the crossings of two curves seen from above, `sign(u x w) sign(height)`: changes by a passage only."""
    total = 0.0
    for p0, p1 in zip(low[:-1], low[1:], strict=True):
        for q0, q1 in zip(high[:-1], high[1:], strict=True):
            u, w = p1 - p0, q1 - q0
            turn = u[0] * w[1] - u[1] * w[0]
            off = q0 - p0
            s, t = (off[0] * w[1] - off[1] * w[0]) / turn, (off[0] * u[1] - off[1] * u[0]) / turn
            if 0 <= s < 1 and 0 <= t < 1:
                total += np.sign(turn) * np.sign((q0 + t * w - p0 - s * u)[2])
    return total


@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_broken_links_touch_nothing(damping):
    model, state = dj.build(crossing(damping))
    touching = state.r.at[LINKS - 1 :, 2].set(0.5 * THICK)
    whole = np.arange(2 * LINKS) >= LINKS

    def push(intact):
        own = model.with_axial(model.line.axial.with_broken_links(jnp.asarray(intact, float)))
        return own.effect("line_contact").force(own.instant(touching, state.v, state.t))

    assert np.max(np.abs(push(np.ones(2 * LINKS)))) > 1.0
    assert not np.any(push(whole))  # the lower rope has broken


@pytest.fixture(scope="module")
def crossings():
    """Fifty crossings, the last ten damped: positions (50, k, nodes, 3), energies (50, k), failed and halved steps."""
    model, s = dj.build(crossing(20.0))
    stepper = dj.make_stepper(model)
    assert stepper.solver_name == "network"
    (contact,) = model.effects
    models, starts = zip(*(thrown(model, s, seed) for seed in range(50)), strict=True)
    damping = jnp.where(jnp.arange(50) < 40, 0.0, 20.0)
    stack = lambda trees: jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)  # noqa: E731

    def run(one):
        model, s, damping = one
        model = replace(model, effects=(replace(contact, damping=damping),))
        _, way = dj.integrate(stepper, model, s, 0.005, STEPS)

        def seen(r, v):
            k = model.kinematics(r, v, jnp.zeros(()))
            return k.nodes, model.kinetic_energy(k) + model.potential_energy(k) + contact.contact_energy(k)

        path = (jnp.concatenate([first[None], rest]) for first, rest in ((s.r, way.r), (s.v, way.v)))
        return *jax.vmap(seen)(*path), jnp.sum(way.failed), jnp.sum(way.retried)

    found = jax.jit(lambda all_: jax.lax.map(run, all_))((stack(models), stack(starts), damping))
    return [np.asarray(x) for x in found]


@pytest.mark.check
def test_fifty_random_crossings_pass_nowhere_and_gain_no_energy(crossings):
    nodes, energy, failed, halved = crossings
    assert failed.sum() == 0
    assert halved.sum() > 0  # some came in by more than half a radius in a step
    low, high = nodes[:, :, : LINKS + 1], nodes[:, :, LINKS + 1 :]
    senses = [linking(a[0], b[0]) for a, b in zip(low, high, strict=True)]
    assert np.all(np.abs(senses) == 1.0)
    for a, b, sense in zip(low, high, senses, strict=True):
        assert all(linking(p, q) == sense for p, q in zip(a, b, strict=True))
    met = np.min(segment_distances(low, high), axis=1) < THICK
    assert met.sum() >= 45  # as they were thrown
    share = energy / energy[:, :1]
    # the ringing force stores and returns a little energy of vibrations that the step does not resolve
    assert np.max(share - np.minimum.accumulate(share, axis=1)) < 0.02


@pytest.mark.check
def test_what_is_pressed_together_comes_back_to_rounding():
    """A weight on a slack line of rigid links, which keep all energy themselves, falls on another such line."""
    table = crossing()
    del table["line_type"][0]["EA"]
    table["line_type"][0]["law"] = "rigid"
    table["point"][2:] = [fixed("c", 0.1, -1.0, 0.5), free("d", 0.1, 0.0, 0.2, mass=1.0)]
    table["line"] = [line_of("low", "a", "b", 4, 2.1, type="rope"), line_of("high", "c", "d", 2, 1.5, type="rope")]
    table["effects"]["weight"] = {}
    solution = dj.simulate(table, dt=0.004, duration=0.6)
    assert solution.status == "ok", solution.failure
    low, high = (solution.positions[:, line.nodes] for line in solution.lines)
    i, j = np.repeat(np.arange(4), 2), np.tile(np.arange(2), 4)
    near = segment_distance(low[:, i], low[:, i + 1], high[:, j], high[:, j + 1]).min(axis=1)
    assert np.min(near) < 0.95 * THICK
    assert np.max(near[np.argmin(near) :]) > 1.2 * THICK  # it came off again
    assert "line_contact" not in solution.work_names
    assert solution.energy_drift < 1e-9 * solution.energy_scale


def segment_distances(low, high):
    """Least distance of two lines at each time (runs, k) [m], by the report's own search."""
    pairs = [(i, j) for i in range(LINKS) for j in range(LINKS)]
    i, j = np.array(pairs).T
    return segment_distance(low[:, :, i], low[:, :, i + 1], high[:, :, j], high[:, :, j + 1]).min(axis=-1)


def test_the_nearest_points_are_those_that_a_reports_exact_search_finds():
    rng = np.random.default_rng(3)
    p = rng.normal(size=(40, 4, 3))
    p[30:, 3] = p[30:, 2] + p[30:, 1] - p[30:, 0]  # parallel
    reach, spread = 0.3 * np.ones(40), 1e-5 * np.ones(40)
    near = jax.vmap(nearest_points)(jnp.asarray(p), jnp.asarray(reach), jnp.asarray(spread))
    exact = segment_distance(p[:, 0], p[:, 1], p[:, 2], p[:, 3])
    np.testing.assert_allclose(near.distance, np.sqrt(exact**2 + (1e-2 * reach) ** 2), atol=1e-4)
    # the push is minus the gradient of the energy
    energy = lambda p: jnp.sum(contact_force(nearest_points(p, 3.0, 1e-5).distance, 3.0, 50.0)[0])  # noqa: E731
    near = nearest_points(jnp.asarray(p), 3.0, 1e-5)
    force = (contact_force(near.distance, 3.0, 50.0)[1][:, None] * near.separation)[:, None] * near.shares[..., None]
    np.testing.assert_allclose(force, -jax.grad(energy)(jnp.asarray(p)), rtol=1e-9, atol=1e-9)
    for i, end, axis in ((0, 1, 2), (17, 0, 0), (35, 3, 1)):
        step = np.zeros_like(p)
        step[i, end, axis] = 1e-6
        slope = (energy(p + step) - energy(p - step)) / 2e-6
        assert -float(force[i, end, axis]) == pytest.approx(float(slope), rel=1e-5, abs=1e-6)


@pytest.mark.check
def test_damping_and_friction_dissipate_energy_in_any_motion():
    model, s = dj.build(crossing(50.0, friction=0.4))
    (contact,) = model.effects
    rng = np.random.default_rng(5)
    nodes = contact.piece_nodes(model)
    r = rng.uniform(-0.03, 0.03, (len(nodes), 4, 3)) + np.array([[-0.2, 0, 0], [0.2, 0, 0], [0, -0.2, 0], [0, 0.2, 0]])
    v = rng.normal(size=r.shape)
    k = model.kinematics(s.r, s.v, s.t)
    still = contact.piece_force(k, jnp.asarray(r), jnp.zeros_like(v))
    moved = contact.piece_force(k, jnp.asarray(r), jnp.asarray(v))
    assert np.max(np.abs(moved - still)) > 1.0
    assert np.max(np.sum((moved - still) * v, axis=(1, 2))) <= 0.0
    np.testing.assert_allclose(np.sum(moved, axis=1), 0.0, atol=1e-9)


@pytest.mark.check
def test_derivatives_through_a_crossing_are_those_of_differences_both_ways(slopes_of):
    model, s = dj.build(crossing(20.0, friction=0.2))
    model, s = thrown(model, s, 4)
    stepper, (contact,) = dj.make_stepper(model).plain, model.effects

    def after(x):
        scaled = {key: x[i] * getattr(contact, key) for i, key in enumerate(("stiffness", "damping", "friction"))}
        changed = replace(contact, **scaled)
        start = replace(s, v=s.v * x[3])
        last, _ = dj.integrate(stepper, replace(model, effects=(changed,)), start, 0.002, 80)
        return jnp.sum(last.v[:, 2] * jnp.arange(1.0, 1.0 + len(last.v)))

    assert np.all(np.abs(slopes_of(after, jnp.ones(4), 1e-6, modes=1e-8, floor=1.0)) > 1e-6)


def beside(**floating):
    """A taut weightless rope on which a body or a buoy `float` falls, held by a slack tether, in thin water."""
    table = crossing() | {"sea": {"depth": 50.0, "density": 1e-3}} | floating
    table["point"][2:] = [fixed("c", 0.0, 0.0, 2.0)]
    table["line"][1] = line_of("high", "c", "d", 2, 1.7, type="rope")
    table["effects"]["line_contact"] |= {"pairs": [], "bodies": [["low", "float"]]}
    return table


def beside_buoy(**contact):
    """The same with a buoy, and weight: it falls 0.3 m."""
    buoy = {"name": "float", "point": "d", "mass": 2.0, "diameter": 0.2, "height": 0.4, "attachment": 0.4}
    table = beside(buoy=[buoy])
    table["point"].append(free("d", 0.05, 0.1, 0.4))
    table["effects"]["weight"] = {}
    table["effects"]["line_contact"] |= contact
    return table


@pytest.mark.check
def test_a_body_that_falls_on_a_line_bounces_and_keeps_all_energy():
    ball = {"centre": [0.0, 0.0, 0.0], "diameter": 0.3, "cd": 0.0, "ca": 0.0}
    bar = {"from": [-0.3, 0.0, 0.0], "to": [0.3, 0.0, 0.0], "diameter": 0.1, "cdn": 0.0, "can": 0.0}
    body = {"name": "float", "position": [0.05, 0.1, 0.4], "velocity": [0.0, 0.0, -2.0]}
    body |= {"mass": 2.0, "centre_of_mass": [0.0] * 3, "inertia": [0.02, 0.03, 0.04]}
    body |= {"spheres": [ball], "cylinders": [bar], "attachments": {"d": [0, 0, 0.15]}}
    solution = dj.simulate(beside(body=[body]), dt=0.002, duration=0.4)
    assert solution.status == "ok", solution.failure
    assert solution.settings["solver"] == "network"
    speed = solution.body("float")["body_velocity"][:, 2]
    assert speed[0] < -1.9
    assert speed[-1] > 0.0
    assert solution.potential.max() > 1.0  # it was pressed into the line
    assert solution.energy_drift < 1e-6 * solution.energy_scale


def cut(pairs):
    """The crossing ropes, the upper one in two pieces."""
    table = crossing(pairs=pairs)
    table["line"][1]["attach"] = [{"point": "middle", "at": SPAN}]
    return table


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (crossing(pairs=[["low", "hgh"]]), "pairs.0.1: 'hgh' is not a line; did you mean 'high'"),
        (crossing(pairs=[["low", "low"]]), "pairs.0: 'low' and 'low' are the same line; allowed: two lines"),
        (crossing(pairs=[["low", "high"], ["high", "low"]]), "pairs.1: is listed before; allowed: each pair once"),
        (crossing(pairs=[]), "pairs: missing"),
        (crossing(pairs=[["low"]]), "pairs.0: ['low'] has 1 entries; allowed: two names"),
        (crossing(bodies=[["low", "spar"]]), "bodies.0.1: 'spar' is not a body or buoy; none exist"),
        (cut([["high", "high-1"]]), "pairs.0: 'high' and 'high-1' are the same line"),
        (cut([["low", "high"], ["high-1", "low"]]), "pairs.1: is listed before"),
        (beside_buoy(bodies=[["low", "float"]] * 2), "bodies.1: is listed before"),
    ],
)
def test_pairs_that_make_no_sense_are_refused(table, message, refusal):
    assert f"effects.line_contact.{message}" in refusal(dj.load_scene, table)


@pytest.mark.check
def test_steps_that_no_halving_makes_short_enough_are_reported():
    # more than half a radius in a step of 0.1 s
    solution = dj.simulate(beside_buoy(), dt=0.1, duration=0.4, halvings=0)
    assert solution.status == "retry_exhausted"
    assert "lines in contact moved by more than half their radius" in solution.failure
    assert "take a smaller step" in solution.failure


@pytest.mark.check  # 40 s
def test_stiff_ropes_that_slide_slowly_into_each_other_find_their_rest():
    """A loop hangs in another one: the descent needs several thousand iterations, each thousand of which helps."""
    axial = {"law": "rope", "EA": 5e6}
    ends = {"a": [0.0, 0.0, 0.0], "b": [1.5, 0.0, 0.0], "c": [0.7, -0.531, 0.0], "d": [0.7, 0.531, 0.0]}
    low = line_of("low", "a", "b", 8, 0.375, mass=0.952, diameter=0.0519, axial=axial)
    high = line_of("high", "c", "d", 8, 0.332, mass=2.24, diameter=0.0719, axial=axial)
    effects = {"weight": {}, "line_contact": {"pairs": [["low", "high"]], "stiffness": 28400.0}}
    points = [fixed(name, *position) for name, position in ends.items()]
    scene = system(points, [low, high], effects=effects, start={"kind": "points"})
    assert dj.equilibrium(dj.build(scene)[0]).status == "ok"
