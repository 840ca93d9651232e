"""Vessels: points moved by response amplitude operators and by tables, against sums written out, and refusals."""

import jax
import numpy as np
import pytest
from scene_parts import fixed, line_of, system

import dropper_jax as dj
from dropper_jax import SceneError, build_model

OMEGA, AMPLITUDE, HEADING = 2 * np.pi / 8.0, 1.5, 0.4
ARM, PLACE = np.array([10.0, -3.0, 2.0]), np.array([5.0, 7.0, 0.0])


def moored(**vessel):
    """A rope from the bed to a vessel."""
    own = {"mass": 20.0, "diameter": 0.05, "axial": {"law": "rope", "EA": 1e6}, "nodes": "shared"}
    barge = {"name": "barge", "position": PLACE.tolist(), "heading": HEADING}
    barge["attachments"] = {"fairlead": ARM.tolist()}
    waves = {"kind": "regular", "amplitude": AMPLITUDE, "period": 8.0, "direction": HEADING}
    return system(
        [fixed("anchor", 0.0, 0.0, -30.0)],
        [line_of("rope", "anchor", "fairlead", 4, 45.0, **own)],
        dt=0.05,
        duration=20.0,
        vessel=[barge | vessel],
        sea={"depth": 30.0, "ramp": 10.0, "waves": waves},
    )


RAO = {"frequency": [0.4, OMEGA, 1.2], "headings": [-0.5, 0.5], "phases": "lead"}
RAO |= {"surge": [[0.9, 0.8, 0.3]] * 2, "surge_phase": [[1.5, 1.4, 1.0]] * 2}
RAO |= {"heave": [[1.0, 0.7, 0.2]] * 2, "heave_phase": [[0.0, 0.2, 0.4]] * 2}
RAO |= {"pitch": [[0.01, 0.03, 0.01]] * 2, "pitch_phase": [[-1.5, -1.2, -1.0]] * 2}


def expected(t, sign):
    """At the reference point eta = a cos(k x - w t) with x along the waves; a motion that leads is ahead in time."""
    k = 0.5 * (OMEGA**2 / 9.81)
    for _ in range(100):
        k = OMEGA**2 / 9.81 / np.tanh(k * 30.0)
    along = k * (PLACE[0] * np.cos(HEADING) + PLACE[1] * np.sin(HEADING))
    move = lambda size, phase: AMPLITUDE * size * np.cos(OMEGA * t - along + sign * phase)  # noqa: E731
    surge, heave, pitch = move(0.8, 1.4), move(0.7, 0.2), move(0.03, -1.2)
    return turned_by_heading(surge, heave, pitch)


def turned_by_heading(surge, heave, pitch):
    """Positions (..., 3) [m] of the point of a vessel that has moved so much."""
    x = surge + np.cos(pitch) * ARM[0] + np.sin(pitch) * ARM[2]
    z = heave + np.cos(pitch) * ARM[2] - np.sin(pitch) * ARM[0]
    c, s = np.cos(HEADING), np.sin(HEADING)
    return PLACE + np.stack([c * x - s * ARM[1], s * x + c * ARM[1], z], axis=-1)


@pytest.mark.parametrize(("phases", "sign"), [("lead", 1.0), ("lag", -1.0)])
def test_point_of_a_vessel_moves_by_its_operators(phases, sign):
    model = build_model(dj.load_scene(moored(rao={**RAO, "phases": phases})))
    times = np.linspace(10.0, 40.0, 61)
    found = jax.jit(jax.vmap(model.ends))(times).positions[:, 1]
    np.testing.assert_allclose(found, expected(times, sign), atol=1e-6)


def test_point_of_a_vessel_follows_its_table_and_tightens_the_rope():
    table = {"time": [0.0, 1.0, 6.0, 7.0], "motion": [[0.0] * 6] * 2 + [[2.0, 0.0, 1.0, 0.0, 0.1, 0.0]] * 2}
    scene = moored(**table)
    solution = dj.simulate(scene)
    assert solution.status == "ok"
    np.testing.assert_allclose(solution.point_path("fairlead")[-1], turned_by_heading(2.0, 1.0, 0.1), atol=1e-9)
    assert solution.work_names[-1] == "moving_ends"
    assert dj.load_scene(dj.load_scene(scene).to_dict()) == dj.load_scene(scene)


@pytest.mark.parametrize(
    ("vessel", "message"),
    [
        (
            {"rao": {**RAO, "heave": [[1.0, 0.7]] * 2}},
            r"vessel.0.rao.heave.0: .* has 2 entries; allowed: 3 numbers, one for each `frequency`",
        ),
        ({"rao": {**RAO, "heave": [[1.0, 0.7, 0.2]]}}, r"vessel.0.rao.heave: .* has 1 entries; allowed: 2 rows"),
        ({"rao": {key: value for key, value in RAO.items() if key != "phases"}}, "vessel.0.rao.phases: missing"),
        ({"rao": {**RAO, "headings": [1.0, 2.0]}}, "vessel.0.rao.headings: waves come at"),
        ({"rao": {**RAO, "frequency": [0.1, 0.2, 0.3]}}, "vessel.0.rao.frequency: .* leave out 100%"),
        ({}, "give either `rao`, or `time` and `motion`"),
        ({"time": [0.0, 1.0], "motion": [[0.0] * 6]}, "vessel.0.time"),
    ],
)
def test_scene_refuses(vessel, message):
    with pytest.raises(SceneError, match=message):
        build_model(dj.load_scene(moored(**vessel)))


def surge_by_heading(headings, direction):
    """Operators (real, imaginary) of the waves' components, of a table whose surge is the cosine of the heading."""
    rows = {"surge": [[abs(np.cos(h))] * 2 for h in headings], "surge_phase": [[h % (2 * np.pi)] * 2 for h in headings]}
    vessel = {"rao": {"frequency": [0.4, 1.2], "headings": list(headings), "phases": "lead", **rows}, "heading": 0.0}
    scene = moored(**vessel)
    scene["sea"]["waves"]["direction"] = direction
    (effect,) = [e for e in build_model(dj.load_scene(scene)).effects if e.name == "vessel_motion"]
    return np.asarray(effect.real)[:, 0], np.asarray(effect.imaginary)[:, 0]


@pytest.mark.parametrize("direction", [-0.5, -0.5 + 2 * np.pi, -2.0, 3.1, -np.pi])
def test_headings_of_a_table_are_on_a_circle(direction):
    step = np.pi / 4
    centred = surge_by_heading(step * np.arange(-4, 5), direction)
    for table in (step * np.arange(0, 9), step * np.arange(0, 8)):  # 0 to 2 pi, with and without the last row
        np.testing.assert_allclose(surge_by_heading(table, direction), centred, rtol=1e-12)


def test_a_table_of_one_side_still_refuses_waves_from_the_other():
    with pytest.raises(SceneError, match=r"rao.headings: waves come at"):
        surge_by_heading([0.0, 0.5], -0.5)
