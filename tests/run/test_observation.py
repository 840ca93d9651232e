"""What a run observes from its saved states."""

import numpy as np
from scene_parts import line_of

import dropper_jax as dj
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
