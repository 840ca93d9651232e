"""Derivatives of static poses: closed forms, differences of poses solved again, and poses that something may leave."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_weight
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax import natural_modes, natural_periods
from dropper_jax.statics.host_stiffness import free_motion

G, RHO = 9.81, 1025.0


@pytest.fixture(scope="module")
def mooring():
    """A float between a chain that lies on the bed and a taut rope, in a current across both; model and pose."""
    buoy = free("float", 15.0, 0.0, -2.0, mass=20.0, volume=0.1)
    table = system(
        [fixed("a", 0.0, 0.0, -10.0), fixed("b", 25.0, 0.0, -10.0), buoy],
        [line_of("chain", "a", "float", 6, 19.0, type="chain"), line_of("rope", "b", "float", 4, 12.0, type="rope")],
        line_type=[
            {"name": "chain", "mass": 10.0, "diameter": 0.04, "EA": 5e5, "cdn": 1.4, "cdt": 0.2},
            {"name": "rope", "mass": 1.2, "diameter": 0.05, "EA": 1e5, "cdn": 1.2, "cdt": 0.1},
        ],
        sea={"depth": 10.0, "current": {"kind": "uniform", "speed": 0.7, "direction": 1.2}},
        effects={"weight": {}, "buoyancy": {}, "morison_drag": {}, "seabed": {}},
    )
    model = dj.build(table)[0]
    return model, dj.equilibrium(model)


def changed(model, p):
    """The mooring with links longer, stiffer, rougher, and its first anchor farther off, by shares p (4,) of one."""
    line = model.line
    axial = replace(line.axial, EA=line.axial.EA * p[1])
    rough = [replace(e, cdn=e.cdn * p[2]) if e.name == "morison_drag" else e for e in model.effects]
    lines = (replace(line, length=line.length * p[0], axial=axial),)
    points = (replace(model.points[0], position=model.points[0].position * p[3]), *model.points[1:])
    return replace(model, lines=lines, effects=tuple(rough), points=points)


def measured(pose):
    """Tensions at both anchors and the float's place."""
    return jnp.concatenate([pose.tension[jnp.array([0, 6])] / 100.0, pose.state.r[-1]])


def differences(f, count):
    """Derivatives (m, count) of f at ones, by central differences of fourth order."""
    h = 1e-3
    columns = []
    for e in np.eye(count):
        far, near = (f(1 + k * h * e) - f(1 - k * h * e) for k in (2, 1))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=1)


