"""Plans of measurements: predicted errors against the scatter of fits, and what cannot be planned."""

import json

import numpy as np
import pytest
from hard_scenes import rods

from dropper_jax import SceneError
from fitting import Camera, fit, observe, simulate_truth
from fitting.calibration.measurement_plan import plan

NOISE, DURATION = 0.01, 8.0


def released(angle):
    effects = {"linear_damping": {"b_l": 0.05}, "quadratic_damping": {"b_q": 0.03}}
    run = {"dt": 0.01, "duration": DURATION}
    return rods([angle], 0.8, 0.5, effects, zero="horizontal") | {"name": f"from-{angle}", "run": run}


FREE = ["b_l", "b_q"]


@pytest.fixture(scope="module")
def plans():
    return plan([released(0.2), released(1.2)], FREE, durations=[4.0, DURATION], noises=[NOISE], gap_weight=1e-3)


@pytest.mark.check
def test_the_scatter_of_fits_is_as_predicted(plans):
    """Twelve twins of the best plan; their scatter is known to a fifth."""
    best = plans[0]
    assert (best.scene, best.duration) == ("from-0.2", DURATION)
    motion = simulate_truth(released(0.2), DURATION)
    values = []
    for seed in range(12):
        found = fit([observe(motion, Camera(angle_noise=NOISE), seed)], released(0.2), FREE)
        values.append(found.values)
    ratio = np.array(list(best.std_error.values())) / np.std(values, axis=0, ddof=1)
    assert ((ratio > 0.65) & (ratio < 1.5)).all(), ratio


@pytest.mark.check
def test_errors_of_a_chaotic_rig_are_those_that_its_fit_reports():
    """Without a gap weight it is the one that fits of a right model choose: 1e-3 gave errors 1.5 times too large."""
    (row,) = plan(["dropper-release-a"], FREE, durations=[16.0], noises=[0.005])
    trace = observe(simulate_truth("dropper-release-a", 16.0), Camera(angle_noise=0.005), 0)
    found = fit([trace], "dropper-release-a", FREE)
    np.testing.assert_allclose(list(row.std_error.values()), found.uncertainty.std_error, rtol=0.2)


@pytest.mark.check
def test_longer_and_larger_swings_determine_more(plans):
    error = {(row.scene, row.duration): row.std_error for row in plans}
    for scene in ("from-0.2", "from-1.2"):
        for name, long in error[scene, DURATION].items():
            assert long < error[scene, 4.0][name]
    assert [row.score for row in plans] == sorted(row.score for row in plans)


@pytest.mark.check
def test_errors_grow_with_the_noise():
    """Without gaps that hold (a large weight) errors are those of separate windows, in proportion to the noise."""
    found = plan([released(1.2)], FREE, durations=[DURATION], noises=[NOISE, 3 * NOISE], gap_weight=1e3)
    low, high = sorted(found, key=lambda row: row.noise)
    for name in low.std_error:
        assert high.std_error[name] == pytest.approx(3 * low.std_error[name], rel=0.01)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"durations": [-1.0]}, "duration: -1.0 is not positive"),
        ({"durations": [0.01]}, "too few frames at 60 Hz; allowed: at least 0.17 s"),
        ({"durations": [4.0], "requested": ["gravity"]}, "for: .* is not free"),
        ({"durations": [4.0], "gap_weight": 0.0}, "gap_weight: 0.0 is not positive"),
    ],
)
def test_what_cannot_be_planned_is_named(settings, text):
    with pytest.raises(SceneError, match=text):
        plan([released(1.2)], FREE, **settings)


def test_a_duration_that_is_no_number_is_refused_with_its_option(tmp_path, printed):
    scene = tmp_path / "swing.json"
    scene.write_text(json.dumps(released(1.2)))
    output = printed(["plan", str(scene), "--free", "b_l", "--duration", "x"], 2).err
    assert "--duration: 'x' is not a list of numbers" in output
