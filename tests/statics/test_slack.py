"""Ropes that lie on a bed, float, or hang in numbers from one float: closed forms, and independent balances."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import layouts
import numpy as np
import pytest
from grounded_catenary import fairlead_forces
from scene_parts import fixed, free, line_of, system
from scipy.optimize import brentq

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.statics import rest
from dropper_jax.statics.descent import find_rest, straight_guess
from dropper_jax.statics.host_stiffness import stiffness
from dropper_jax.statics.rest_problem import system_tolerance, unbalanced

G, RHO = 9.81, 1025.0
CHAIN = {"mass": 10.91, "diameter": 0.042, "EA": 48.884e6, "cdn": 1.4, "cdt": 0.2}
FLOATING = {"mass": 0.8, "diameter": 0.035, "EA": 1e6, "cdn": 1.2, "cdt": 0.02}
#: Steps of a slow motion from a guess to rest.
SLOW_STEPS = 1000


def scene(length, links, start, end, kind, depth, speed=0.0):
    """A rope of one line between two held points in water, its links' loads on their far nodes."""
    link = length / links
    rope = {"mass": kind["mass"] * link, "diameter": kind["diameter"], "axial": {"law": "rope", "EA": kind["EA"]}}
    drag = {"cdn": kind["cdn"], "cdt": kind["cdt"]}
    return system(
        [fixed("a", *start), fixed("b", *end)],
        [line_of("rope", "a", "b", links, link, **rope)],
        sea={"depth": depth, "current": {"kind": "uniform", "speed": speed}},
        effects={"weight": {}, "buoyancy": {}, "morison_drag": drag, "seabed": {}},
    )


def found(table):
    pose = dj.equilibrium(table)
    assert pose.status == "ok", pose.message
    return pose


@pytest.mark.check
@pytest.mark.slow
def test_a_rope_of_one_line_that_sags_onto_the_bed_is_the_catenary_with_a_part_on_it():
    length, across, depth, links = 7.8, 6.1, 3.2, 20
    w = G * (CHAIN["mass"] - RHO * np.pi / 4 * CHAIN["diameter"] ** 2)
    h, v = fairlead_forces(length, w, CHAIN["EA"], across, depth)
    pose = found(scene(length, links, [0.0, 0.0, -depth], [across, 0.0, 0.0], CHAIN, depth))
    assert pose.tension[0] == pytest.approx(h, rel=5e-3)  # on the bed
    assert pose.tension[-1] == pytest.approx(np.hypot(h, v - 0.5 * w * length / links), rel=5e-3)
    lies = pose.positions[:, 2] < -depth + 1e-3
    assert np.sum(lies) - 1 == int((length - v / w) * links / length)


@pytest.mark.slow
def test_a_slack_floating_rope_lies_at_the_draught_that_carries_it():
    pose = found(scene(12.0, 20, [0.0] * 3, [10.0, 0.0, 0.0], FLOATING, 10.0))
    share = FLOATING["mass"] / (RHO * np.pi / 4 * FLOATING["diameter"] ** 2)
    s = brentq(lambda s: s * s * (3 - 2 * s) - share, 0.0, 1.0)
    # the links beside the held ends slope, and are wet over more than their diameter
    np.testing.assert_allclose(pose.positions[10:-1, 2], (0.5 - s) * FLOATING["diameter"], atol=1e-7)
    np.testing.assert_allclose(pose.tension, 0.0, atol=1e-6)


@pytest.mark.check
def test_a_slack_rope_along_a_current_streams_behind_the_point_that_is_farther_down():
    pose = found(scene(20.0, 20, [0.0] * 3, [10.0, 0.0, 0.0], FLOATING, 10.0, speed=1.0))
    assert np.max(pose.positions[:, 0]) == pytest.approx(15.0, abs=0.1)
    skin = 0.5 * RHO * FLOATING["cdt"] * np.pi * FLOATING["diameter"]  # per length, whole round in the water at most
    assert pose.tension[0] < 15.0 * skin
    assert pose.tension[0] > 0.6 * 15.0 * skin
    assert np.max(np.abs(pose.positions[:, 1])) < 0.5


@pytest.mark.check
def test_eleven_lines_on_one_float_share_what_it_lifts():
    lines, depth, out = 11, 20.0, 20.0
    angle = 2 * np.pi * np.arange(lines) / lines
    points = [fixed(f"a{i}", *(out * np.cos(a), out * np.sin(a), -depth)) for i, a in enumerate(angle.tolist())]
    table = system(
        [*points, free("hub", 0.0, 0.0, -0.5, mass=100.0, volume=1.0)],
        [line_of(f"l{i}", f"a{i}", "hub", 8, 34.0, type="chain") for i in range(lines)],
        line_type=[{"name": "chain", **CHAIN}],
        sea={"depth": depth},
        effects={"weight": {}, "buoyancy": {}, "seabed": {}},
    )
    pose = found(table)
    tension, place = pose.tension.reshape(lines, 8), pose.positions.reshape(lines, 9, 3)
    np.testing.assert_allclose(tension, tension[:1].repeat(lines, axis=0), rtol=1e-6, atol=1e-6)
    last = place[:, -1] - place[:, -2]
    pull = -np.sum(tension[:, -1] * last[:, 2] / np.linalg.norm(last, axis=1))
    # a sphere of the volume, its wet share smoothed over its diameter; half a link of each line hangs on it
    s = np.clip(0.5 - place[0, -1, 2] / np.cbrt(6 / np.pi + 1e-6), 0.0, 1.0)
    lift = RHO * G * s * s * (3 - 2 * s) - 100.0 * G
    half = 0.5 * 34.0 / 8 * G * (CHAIN["mass"] - RHO * np.pi / 4 * CHAIN["diameter"] ** 2)
    assert lift + pull == pytest.approx(lines * half, rel=2e-2)  # the half links are not wholly under water


