"""Modes of links that keep their length, and damping ratios, against closed forms and against elastic links."""

import numpy as np
import pytest
from hard_scenes import hung_line
from scipy.linalg import eigh

import dropper_jax as dj
from dropper_jax import natural_modes
from dropper_jax.cli import main
from dropper_jax.statics.modes import damping_at

G = 9.81


def hanging(masses, lengths, effects, axial=None):
    """Point masses below each other, each on a link without mass."""
    own = {"nodes": "far"} | ({} if axial is None else {"axial": axial})
    return hung_line(len(masses), list(lengths), list(masses), **own) | {"effects": {"weight": {}, **effects}}


def modes_of(scene, count=None):
    model, _ = dj.build(scene)
    pose = dj.equilibrium(model)
    assert pose.status == "ok"
    return model, pose.state, natural_modes(model, pose.state, count)


def test_a_double_pendulum_has_the_periods_and_damping_ratios_of_its_two_by_two_matrices():
    masses, lengths, b_l = np.array([0.3, 0.2]), np.array([0.7, 0.4]), 0.05
    # moves across, u1 and u2: tensions are the weights below
    pull = G * np.cumsum(masses[::-1])[::-1] / lengths
    stiffness = np.array([[pull[0] + pull[1], -pull[1]], [-pull[1], pull[1]]])
    square, vector = eigh(stiffness, np.diag(masses))
    _, _, modes = modes_of(hanging(masses, lengths, {"linear_damping": {"b_l": b_l}}))
    np.testing.assert_allclose(modes.omega, np.repeat(np.sqrt(square), 2), rtol=1e-9)  # along x and along y
    # `b_l` acts on each node: x'Cx = b_l x'x
    ratio = b_l * np.sum(vector**2, axis=0) / (2 * np.sqrt(square))
    np.testing.assert_allclose(modes.damping_ratio, np.repeat(ratio, 2), rtol=1e-9)


def test_quadratic_damping_has_a_ratio_in_proportion_to_the_amplitude():
    mass, length, b_q, amplitude = 0.3, 0.7, 0.05, 0.02
    model, pose, modes = modes_of(hanging([mass], [length], {"quadratic_damping": {"b_q": b_q}}))
    np.testing.assert_allclose(modes.period, 2 * np.pi * np.sqrt(length / G), rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratio, 0.0, atol=1e-12)
    np.testing.assert_allclose(modes.critical_damping, 2 * mass * np.sqrt(G / length), rtol=1e-9)
    # a swing of amplitude a loses 8/3 b_q omega^2 a^3 in a period
    ratio = damping_at(model, pose, modes, amplitude)
    shape = np.linalg.norm(modes.shape[:, 0], axis=1)  # its largest component is 1; it may lie between x and y
    np.testing.assert_allclose(ratio, 4 * b_q * amplitude * shape / (3 * np.pi * mass), rtol=3e-3)


@pytest.mark.check
def test_rigid_links_swing_as_very_stiff_ones_do_in_a_loop_and_in_mixed_lines():
    table = dj.load_scene("dropper-release-a").to_dict()
    _, _, rigid = modes_of(table, 8)
    stiff = {**table, "line": [{**table["line"][0], "axial": {"law": "elastic", "EA": 1e6}}]}
    _, _, elastic = modes_of(stiff, 8)
    np.testing.assert_allclose(rigid.period, elastic.period, rtol=1e-4)
    np.testing.assert_allclose(rigid.damping_ratio, elastic.damping_ratio, rtol=1e-3)
    _, _, mixed = modes_of("rigid-dropper-longline", 4)
    assert np.all(np.isfinite(mixed.period))


def test_the_command_prints_damping_ratios_and_refuses_an_amplitude_of_nothing(capsys, json_of):
    given = ["modes", "conical-pendulum-damped", "--json"]
    found = json_of([*given, "--amplitude", "0.1"])
    assert found["damping_ratio"][0] == pytest.approx(0.2 / (2 * np.sqrt(9.81)), rel=1e-6)
    assert found["amplitude_m"] == 0.1
    assert main([*given, "--amplitude", "0"]) != 0
    assert "allowed: > 0 m" in capsys.readouterr().out


@pytest.mark.check
def test_modes_of_a_body_come_first_and_shares_are_fractions_of_the_kinetic_energy(json_of):
    """The spar on its chain: among all modes those of the chain have hardly any of the body's energy."""
    found = json_of(["modes", "paper-case-1-pitching", "--of", "spar", "--count", "4", "--json"])
    assert found["number"] == sorted(found["number"])
    assert found["period_s"] == sorted(found["period_s"], reverse=True)
    share = np.array(found["body_share"]["spar"])
    assert np.all((share > 0.0) & (share <= 1.0 + 1e-9))
    scene = dj.load_scene("paper-case-1-pitching")
    model = dj.build_model(scene)
    every = natural_modes(model, dj.equilibrium(model).state)
    assert share.min() == pytest.approx(np.sort(every.body_share[:, 0])[-4], rel=1e-9)
    np.testing.assert_allclose(np.asarray(found["period_s"]), every.period[np.array(found["number"]) - 1], rtol=1e-9)


def test_modes_of_an_unknown_body_are_refused(printed):
    assert "--of: 'spar-2' is not a body; " in printed(["modes", "paper-case-1-pitching", "--of", "spar-2"], 2).err
    assert "the scene has no [[body]]" in printed(["modes", "conical-pendulum", "--of", "spar"], 2).err
