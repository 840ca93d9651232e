"""Laws side by side in one system: rigid links, ropes and tables, against closed forms and against one law for all."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.special import ellipk

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.axial import Elastic, Groups, LinkStart, Rigid, Rope

SCENE = "rigid-dropper-longline"
DROPPER = 8.0  # [m]


def with_dropper(**values) -> dj.Scene:
    """The packaged scene with another type of dropper."""
    table = dj.load_scene(SCENE).as_written()
    kind = next(kind for kind in table["line_type"] if kind["name"] == "dropper")
    kind.update(values)
    return dj.Scene.from_dict(table)


def rope(name: str, start: str, end: str, links: int, length: float, **axial) -> dict:
    law = axial or {"law": "rope", "EA": 1e5, "damping": 50.0}
    return line_of(name, start, end, links, length / links, mass=0.3, nodes="shared", axial=law)


def test_each_link_answers_by_its_own_law():
    rng = np.random.default_rng(1)
    members = ((0, 3, 4), (1, 2), (5,))
    laws = (Rope(EA=np.array([1e3, 2e3, 3e3])), Rigid(), Elastic(EA=np.array([4e3]), damping=np.array([7.0])))
    groups = Groups(laws, members)
    d0, d1, rate = rng.normal(size=(3, 6, 3))
    tension, length = rng.normal(size=6), np.ones(6)
    rows = groups.residual(LinkStart(d0, rate), d1, tension, length, 0.1)
    pairs = list(zip(laws, members, strict=True))
    for law, group in pairs:
        own = list(group)
        np.testing.assert_array_equal(
            rows[jnp.array(own)], law.residual(LinkStart(d0[own], rate[own]), d1[own], tension[own], length[own], 0.1)
        )
    np.testing.assert_array_equal(groups.rigid(6), [False, True, True, False, False, False])
    assert not groups.elastic
    assert set(groups.work_names) == {"axial_ringing", "internal_damping"}
    np.testing.assert_allclose(
        groups.energy(d1, length), sum(law.energy(d1[list(m)], length[list(m)]) for law, m in pairs), rtol=1e-14
    )


def rigid_and_stiff(solve):
    """Solutions of the scene, and with stiff droppers in place of its rigid ones."""
    rigid, stiff = (solve(scene) for scene in (SCENE, with_dropper(law="rope", EA=2e7)))
    assert (rigid.status, stiff.status) == ("ok", "ok")
    return rigid, stiff


@pytest.mark.check
def test_a_rigid_dropper_rests_where_one_of_stiff_links_does():
    rigid, stiff = rigid_and_stiff(dj.equilibrium)
    assert np.max(stiff.tension[-16:]) / 2e7 < 1e-5  # what the stiff one stretches
    np.testing.assert_allclose(rigid.positions, stiff.positions, atol=1e-4 * DROPPER)
    np.testing.assert_allclose(rigid.tension, stiff.tension, rtol=1e-5)
    links = np.diff(rigid.positions[-17:], axis=0)
    np.testing.assert_allclose(np.linalg.norm(links, axis=1), 0.5, rtol=1e-12)


@pytest.mark.check
def test_a_rigid_dropper_moves_in_waves_as_one_of_stiff_links_does():
    rigid, stiff = rigid_and_stiff(partial(dj.simulate, duration=5.0))
    assert np.max(np.ptp(rigid.positions, axis=0)) > 0.2  # it does move
    np.testing.assert_allclose(rigid.positions, stiff.positions, atol=1e-3 * DROPPER)
    assert rigid.max_closure_error < 1e-9
    np.testing.assert_allclose(rigid.tension, stiff.tension, atol=2e-3 * stiff.tension.max())


@pytest.mark.check
def test_many_rigid_lines_of_every_length_are_solved_as_by_the_whole_jacobian(network_is_exact):
    """Lines of one link, of many, loops at one point, ends held and free, more points than one block holds."""
    rng = np.random.default_rng(3)
    points = [fixed("left", 0.0, 0.0, 0.0), fixed("right", 30.0, 0.0, 0.0)]
    names = ["left", *(f"p{i}" for i in range(14)), "right"]
    points += [free(f"p{i}", 2.0 * i + 2.0, 0.2 * i, -1.0) for i in range(14)]
    kinds = ({"law": "rope", "EA": 1e5}, {"law": "rigid"})
    lines = [rope(f"bay{i}", a, b, 1 + i % 3, 2.4, **kinds[i % 2]) for i, (a, b) in enumerate(pairwise(names))]
    lines += [rope(f"drop{i}", f"p{i}", f"p{i + 1}", 1 + i % 5, 5.0, law="rigid") for i in range(13)]
    lines.append(rope("loop", "p3", "p3", 6, 3.0, law="rigid"))
    points.append(free("end", 4.0, 0.0, -9.0, mass=3.0))
    lines.append(rope("tail", "p0", "end", 12, 6.0, law="rigid"))
    model = build_model(dj.load_scene(system(points, lines)))
    shape = (model.free_nodes, 3)
    s = dj.state(model, rng.normal(size=shape), 0.1 * rng.normal(size=shape), rng.normal(size=model.line.links) + 50.0)
    network_is_exact(model, s)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_pendulum_in_a_system_of_lines_swings_with_the_period_of_the_elliptic_integral(dtype):
    length, turn = 2.0, np.pi / 2  # from the horizontal
    points = [fixed("pivot", 0.0, 0.0, 0.0), free("bob", length, 0.0, 0.0, mass=5.0)]
    table = system(points, [rope("arm", "pivot", "bob", 1, length, law="rigid")], start={"kind": "points"})
    quarter = float(ellipk(np.sin(turn / 2) ** 2)) * np.sqrt(length / 9.81)
    run = dj.simulate(table, dt=quarter / 500, duration=quarter, dtype=dtype)
    assert run.status == "ok"
    bob = run.positions[-1, 1]
    np.testing.assert_allclose(bob, [0.0, 0.0, -length], atol=2e-4)
    if dtype == "float64":  # float32 has its rounding over the square of the step
        np.testing.assert_allclose(run.tension[-1, 0], 3 * (5.0 + 0.15) * 9.81, rtol=1e-3)  # m g + m v^2 / L


@pytest.mark.check
def test_energy_is_kept_where_rigid_links_hang_from_ropes():
    points = [fixed("left", 0.0, 0.0, 0.0), fixed("right", 3.0, 0.0, 0.0), free("top", 1.5, 0.3, -1.5)]
    points.append(free("end", 2.0, 0.3, -3.2, mass=2.0))
    lines = [rope("spring", "left", "top", 3, 3.0, law="rope", EA=2e3), rope("other", "right", "top", 3, 3.0)]
    lines.append(rope("drop", "top", "end", 4, 2.0, law="rigid"))
    run = dj.simulate(system(points, lines, dt=0.002, duration=2.0, start={"kind": "points"}))
    assert run.status == "ok"
    assert np.max(np.ptp(run.positions, axis=0)) > 0.3
    assert run.energy_drift < 1e-8 * run.energy_scale
    assert run.max_closure_error < 1e-9


@pytest.mark.check
def test_rigid_triangles_hold_more_than_they_need_to():
    """More constraints than motions: two rigid lines between the same points share the load in halves."""
    points = [fixed("top", 0.0, 0.0, 0.0), fixed("side", 2.0, 0.0, -1.0), free("load", 0.0, 0.0, -1.0, mass=10.0)]
    lines = [rope(name, "top", "load", 1, 1.0, law="rigid") for name in ("one", "two")]
    table = system(points, [*lines, rope("side", "side", "load", 4, 2.1)], dt=0.002)
    pose = dj.equilibrium(table)
    assert pose.status == "ok"
    np.testing.assert_allclose(pose.tension[0], pose.tension[1], rtol=1e-6)
    assert pose.tension[0] > 0.5 * 10.0 * 9.81
    assert dj.simulate(table, duration=0.2).status == "ok"


@pytest.mark.check
def test_a_table_among_ropes_is_a_rope_where_it_is_straight():
    def scene(**axial) -> dict:
        points = [fixed("left", 0.0, 0.0, 0.0), fixed("right", 3.0, 0.0, 0.0), free("low", 1.5, 0.0, -1.0)]
        return system(points, [rope("near", "left", "low", 4, 2.2), rope("far", "low", "right", 4, 2.2, **axial)])

    ropes = dj.equilibrium(scene())
    mixed = scene(law="tabulated", strain=[0.0, 0.1], tension=[0.0, 1e4])
    assert isinstance(build_model(dj.load_scene(mixed)).line.axial, Groups)
    np.testing.assert_allclose(dj.equilibrium(mixed).positions, ropes.positions, atol=1e-9)


def unequal_lines() -> dict:
    """A point between a damped rope and a spring without damping, both taut."""
    points = [fixed("left", 0.0, 0.0, 0.0), fixed("right", 1.9, 0.0, 0.0), free("low", 1.0, 0.0, -0.5)]
    lines = [rope("near", "left", "low", 1, 1.1, law="rope", EA=1e4, damping=10.0)]
    lines.append(rope("far", "low", "right", 1, 1.0, law="elastic", EA=1e4))
    return system(points, lines, dt=1e-4, duration=0.02, start={"kind": "points"})


@pytest.mark.parametrize("integrator", ["rk4", "generalized_alpha", "semi_implicit_euler"])
def test_lines_of_different_laws_move_alike_under_schemes_with_laws_at_one_instant(integrator):
    reference = dj.simulate(unequal_lines())
    run = dj.simulate(unequal_lines(), integrator=integrator)
    assert (run.status, reference.status) == ("ok", "ok")
    travel = np.max(np.ptp(reference.positions, axis=0))
    np.testing.assert_allclose(run.positions, reference.positions, atol=0.01 * travel)
    assert run.energy_drift < 0.02 * run.energy_scale


def test_broken_links_of_a_run_in_float32_are_known_in_float32_where_others_are_rigid():
    laws = (Rope(EA=np.array([1e4], np.float32)), Rigid())
    broken = Groups(laws, ((0,), (1,))).with_broken_links(jnp.array([0.0, 1.0], jnp.float32))
    assert broken.intact.dtype == jnp.float32
    np.testing.assert_array_equal(broken.intact, [0.0, 1.0])


@pytest.mark.check
def test_derivatives_of_a_run_agree_forward_reverse_and_with_differences(slopes_of):
    points = [fixed("left", 0.0, 0.0, 0.0), free("top", 1.5, 0.3, -1.0), free("end", 2.0, 0.3, -1.7, mass=2.0)]
    lines = [rope("spring", "left", "top", 2, 2.0), rope("drop", "top", "end", 2, 1.0, law="rigid")]
    model, start = dj.build(system(points, lines, start={"kind": "points"}))
    stepper, line = dj.make_stepper(model).plain, model.line

    def end(share: jax.Array) -> jax.Array:
        heavier = line.mass * jnp.where(line.axial.rigid(line.links), share, 1.0)
        changed = replace(model, lines=(replace(line, mass=heavier),))
        s, _ = dj.integrate(stepper, changed, start, 0.01, 15)
        return jnp.sum(s.r[:, 2] ** 2) + 1e-3 * jnp.sum(s.tension)

    slopes_of(end, 1.0, rel=1e-5, modes=1e-8)


@pytest.mark.parametrize("integrator", ["generalized_alpha", "rk4"])
def test_schemes_that_need_stretch_refuse_rigid_links(integrator):
    with pytest.raises(dj.SceneError, match=f"{integrator}.*links are rigid"):
        dj.simulate(SCENE, duration=0.1, integrator=integrator)


@pytest.mark.parametrize("key", ["EA", "damping_ratio"])
def test_a_rigid_type_takes_no_stiffness_and_no_damping(key, refusal):
    message = f"line_type.1.{key}: not used by law 'rigid', which takes no stiffness and no damping"
    assert message in refusal(with_dropper, **{key: 0.1})
