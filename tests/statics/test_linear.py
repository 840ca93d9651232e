"""Small motions about a pose: a spring, a mass on it, and a run of small amplitude."""

import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj

EA, LENGTH, SPAN, MASS = 1e6, 8.0, 8.1, 20.0


def wire(EA=EA, **more):
    """A nearly weightless wire drawn tight along x, with a mass in its middle."""
    rope = {"name": "wire", "mass": 1e-3, "diameter": 0.02, "EA": EA, "damping_ratio": 0.05, "cdn": 1.2, "cdt": 0.05}
    points = [fixed("a", 0.0, 0.0, -5.0), free("middle", 4.0, 0.0, -5.0, mass=MASS), fixed("b", SPAN, 0.0, -5.0)]
    halves = (("left", "a", "middle"), ("right", "middle", "b"))
    lines = [line_of(*ends, 1, LENGTH / 2, type="wire") for ends in halves]
    return system(points, lines, duration=24.0, line_type=[rope], **more)


def test_a_mass_between_two_springs_answers_as_one_oscillator():
    """`(2 k - w^2 m) x = k U`: along the wire, k = EA/l of a half; tensions k x and k (U - x)."""
    found = dj.linearised(wire(effects={}))
    k, w, moved = 2 * EA / LENGTH, 30.0, 1e-3
    seen = found.response([0.0, w], {"b": [moved, 0.0, 0.0]})
    m = MASS + 0.5 * 1e-3 * LENGTH
    x = k * moved / (2 * k - w**2 * m)
    np.testing.assert_allclose(seen.moves[0, 0, 0], 0.5 * moved, rtol=1e-3)
    pull = EA * (SPAN / LENGTH - 1)
    sag = SPAN / pull * (0.5 * 9.81 * MASS / pull) ** 2  # compliance of the slope that carries the mass
    np.testing.assert_allclose(seen.tension[0], moved / (LENGTH / EA + sag), rtol=1e-3)
    assert abs(seen.moves[1, 0, 0]) == pytest.approx(x, rel=1e-3)  # internal damping turns it a little
    np.testing.assert_allclose(np.abs(seen.tension[1]), [k * x, k * (moved - x)], rtol=2e-2)
    assert found.held == ("a", "b")
    for motion, message in (
        ({"c": [1.0, 0.0, 0.0]}, "motion: 'c' is not a fixed point"),
        ({"b": 0.1}, "motion.b: 0.1 is out of range; allowed: 3 finite numbers m"),
        ({"b": [np.nan, 0.0, 0.0]}, r"motion.b: \[nan, 0.0, 0.0\] is out of range"),
    ):
        with pytest.raises(dj.SceneError, match=message):
            found.response(w, motion)
    with pytest.raises(dj.SceneError, match=r"line.axial.law: 'rigid'"):
        dj.linearised("string")


@pytest.mark.check
def test_a_run_of_small_amplitude_is_what_the_matrices_say():
    period, moved = 2.5, 2e-3
    water = {
        "sea": {"depth": 20.0, "current": {"kind": "uniform", "speed": 1.5, "direction": 1.57}},
        "effects": {
            "weight": {},
            "buoyancy": {},
            "morison_drag": {"cdn": 1.2, "cdt": 0.05},
            "morison_inertia": {"can": 1.0, "cat": 0.0},
            "linear_damping": {"b_l": 4.0},
        },
    }
    scene = wire(EA=1e4, **water)  # it sags, so that the mass swings
    predicted = dj.linearised(scene).response(2 * np.pi / period, {"b": [moved, 0.0, moved]})
    motion = {"amplitude": [moved, 0.0, moved], "period": period, "ramp": 4.0, "point": "b"}
    run = dj.simulate({**scene, "effects": {**water["effects"], "end_motion": motion}})
    assert run.status == "ok"
    t = run.t_tension
    late = t > 24.0 - 4 * period
    waves = np.stack([np.sin(2 * np.pi * t / period), np.cos(2 * np.pi * t / period), np.ones_like(t)], 1)
    pulls = np.linalg.lstsq(waves[late], run.tension[late], rcond=None)[0]
    # the run moves as the sine: what is said of exp(i w t) is turned by -i
    np.testing.assert_allclose(pulls[0] + 1j * pulls[1], predicted.tension[0], rtol=2e-2)
