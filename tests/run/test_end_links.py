"""Forces of lines on points in air, in water and at the surface, against an elastic catenary by shooting."""

import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import dropper_jax as dj
from dropper_jax import report_run
from dropper_jax.decks.writing.outputs import write_out
from dropper_jax.quantities.end_forces import end_force_vectors
from dropper_jax.quantities.quantity_names import static_quantity
from dropper_jax.scene import line_slices
from dropper_jax.study.design import solve_design
from dropper_jax.study.offsets import offset_curves

G, RHO, EA = 9.81, 1025.0, 2e6


def scene(first, last, length, links, mass=20.0, diameter=0.3, **more):
    """A hose by the metre between two points."""
    return scene_of(
        {"a": first, "b": last},
        line_of("line", "a", "b", links, length, type="hose"),
        line_type=[{"name": "hose", "mass": mass, "diameter": diameter, "EA": EA, "damping_ratio": 0.9}],
        **{"sea": {"depth": 30.0, "density": RHO}, "effects": {"weight": {}, "buoyancy": {}}, **more},
    )


def shoot(first, last, length, mass, diameter, guess):
    """Forces (2, 3) [N] of an elastic catenary on its two points; it loses its buoyancy above z = 0."""
    area = np.pi / 4 * diameter**2

    def slopes(s, state):
        x, z, up = state
        pull = np.hypot(across, up)
        stretch = 1.0 + pull / EA
        weight = G * (mass - (RHO * area if z < 0.0 else 0.0))
        return [stretch * across / pull, stretch * up / pull, weight]

    def miss(unknown):
        nonlocal across
        across = unknown[0]
        end = solve_ivp(slopes, (0.0, length), [first[0], first[2], unknown[1]], rtol=1e-9, max_step=0.05).y[:, -1]
        return end[0] - last[0], end[1] - last[2]

    across = guess[0]
    across, up = fsolve(miss, guess)
    top = solve_ivp(slopes, (0.0, length), [first[0], first[2], up], rtol=1e-9, max_step=0.05).y[2, -1]
    return np.array([[across, 0.0, up], [-across, 0.0, -top]])


@pytest.fixture(scope="module")
def hose():
    return scene([0.0, 0.0, 9.0], [20.0, 0.0, 9.0], 22.0, 10)


@pytest.fixture(scope="module")
def dry():
    """Force [N] on either point of a line in air."""
    exact = shoot([0.0, 0.0, 9.0], [20.0, 0.0, 9.0], 22.0, 20.0, 0.3, (2500.0, -2100.0))
    assert np.linalg.norm(exact[0]) == pytest.approx(3338.8, abs=0.1)
    return float(np.linalg.norm(exact[0]))


def test_every_table_has_the_force_of_a_line_in_air_on_its_points(hose, dry, tmp_path, json_of, file_of):
    found = json_of(["equilibrium", file_of(hose), "--json"])
    assert found["end_forces_n"]["line"]["first"] == pytest.approx(dry, rel=0.003)
    run = dj.simulate(hose)
    row = offset_curves(dj.load_scene(hose), ["b"], [0.0], [0.0])[0]
    design = solve_design(hose, "line.line.length", 21.8, 22.2, "tension.line.max", found["tension_n"][0])
    report = report_run(run)
    table = tmp_path / "run.out"
    write_out(run, table, ["FairTen1", "AnchTen1"])
    values = {
        "run": run.end_forces()["line"]["last"]["mean"],
        "summary": run.summary()["end_forces_n"]["line"]["first"]["max"],
        "report": report["tension"][0]["mean_last_force_n"],
        "anchors": report["anchors"][0]["total_n"]["mean"],
        "offset": row["end_tension_n"],
        "design": design.end_forces[1],
        "fairlead": np.loadtxt(table, skiprows=2)[-1, 1],
    }
    for name, value in values.items():
        assert value == pytest.approx(dry, rel=0.003), name
    # design and sweeps take the same force on a point as tables of equilibria
    model, _ = dj.build(hose)
    pose = dj.equilibrium(dj.load_scene(hose))
    total = static_quantity("anchor.a.total", model, "target").of_pose(model, pose.state)
    assert float(total) == pytest.approx(found["end_forces_n"]["line"]["first"], rel=1e-9)


