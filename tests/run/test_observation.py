"""What a run observes from its saved states."""

import numpy as np
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.quantities.bending import bending_moment
from dropper_jax.run import observation


def test_a_turn_is_continuous_over_blocks_of_saved_states(monkeypatch):
    """A body that spins about its line by 6 rad/s turns by 6 t, also where its states are observed in blocks."""
    monkeypatch.setattr(observation, "BLOCK_STATES", 64)
    body = {
        "name": "top",
        "position": [0.0, 0.0, -1.2],
        "mass": 1.0,
        "centre_of_mass": [0.0, 0.0, -0.2],
        "inertia": [0.01, 0.01, 0.01],
        "angular_velocity": [0.0, 0.0, 6.0],
        "attachments": {"end": [0.0, 0.0, 0.0]},
    }
    axial = {"law": "rope", "EA": 100.0}
    scene = {
        "name": "spin",
        "run": {"duration": 3.0, "dt": 0.01},
        "point": [{"name": "top-end", "position": [0.0, 0.0, 0.0]}],
        "line": [line_of("line", "top-end", "end", 2, 0.5, mass=0.01, axial=axial)],
        "effects": {"weight": {}},
        "body": [body],
        "start": {"kind": "points"},
    }
    yaw = dj.simulate(scene).body("top")["body_attitude"][:, 2]
    np.testing.assert_allclose(yaw, 6.0 * 0.01 * np.arange(301), rtol=1e-3, atol=1e-12)


def test_the_moment_of_a_joint_is_that_of_both_lines_until_one_of_them_breaks():
    """A right angle between links of 0.5 m, one with EI 4 N m^2 and one without: M = 2 sqrt(2)/0.5, half of EI."""
    ends = [fixed("a", 0.0, 0.0, 0.0), free("b", 0.5, 0.0, 0.0), fixed("c", 0.5, 0.0, -0.5)]
    rope = {"mass": 1.0, "axial": {"law": "elastic", "EA": 1e3}, "nodes": "shared"}
    lines = [line_of("soft", "a", "b", 1, 0.5, **rope), line_of("stiff", "b", "c", 1, 0.5, **rope)]
    bending = {"EI": [0.0, 4.0], "joined": [["soft", "stiff"]]}
    scene = dj.load_scene(system(ends, lines, effects={"bending": bending}))
    nodes = np.array([[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, -0.5]]] * 2)
    break_of_soft = {"line": "soft", "link": 1, "time_s": 0.5}
    moment = bending_moment(scene, nodes, np.array([0.0, 1.0]), (break_of_soft,))
    both = 4.0 * np.sqrt(2.0)
    np.testing.assert_allclose(moment, [[0.0, both, both, 0.0], np.zeros(4)], rtol=1e-12)