@pytest.mark.check
def test_a_pose_follows_lengths_stiffness_drag_and_anchors_in_both_modes(mooring, both_modes):
    model, pose = mooring
    near_by = both_modes(lambda p: measured(dj.equilibrium(changed(model, p), near=pose.state)))
    there, reverse, forward = near_by(jnp.ones(4))
    searched = differences(lambda p: measured(dj.equilibrium(changed(model, jnp.asarray(p)))), 4)
    np.testing.assert_allclose(forward, searched, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(there, measured(pose), rtol=1e-8)


def test_gradients_of_a_model_go_through_the_search_on_the_host():
    """A buoyant point on one elastic line: its place is `a + L (1 + T/EA)` above the anchor, T of the links' middle."""
    table = hung_weight(30.0, {"mass": 1.0, "diameter": 0.02, "EA": 2e4}, 9.0, 3)
    model = dj.build(table)[0]
    EA, length, tension = 2e4, 3.0, G * (30.0 + 3.0 * (np.arange(3)[::-1] + 0.5))
    slope = jax.grad(lambda m: dj.equilibrium(m).positions[-1, 2])(model)
    line = slope.lines[0]
    np.testing.assert_allclose(line.axial.EA, length * tension / EA**2, rtol=1e-9)
    np.testing.assert_allclose(line.length, -(1.0 + tension / EA), rtol=1e-9)


def test_a_pose_inside_a_compiled_program_needs_one_near_by(mooring):
    model, _ = mooring
    with pytest.raises(dj.SceneError, match="near: missing inside jit or vmap"):
        jax.jit(lambda m: dj.equilibrium(m).tension)(model)
    with pytest.raises(dj.SceneError, match="loads, t, near: need a model"):
        dj.equilibrium("string", t=1.0)


@pytest.mark.check
def test_what_nothing_holds_is_named_and_has_no_derivative_of_its_own_motion():
    """A slack rope that floats on calm water: its inner nodes may be pushed about without any resistance."""
    table = system(
        [fixed(name, x, 0.0, 0.0) for name, x in (("a", 0.0), ("b", 2.0), ("c", 4.0))],
        [line_of("ab", "a", "b", 3, 2.4, type="rope"), line_of("bc", "b", "c", 3, 2.4, type="rope")],
        line_type=[{"name": "rope", "mass": 0.8, "diameter": 0.035, "EA": 1e4, "cdn": 1.2, "cdt": 0.02}],
        sea={"depth": 10.0},
        effects={"weight": {}, "buoyancy": {}},
    )
    model = dj.build(table)[0]
    pose = dj.equilibrium(model)
    assert pose.status == "ok"
    none = jnp.zeros_like(pose.state.r)
    words = free_motion(model, pose.state, none)
    assert words.startswith("node")
    assert " is unconstrained along (" in words

    def settled(loads):
        return dj.settle(model, pose.state, loads, is_equilibrium=True).r

    push = jax.jit(lambda change: jax.jvp(settled, (none,), (change,))[1])
    assert np.isnan(push(none.at[1, 1].set(1.0))).any()
    assert np.isfinite(push(none.at[1, 2].set(1.0))).all()  # upwards it is held by its buoyancy


def test_a_held_system_has_no_free_motion(mooring):
    model, pose = mooring
    assert free_motion(model, pose.state, jnp.zeros_like(pose.state.r)) == ""


@pytest.mark.check
def test_periods_follow_stiffness_lengths_and_masses_with_the_pose(both_modes):
    """Against periods of poses solved again."""
    table = system(
        [fixed("a", 0.0, 0.0, 0.0), fixed("b", 5.0, 0.0, 1.0), free("weight", 2.0, 0.5, -4.0, mass=30.0)],
        [line_of("first", "a", "weight", 2, 4.0, type="rope"), line_of("second", "b", "weight", 2, 6.0, type="rope")],
        line_type=[{"name": "rope", "mass": 1.0, "diameter": 0.02, "EA": 5e3}],
    )
    model = dj.build(table)[0]
    pose = dj.equilibrium(model)

    def at(p):
        line = model.line
        axial = replace(line.axial, EA=line.axial.EA * p[0])
        return replace(model, lines=(replace(line, length=line.length * p[1], mass=line.mass * p[2], axial=axial),))

    def periods(p):
        changed = at(p)
        return natural_periods(changed, dj.settle(changed, pose.state), 3)

    _, reverse, forward = both_modes(periods)(jnp.ones(3))
    solved_again = differences(lambda p: natural_modes(at(p), dj.equilibrium(at(p)).state, 3).period, 3)
    np.testing.assert_allclose(forward, solved_again, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-9)


def test_rigid_lines_settle_at_a_pose_with_links_of_their_lengths_or_nowhere():
    """Newton's method from far away silently ended in poses 400 m off."""
    model = dj.build("dropper-release-a")[0]
    pose = dj.equilibrium(model).state
    shifts = 0.3 * np.random.default_rng(0).normal(size=(20, *pose.r.shape))
    settled = jax.jit(jax.vmap(lambda shift: dj.settle(model, replace(pose, r=pose.r + shift)).r))(shifts)
    found = np.isfinite(settled).all(axis=(1, 2))
    assert 0 < found.sum() < 20
    for r in settled[found]:
        lengths = np.linalg.norm(np.diff(model.nodes(r, model.ends(pose.t)), axis=0), axis=1)
        np.testing.assert_allclose(lengths, model.line.length, rtol=1e-8)
    assert np.isnan(settled[~found]).all()
