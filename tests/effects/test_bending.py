"""Bending stiffness against the beam's closed forms."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.integrate import solve_bvp

import dropper_jax as dj
from dropper_jax import build, build_model, equilibrium, load_scene, make_stepper, simulate
from dropper_jax.effects import Bending


def rod(weight, **more):
    """A list of one type of line, of this weight per length [N/m]."""
    return [{"name": "rod", "mass": weight / 9.81, "diameter": 0.02, "EA": 1e4, "law": "elastic", **more}]


def beam(links, weight=0.1, EI=1e4):
    """A pinned beam of 10 m, so stiff that its own tension does not carry."""
    points = [fixed("a", 0.0, 0.0, 0.0), fixed("b", 10.0, 0.0, 0.0)]
    lines = [line_of("beam", "a", "b", links, 10.0, type="rod")]
    return system(points, lines, line_type=rod(weight), effects={"weight": {}, "bending": {"EI": EI}})


#: Sag of the beam at its middle [m].
SAG = 5 * 0.1 * 10.0**4 / (384 * 1e4)


def test_a_pinned_beam_sags_by_5_w_l4_over_384_ei():
    error = []
    for links in (8, 16):
        pose = equilibrium(beam(links))
        assert pose.status == "ok", pose.message
        error.append(abs(-np.min(pose.positions[:, 2]) / SAG - 1))
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(4.0, abs=0.3)


def halves(turned, **bending):
    """The pinned beam in two lines of 8 links, the second from the middle on or, turned, from the far end."""
    table = beam(8)
    table["point"].append(free("middle", 5.0, 0.0, 0.0))
    ends = ("b", "middle") if turned else ("middle", "b")
    table["line"] = [line_of("left", "a", "middle", 8, 5.0, type="rod"), line_of("right", *ends, 8, 5.0, type="rod")]
    table["effects"]["bending"] |= bending
    return table


@pytest.mark.check
@pytest.mark.parametrize("turned", [False, True])
def test_joined_lines_bend_as_one(turned):
    table = halves(turned, joined=[["left", "right"]])
    pose = equilibrium(table)
    assert pose.status == "ok", pose.message
    assert -np.min(pose.positions[:, 2]) == pytest.approx(SAG, rel=5e-3)
    run = simulate(table, dt=0.01, duration=0.1)
    middle = [8, 17 if turned else 9]
    assert np.allclose(run.bending_moment[-1, middle], 0.1 * 10.0**2 / 8, rtol=5e-3)


def test_lines_that_are_not_joined_meet_in_a_hinge():
    assert -np.min(equilibrium(halves(False)).positions[:, 2]) > 2.0 * SAG


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        (["rihgt"], "effects.bending.joined.0: 'rihgt' is not a line; did you mean 'right'"),
        (["right", "left"], "effects.bending.joined.1: 'left' and 'left' do not meet in one point"),
        (["right", "right"], "effects.bending.joined.1: 'left' and 'right' are listed twice"),
    ],
)
def test_lines_that_cannot_be_joined_are_refused(others, reason, refusal):
    assert reason in refusal(load_scene, halves(False, joined=[["left", other] for other in others]))


def test_energy_of_a_bent_circle_is_ei_over_2_r2_per_length_and_the_force_its_gradient():
    radius, links = 5.0, 100
    model = build_model(load_scene(beam(links, EI=200.0)))
    turn = np.linspace(0.0, 10.0 / radius, links + 1)
    circle = radius * np.stack([np.sin(turn), 0 * turn, 1 - np.cos(turn)], axis=1)
    model_at = model.kinematics(jnp.asarray(circle[1:-1]), jnp.zeros((links - 1, 3)), jnp.zeros(()))
    bending = model.effect("bending")
    assert isinstance(bending, Bending)
    # the two half links at pinned ends carry no moment; the last node is the scene's, off the circle: leave both out
    energy = jax.jit(lambda r: bending.potential(model.kinematics(r, 0 * r, jnp.zeros(()))))
    inner = float(energy(model_at.r))
    ends = model_at.nodes[-2:] - model_at.nodes[-3:-1]
    unit = ends / np.linalg.norm(ends, axis=1, keepdims=True)
    last = 200.0 / (2 * 0.1) * float(jnp.sum((unit[1] - unit[0]) ** 2))
    assert inner - last == pytest.approx(200.0 / (2 * radius**2) * 10.0 * (links - 2) / links, rel=1e-3)
    force, size = bending.force(model_at), 1e-6
    for node, axis in ((10, 0), (50, 2), (97, 1)):
        shift = jnp.zeros_like(model_at.r).at[node, axis].set(size)
        slope = (energy(model_at.r + shift) - energy(model_at.r - shift)) / (2 * size)
        assert float(force[node, axis]) == pytest.approx(-float(slope), rel=1e-5, abs=1e-4)


@pytest.mark.check
def test_a_line_with_bending_runs_and_keeps_its_energy():
    scene = beam(4, weight=20.0, EI=200.0)
    scene["point"][1] |= {"position": [9.9, 0.0, 0.0], "kind": "free", "mass": 1.0}
    scene["start"] = {"kind": "points"}
    solution = simulate(scene, dt=0.005, duration=0.5)
    assert solution.status == "ok", solution.failure
    # the axial law takes what it cannot resolve; bending itself is of second order, not exact
    assert solution.energy_drift < 5e-2 * solution.energy_scale
    assert np.max(np.diff(solution.balance)) < 1e-4 * solution.energy_scale


def cantilever(links, EI=200.0, load=2e-4, tip=0.0, **more):
    """A rod of 10 m clamped at its left end: of weight `load` per length, with `tip` at its free end [N]."""
    scene = beam(links, EI=EI) | {"run": {"dt": 0.01, "duration": 0.05}, "line_type": rod(load, EA=1e5), **more}
    scene["point"][1] = free("b", 10.0, 0.0, 0.0, **({"mass": tip / 9.81} if tip else {}))
    scene["effects"]["bending"] |= {"clamped": ["a"], "directions": [[2.0, 0.0, 0.0]]}
    return scene


LOAD, TIP = 2e-6, 0.01


@pytest.fixture(scope="module")
def loaded():
    """A cantilever of 16 links with a force at its tip."""
    return simulate(cantilever(16, load=LOAD, tip=TIP))


def test_a_cantilever_has_its_closed_form_deflection_moment_and_curvature(loaded):
    EI, length = 200.0, 10.0
    assert loaded.settings["solver"] == "network"
    sag = TIP * length**3 / (3 * EI) + LOAD * length**4 / (8 * EI)
    assert -loaded.positions[0, -1, 2] == pytest.approx(sag, rel=0.0025)
    beyond = np.linspace(length, 0.0, 17)
    moment = TIP * beyond + 0.5 * LOAD * beyond**2
    np.testing.assert_allclose(loaded.bending_moment[0], moment, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(loaded.curvature[0], moment / EI, rtol=1e-4, atol=1e-12)
    found = loaded.summary()["bending"]["beam"]
    assert found["at_m"] == 0.0
    assert found["least_radius_m"] == pytest.approx(EI / moment[0], rel=0.01)


@pytest.mark.check
def test_a_single_line_is_clamped_as_systems_are():
    links, mass, EI, length = 20, 1e-4, 200.0, 10.0
    table = cantilever(links, EI)
    del table["line_type"]
    own = {"mass": mass / links, "diameter": 0.02, "axial": {"law": "elastic", "EA": 1e5}}
    table["line"] = [line_of("beam", "a", "b", links, length / links, **own)]
    solution = simulate(table)
    assert solution.settings["solver"] == "banded"
    x = np.linspace(0.0, length, links + 1)
    # every node but the first carries the weight of the link before it
    moment = [9.81 * mass / links * np.sum(x[x > at] - at) for at in x]
    np.testing.assert_allclose(solution.bending_moment[0], moment, rtol=1e-3, atol=1e-9)


@pytest.mark.check
def test_a_heavy_cantilever_is_the_elastica_that_scipy_finds():
    load, EI, length = 1.0, 200.0, 10.0  # w L^3/EI = 5: it hangs down by half its length
    # EI theta'' = w (L - s) cos theta, theta upwards: the moment EI theta' falls by the weight beyond
    rod = lambda s, y: np.array([y[1], load * (length - s) * np.cos(y[0]) / EI])  # noqa: E731
    s = np.linspace(0.0, length, 401)
    guess = np.stack([-0.1 * s, -0.1 + 0 * s])
    exact = solve_bvp(rod, lambda a, b: np.array([a[0], b[1]]), s, guess, tol=1e-8)
    assert exact.success
    theta = exact.sol(s)[0]
    tip = np.array([np.trapezoid(np.cos(theta), s), np.trapezoid(np.sin(theta), s)])
    pose = equilibrium(cantilever(32, EI, load, tip=1e-6))
    assert pose.status == "ok", pose.message
    np.testing.assert_allclose(np.asarray(pose.positions)[-1][[0, 2]], tip, atol=0.01 * length)
    assert np.linalg.norm(np.asarray(pose.positions)[-1][[0, 2]] - tip) < 0.01 * np.linalg.norm(tip - [length, 0.0])


def frame(rigid=False, links=5):
    """Three lines that meet at a point, one of them clamped; all are slack, as rigid links that bend must be."""
    own = {"law": "rigid"} if rigid else {"EA": 1e5, "law": "elastic"}
    points = [fixed("a", 0.0, 0.0, 0.0), free("b", 5.0, 0.0, 0.0, mass=2.0), fixed("c", 9.5, 0.0, 0.0)]
    lines = [
        line_of("left", "a", "b", links, 5.2),
        line_of("right", "b", "c", links, 5.0),
        line_of("down", "b", "d", 2, 4.2),
    ]
    bending = {"clamped": ["c"], "directions": [[-1.0, 0.0, 0.3]], "joined": [["left", "right"], ["down", "right"]]}
    return system(
        [*points, free("d", 5.0, 0.0, -4.0, mass=3.0)],
        [one | {"type": "rod"} for one in lines],
        line_type=[{"name": "rod", "mass": 1.0, "diameter": 0.02, "EI": 50.0, **own}],
        effects={"weight": {}, "bending": bending},
        start={"kind": "points"},
    )


@pytest.mark.check
@pytest.mark.parametrize("rigid", [False, True])
def test_the_network_holds_bending_exactly(network_is_exact, rigid):
    network_is_exact(*build(frame(rigid)), 0.05)


@pytest.mark.check
def test_derivatives_by_stiffness_and_clamp_are_those_of_differences_both_ways(slopes_of):
    model, s = build(frame(links=3))
    stepper = make_stepper(model, halvings=0)
    assert stepper.solver_name == "network"

    def height(x):
        weight, bending = model.effects[:2]
        changed = replace(bending, EI=bending.EI * x[0], directions=bending.directions + x[1] * jnp.array([0.0, 0, 1]))
        last, _ = dj.integrate(stepper, replace(model, effects=(weight, changed, *model.effects[2:])), s, 0.01, 20)
        return jnp.sum(last.r[:, 2] * jnp.arange(1.0, 1.0 + len(last.r)))

    slopes_of(height, jnp.array([1.0, 0.0]))


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"clamped": ["b"], "directions": [[1, 0, 0]]}, "'b' is not a fixed point"),
        ({"clamped": ["a"]}, "directions: has 0 entries; allowed: one for each of the 1"),
        ({"clamped": ["a"], "directions": [[0, 0, 0]]}, "has no direction"),
        ({"clamped": ["a", "a"], "directions": [[1, 0, 0]] * 2}, "'a' is listed twice"),
    ],
)
def test_clamps_that_make_no_sense_are_refused(more, reason, refusal):
    assert reason in refusal(load_scene, cantilever(4) | {"effects": {"bending": {"EI": 1.0, **more}}})


def test_moments_go_to_netcdf_vtk_json_and_the_report(tmp_path, loaded):
    solution = loaded
    data = solution.to_xarray()
    np.testing.assert_array_equal(data["bending_moment"], solution.bending_moment)
    assert data["curvature"].attrs["units"] == "m-1"
    dj.write_vtk(solution, tmp_path)
    assert 'Name="bending_moment"' in (tmp_path / "lines_000000.vtp").read_text()
    run = dj.report_run(solution)["bending"][0]
    assert run["largest_moment_n_m"] == pytest.approx(np.max(solution.bending_moment[:]), rel=1e-6)


@pytest.mark.check
def test_work_of_a_clamp_that_moves_is_in_the_balance():
    scene = cantilever(4, EI=200.0, load=2.0, tip=5.0)
    scene["effects"]["end_motion"] = {"point": "a", "time": [0.0, 1.0], "displacement": [[0.0] * 3, [0.0, 0.5, 1.0]]}
    ran = simulate(scene, dt=0.01, duration=0.6)
    assert ran.status == "ok", ran.failure
    done = ran.work[-1, list(ran.work_names).index("moving_ends")]
    assert done > 0.1 * ran.energy_scale  # the clamp lifts the rod by its moment and its shear
    assert ran.energy_drift < 0.01 * ran.energy_scale
