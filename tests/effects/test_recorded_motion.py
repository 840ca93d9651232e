"""Held points that move as recorded: rows are met, parabolas exactly followed, each point by itself."""

import jax
import numpy as np
import pytest
from hard_scenes import single_line

import dropper_jax as dj

TIMES = np.arange(0.0, 1.05, 0.1)


def path(t, number):
    """A parabola in time for each point."""
    t = np.asarray(t)[..., None]
    fall = np.array([0.2, -0.1, 0.3]) * (1 + number)
    return np.array([0.5 * number, 0.0, 0.0]) + t * np.array([0.1, 0.2, -0.1]) + t**2 * fall


def scene(**changes):
    rows = np.concatenate([path(TIMES, 0), path(TIMES, 1)]).tolist()
    motion = {"points": ["left", "right"], "time": TIMES.tolist(), "positions": rows, **changes}
    effects = {"weight": {}, "recorded_motion": motion}
    return single_line([0.3] * 4, 0.1, {"kind": "static"}, [0.6, 0.0, 0.0], effects)


def test_each_point_follows_its_own_parabola_with_its_rate_and_acceleration():
    model, _ = dj.build(scene())
    for t in (0.15, 0.42, 0.88):
        ends = model.ends(jax.numpy.asarray(t))
        fast = model.end_acceleration(jax.numpy.asarray(t))
        for number in (0, 1):
            step = 1e-4
            rate = (path(t + step, number) - path(t - step, number)) / (2 * step)
            bend = (path(t + step, number) - 2 * path(t, number) + path(t - step, number)) / step**2
            assert np.allclose(ends.positions[number], path(t, number), atol=1e-12)
            assert np.allclose(ends.velocities[number], rate, atol=1e-9)
            assert np.allclose(fast[number], bend, atol=1e-6)


@pytest.mark.check
def test_a_run_starts_at_the_first_row_and_ends_at_the_last():
    found = dj.simulate(scene())
    assert found.status == "ok"
    for number, name in enumerate(("left", "right")):
        assert np.allclose(found.point_path(name)[0], path(0.0, number), atol=1e-12)
        assert np.allclose(found.point_path(name)[-1], path(1.0, number), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": ["left", "top"]}, "recorded_motion.points.1: 'top' is not a fixed point"),
        ({"points": []}, "recorded_motion.points: is empty"),
        ({"points": ["left", "left"]}, "'left' is a duplicate point"),
        ({"time": TIMES[::-1].tolist()}, "recorded_motion.time: needs at least 2 increasing times"),
        ({"positions": path(TIMES, 0).tolist()}, "recorded_motion.positions: has 11 rows; allowed: 22"),
        (
            {"positions": np.stack([path(TIMES, 0), path(TIMES, 1)], axis=1).reshape(-1, 3).tolist()},
            "recorded_motion.positions: start with one row for each point; allowed: all rows of the first point",
        ),
    ],
)
def test_tables_that_fit_nothing_are_refused(change, message, refusal):
    assert message in refusal(dj.load_scene, scene(**change))