HEAVY = {"mass": 90.0, "diameter": 0.3, "links": 44}
WET_AND_DRY = {
    "dry and wet": ([0.0, 0.0, 8.0], [14.0, 0.0, -9.0], 22.0, HEAVY),
    "dry, down to the surface": ([0.0, 0.0, 8.0], [4.0, 0.0, 0.0], 9.2, {"mass": 20.0, "diameter": 0.1, "links": 40}),
    "half wet": ([0.0, 0.0, 0.1], [14.0, 0.0, -9.0], 17.6, HEAVY),
}


@pytest.mark.check
@pytest.mark.parametrize(("first", "last", "length", "kind"), WET_AND_DRY.values(), ids=WET_AND_DRY.keys())
def test_a_line_out_of_the_water_has_its_weight_above_the_surface_only(first, last, length, kind):
    exact = shoot(first, last, length, kind["mass"], kind["diameter"], (6000.0, -12000.0))
    line = dj.load_scene(scene(first, last, length, **kind))
    pose = dj.equilibrium(line)
    found = end_force_vectors(line, pose.positions[None], pose.tension[None], line_slices(line))["line"][0]
    size = np.linalg.norm(exact, axis=1)
    assert np.abs(found - exact).max() < 0.01 * size.max()
    assert np.linalg.norm(found, axis=1) == pytest.approx(size, rel=0.003)


def test_ropes_of_a_float_at_the_surface_pull_with_their_weight_in_water():
    anchors = [-8.0, 0.0, -5.0], [8.0, 0.0, -5.0]
    ropes = scene(*anchors, 14.0, 28, mass=12.0, diameter=0.06)
    buoy = {"name": "float", **free_at([0.0, 0.0, -0.1], mass=20.0, volume=0.2)}
    rope = ropes["line"][0]
    ropes["line"] = [rope | {"name": "left", "to": "float"}, rope | {"name": "right", "from": "float"}]
    ropes["point"] += [buoy]
    ropes = dj.load_scene(ropes)
    pose = dj.equilibrium(ropes)
    left, right = line_slices(ropes)
    top = pose.positions[left.nodes.stop - 1]
    assert abs(top[2]) < 0.3  # the float is at the surface
    exact = shoot(anchors[0], top, 14.0, 12.0, 0.06, (300.0, -200.0))
    found = end_force_vectors(ropes, pose.positions[None], pose.tension[None], (left, right))
    assert np.linalg.norm(found["left"][0], axis=1) == pytest.approx(np.linalg.norm(exact, axis=1), rel=0.003)
    # and the float carries them
    s = 0.5 - top[2] / np.cbrt(6.0 * 0.2 / np.pi)
    lift = G * (RHO * 0.2 * s**2 * (3.0 - 2.0 * s) - 20.0)
    assert found["left"][0, 1, 2] + found["right"][0, 0, 2] == pytest.approx(-lift, rel=0.01)


def test_the_end_of_a_line_is_wet_under_crests_and_below_the_level():
    waves = {"kind": "regular", "amplitude": 2.0, "period": 8.0}
    line = scene([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], 3.0, 2, sea={"depth": 30.0, "density": RHO, "waves": waves})
    line = dj.load_scene(line)
    nodes = np.array([[0.0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]])
    t = np.array([0.0, 4.0])  # crest, trough
    vectors = end_force_vectors(line, np.stack([nodes, nodes]), np.full((2, 2), 10.0), line_slices(line), t)
    up = vectors["line"][:, 0, 2]
    half = 0.75 * G * np.array([RHO * np.pi / 4 * 0.3**2 - 20.0, -20.0])
    assert up == pytest.approx(half, rel=1e-6)
    sea = {"depth": 30.0, "density": RHO, "level": {"offset": 1.0}}
    tide = dj.load_scene(scene([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], 3.0, 2, sea=sea))
    vectors = end_force_vectors(tide, nodes[None], np.full((1, 2), 10.0), line_slices(tide))
    assert vectors["line"][0, 0, 2] == pytest.approx(half[0], rel=1e-6)