def valley(speed):
    """A clump weight on a slack rope, beside the bottom of a valley along x whose sides meet at an angle."""
    bed = {"bed_x": [-20.0, 20.0], "bed_y": [-10.0, 0.0, 10.0], "bed_depth": [6.0, 10.0, 6.0] * 2}
    return system(
        [fixed("a", 0.0, -4.0, -8.0), free("clump", 2.0, -2.0, -8.0, mass=30.0, volume=0.005)],
        [line_of("rope", "a", "clump", 6, 9.0, type="rope")],
        line_type=[{"name": "rope", "mass": 1.2, "diameter": 0.03, "EA": 1e6, "cdn": 1.2, "cdt": 0.02}],
        sea={"depth": 10.0, "current": {"kind": "uniform", "speed": speed, "direction": 0.7}},
        effects={"weight": {}, "buoyancy": {}, "morison_drag": {}, "seabed": bed},
    )


@pytest.mark.check
def test_a_weight_comes_to_rest_in_the_bottom_of_a_valley():
    pose = found(valley(0.0))
    x, y, z = pose.positions[-1]
    assert abs(y) < 0.2  # where the sides are rounded into each other
    assert z == pytest.approx(-10.0, abs=0.05)


@pytest.mark.check
def test_slow_motion_ends_where_descent_does_with_the_stiffness_of_all_forces():
    model = rest(build_model(dj.load_scene(valley(0.8))))
    loads, tolerance = jnp.zeros((model.free_nodes, 3)), system_tolerance(model)
    s, residual = find_rest(model, straight_guess(model), loads, tolerance)
    assert residual <= tolerance

    @jax.jit
    def forces(r):
        rows = lambda r: unbalanced(model, replace(s, r=r.reshape(s.r.shape)), loads)[0].ravel()  # noqa: E731
        return rows(r), jax.jacfwd(rows)(r)

    _, exact = forces(s.r.ravel())
    np.testing.assert_allclose(stiffness(model, s, loads).toarray(), exact, rtol=1e-9, atol=1e-6)
    r, drag = straight_guess(model).r.ravel(), 1e4
    for _ in range(SLOW_STEPS):  # implicit Euler through something ever less viscous
        rows, matrix = forces(r)
        r, drag = r - jnp.linalg.solve(matrix + drag * jnp.eye(r.size), rows), 0.97 * drag
    np.testing.assert_allclose(r.reshape(s.r.shape), s.r, atol=1e-6)


@pytest.mark.check
def test_random_longlines_are_found_balanced_and_stable():
    rows = [layouts.judged(seed) for seed in range(48)]
    assert [row["name"] for row in rows if not row["ok"]] == []


def test_links_that_push_hang_like_a_rope_instead_of_a_column():
    links, length, weight = 12, 2.0 / 12, 0.2 * G
    line = line_of("line", "a", "b", links, length, mass=0.2, nodes="shared", axial={"law": "elastic", "EA": 1e6})
    pose = found(system([fixed("a", 0.0, 0.0, 0.0), fixed("b", 0.0, 0.0, 1.2)], [line]))
    force = pose.tension[:, None] * np.diff(pose.positions, axis=0) / length
    assert np.diff(force, axis=0) == pytest.approx(np.tile([0.0, 0.0, weight], (links - 1, 1)), abs=1e-3)
    assert np.max(np.abs(pose.tension)) < links * weight  # a column of these links has 4e5 N


def test_a_heavy_buoy_on_a_thread_floats_at_the_draught_of_archimedes():
    mass = RHO * np.pi / 4 * 5.0
    thread = {"mass": 1e-5, "diameter": 1e-5, "axial": {"law": "rope", "EA": 1e-2}}
    pose = found(
        system(
            [fixed("a", 0.0, 0.0, -20.0), free("b", 0.0, 0.0, -5.0)],
            [line_of("line", "a", "b", 4, 5.0, **thread)],
            sea={"depth": 20.0},
            buoy=[{"name": "spar", "point": "b", "mass": mass, "diameter": 1.0, "height": 8.0}],
            effects={"weight": {}, "buoyancy": {}},
        )
    )
    assert pose.positions[-1, 2] == pytest.approx(-5.0, rel=1e-5)
