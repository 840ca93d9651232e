"""Response in the frequency domain: closed forms of a hanging mass with drag, rigid links, the command, wrong input."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj

#: Mass [kg] on a line of one link [m], axial stiffness [N], quadratic drag [kg/m], gravity [m/s^2].
MASS, LENGTH, EA, DRAG, GRAVITY = 200.0, 5.0, 4000.0, 300.0, 9.81
STATES = ((0.2, 4.0), (1.0, 5.0), (4.0, 5.0))


def hanging_mass(**line):
    """A mass below a point that follows the surface, in water that acts on it by `quadratic_damping` alone."""
    waves = {"kind": "spectrum", "hs": 1.0, "tp": 6.0, "count": 20, "direction": 0.0, "gamma": 2.0}
    return system(
        [fixed("top", 0.0, 0.0, 0.0), free("end", 0.0, 0.0, -LENGTH, mass=MASS, volume=0.0)],
        [line_of("line", "top", "end", 1, LENGTH, type="rope")],
        dt=0.02,
        line_type=[{"name": "rope", "mass": 1e-3, "diameter": 0.02, "damping_ratio": 0.0, "EA": EA} | line],
        sea={"depth": 50.0, "ramp": 10.0, "waves": waves},
        effects={
            "weight": {"gravity": GRAVITY},
            "quadratic_damping": {"b_q": DRAG},
            "sea_following_end": {"point": "top", "heave": 1.0, "surge": 0.0},
        },
    )


@pytest.fixture(scope="module")
def response():
    return dj.frequency_response(hanging_mass(), STATES)


def closed_form(omega, amplitude, mass):
    """Amplitudes of the mass, by the fixed point of c = sqrt(8/pi) b sigma, in scalars."""
    stiffness, damping = EA / LENGTH, 0.0
    for _ in range(200):
        x = stiffness * amplitude / (stiffness - mass * omega**2 + 1j * omega * damping)
        speed = np.sqrt(0.5 * np.sum(np.abs(omega * x) ** 2))
        damping = 0.5 * (damping + np.sqrt(8.0 / np.pi) * DRAG * speed)
    return x, stiffness * (amplitude - x)


@pytest.mark.check
@pytest.mark.parametrize("state", range(len(STATES)))
def test_hanging_mass_with_quadratic_drag_is_the_scalar_fixed_point(response, state):
    omega, hs = response.omega[state], STATES[state][0]
    # the JONSWAP shape with gamma 2 in even steps of 0.5 to 4 peak frequencies, integrated here on a fine grid
    fine = np.linspace(0.5, 4.0, 40 * 500 + 1)
    middle = 0.5 * (fine[1:] + fine[:-1])
    width = np.where(middle <= 1.0, 0.07, 0.09)
    density = middle**-5.0 * np.exp(-1.25 * middle**-4.0) * 2.0 ** np.exp(-((middle - 1.0) ** 2) / (2 * width**2))
    share = density.reshape(40, 500).sum(1) / density.sum()
    amplitude = hs / 4.0 * np.sqrt(2.0 * share)
    x, tension = closed_form(omega, amplitude, MASS + 0.5e-3 * LENGTH)
    assert response.status[state] == ("not_linear" if response.slack[state].any() else "ok")
    assert response.basis_error < 1e-3
    # the mean over directions is right within 2 %
    np.testing.assert_allclose(
        np.abs(response.motion[state, :, 0, 2]), np.abs(x), rtol=0.02, atol=0.01 * np.max(np.abs(x))
    )
    deviation = np.sqrt(0.5 * np.sum(np.abs(tension) ** 2))
    np.testing.assert_allclose(response.tension_deviation[state], deviation, rtol=0.01)
    period = 2 * np.pi * deviation / np.sqrt(0.5 * np.sum(np.abs(omega * tension) ** 2))
    np.testing.assert_allclose(response.tension_period[state], period, rtol=0.01)
    maximum = MASS * GRAVITY + deviation * np.sqrt(2 * np.log(10800.0 / period))
    np.testing.assert_allclose(response.maximum_tension[state], maximum, rtol=0.01)
    assert response.slack[state, 0] == (3.0 * deviation > MASS * GRAVITY)


@pytest.mark.check
def test_spectra_integrate_to_the_variances(response):
    omega, tension, motion = response.spectra(1)
    width = np.gradient(omega)
    np.testing.assert_allclose(np.sqrt(width @ tension), response.tension_deviation[1], rtol=1e-10)
    np.testing.assert_allclose(np.sqrt(width @ motion[:, 0, 2]), response.motion_deviation[1, 0, 2], rtol=1e-10)


@pytest.mark.check
def test_rigid_link_carries_the_inertia_of_its_mass():
    """Own waves of a scene: the mass follows its end, so that T = m w^2 a without drag."""
    scene = hanging_mass(mass=1.0, law="rigid")
    del scene["line_type"][0]["EA"], scene["line_type"][0]["damping_ratio"]
    scene["effects"]["quadratic_damping"]["b_q"] = 0.0
    found = dj.frequency_response(scene)
    amplitude = np.abs(found.motion[0, :, 0, 2])
    assert 4.0 * np.sqrt(0.5 * np.sum(amplitude**2)) == pytest.approx(1.0, rel=1e-3)
    mass = float(dj.build(scene)[0].node_mass[-1])
    np.testing.assert_allclose(np.abs(found.tension[0, :, 0]), mass * found.omega[0] ** 2 * amplitude, rtol=1e-3)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mass") / "mass.toml"
    path.write_text(dj.as_toml(hanging_mass()))
    return str(path)


def test_command_prints_writes_and_draws(file, tmp_path, printed, json_of):
    table = tmp_path / "states.csv"
    table.write_text("hs,tp\n0.2,4\n1,5\n4,5\n")
    words = ["frequency", file, "--table", str(table), "--duration", "3600", "--json"]
    found = json_of([*words, "--out", str(tmp_path / "o.json"), "--plot", str(tmp_path / "o.png")], 3)
    assert found == json.loads((tmp_path / "o.json").read_text())
    assert (tmp_path / "o.png").stat().st_size > 1000
    assert [row["slack_lines"] for row in found["states"]] == [[], [], ["line"]]
    assert [row["status"] for row in found["states"]] == ["ok", "ok", "not_linear"]
    assert found["status"] == "not_linear"
    assert found["states"][0]["ends"][0]["static_tension_n"] == pytest.approx(MASS * GRAVITY, rel=1e-4)
    assert "most probable maximum [N]" in printed(["frequency", file, "--sea-states", "0.2:4,1:5"]).out


@pytest.mark.check
def test_runs_in_time_are_reported_with_the_response(file, json_of):
    """Linear waves on a spring with drag: the run has the same deviation within the error of the linearisation."""
    words = ["--sea-states", "0.2:4,0.5:5,1:5", "--frequencies", "20", "--runs", "2", "--json"]
    runs = json_of(["frequency", file, *words])["runs"]
    assert [(run["hs_m"], run["tp_s"]) for run in runs] == [(1.0, 5.0), (0.2, 4.0)]
    for run in runs:
        np.testing.assert_allclose(run["mean_tension_n"], MASS * GRAVITY, rtol=0.01)
        assert np.max(np.abs(run["deviation_difference"])) < 0.1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--runs", "2"], "--runs: needs sea states"),
        (["--sea-states", "1:2:3"], "--sea-states: '1:2:3' is not HS:TP"),
        (["--sea-states", "0:5"], "--sea-states: a height or period is missing or not positive"),
        (["--table", "missing.csv"], "--table: missing.csv: No such file"),
        (["--duration", "0"], "--duration: 0 is out of range"),
    ],
)
def test_wrong_input_is_rejected_in_one_line(file, words, message, refused):
    assert message in refused(["frequency", file, *words])


def test_scenes_without_irregular_waves_are_rejected():
    scene = hanging_mass()
    scene["sea"]["waves"] = {"kind": "regular", "amplitude": 1.0, "period": 6.0}
    with pytest.raises(dj.SceneError, match="sea.waves: is not an irregular linear sea"):
        dj.frequency_response(scene)
    scene["effects"] = {"weight": {}, "end_motion": {"point": "top", "amplitude": [0.0, 0.0, 1.0], "period": 5.0}}
    with pytest.raises(dj.SceneError, match="effects.end_motion: its motion does not come from the sea"):
        dj.frequency_response(scene, STATES)


@pytest.mark.check
def test_slack_chain_on_the_seabed_is_flagged_not_an_error():
    """A float over a chain that is longer than the depth: what lies on the bed has no stiffness across itself."""
    chain = {"name": "chain", "mass": 10.0, "diameter": 0.04, "damping_ratio": 0.1, "EA": 1e7, "cdn": 1.4}
    scene = system(
        [fixed("anchor", 0.0, 0.0, -10.0), free("float", 3.0, 0.0, -2.0, mass=20.0, volume=0.12)],
        [line_of("leg", "anchor", "float", 7, 14.0, type="chain")],
        line_type=[chain],
        sea={"depth": 10.0, "waves": {"kind": "spectrum", "hs": 0.3, "tp": 5.0, "count": 10}},
        effects={"weight": {}, "buoyancy": {}, "seabed": {}, "morison_drag": {}, "morison_inertia": {}},
    )
    found = dj.frequency_response(scene)
    assert found.slack.all()
    assert np.isfinite(found.mean_tension).all()
    assert np.isfinite(found.tension_deviation).all()


@pytest.mark.check
def test_derivatives_of_the_deviation_are_those_of_differences(slopes_of):
    """By relative changes of stiffness, drag and length of the hanging mass in few waves."""
    scene = hanging_mass()
    scene["sea"]["waves"]["count"] = 6
    model, start = dj.build(scene)
    drag = model.effect("quadratic_damping")

    def deviation(changes):
        stiffer, rougher, longer = 1.0 + changes
        line = model.line
        axial = dataclasses.replace(line.axial, EA=line.axial.EA * stiffer)
        line = dataclasses.replace(line, axial=axial, length=line.length * longer)
        effects = [dataclasses.replace(drag, b_q=drag.b_q * rougher) if e is drag else e for e in model.effects]
        own = dataclasses.replace(model, lines=(line,), effects=tuple(effects))
        return dj.tension_deviation(own, dj.settle(own, start))[1][0]

    slopes_of(deviation, jnp.zeros(3), rel=1e-6, modes=1e-8)


@pytest.mark.parametrize(
    ("scene", "given", "message"),
    [
        ("ballasted-spar", {}, "body: rigid bodies are not accurate in the frequency domain"),
        ("string", {"frequencies": 0}, "frequencies: 0 is out of range; allowed: 1 or more"),
        ("string", {"direction": np.nan}, "direction: nan is not finite"),
        ("string", {"direction": np.inf}, "direction: inf is not finite"),
        ("string", {"duration": -1.0}, "duration: -1.0 is not positive; allowed: > 0 s"),
        ("string", {"duration": np.nan}, "duration: nan is not positive; allowed: > 0 s"),
    ],
)
def test_what_has_no_response_is_refused_in_one_line(refusal, scene, given, message):
    assert refusal(dj.frequency_response, scene, STATES, **given).startswith(message)
