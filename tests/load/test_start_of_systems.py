"""Starts of systems of lines from given positions, attached points included."""

import numpy as np
import pytest

import dropper_jax as dj


def hanging(**start):
    """A rope of 10 m between fixed points, 9 m apart, with two weights attached and a rope below one of them."""
    kind = {"name": "rope", "mass": 1.0, "diameter": 0.02, "EA": 1e4}
    weight = {"kind": "free", "mass": 3.0}
    return {
        "run": {"dt": 0.01, "duration": 0.2},
        "line_type": [kind],
        "point": [
            {"name": "a", "position": [0.0, 0.0, 0.0]},
            {"name": "b", "position": [9.0, 0.0, 0.0]},
            {"name": "first", "position": [3.0, 0.0, -2.0], **weight},
            {"name": "second", "position": [6.0, 0.0, -2.0], **weight},
            {"name": "tip", "position": [6.0, 0.0, -4.0], **weight},
        ],
        "line": [
            {"name": "below", "from": "second", "to": "tip", "type": "rope", "length": 2.0, "links": 2},
            {"name": "rope", "from": "a", "to": "b", "type": "rope", "length": 10.0, "links": 10}
            | {"attach": [{"point": "first", "at": 3.0}, {"point": "second", "at": 7.0}]},
        ],
        "effects": {"weight": {}},
        "start": start or {"kind": "static"},
    }


@pytest.fixture(scope="module")
def measured():
    """Positions (14, 3) [m] at rest: 3 of the line below, then 11 of the rope; the attached points once each."""
    pose = dj.equilibrium(hanging())
    assert pose.status == "ok"
    # pieces of the rope repeat the points between them
    return np.delete(pose.positions, [7, 12], axis=0)


def test_a_start_from_the_equilibrium_stays_there(measured):
    run = dj.simulate(hanging(kind="positions", positions=measured.tolist()))
    assert run.status == "ok"
    assert np.max(np.abs(run.positions - run.positions[0])) < 1e-6
    assert np.allclose(run.tension, dj.equilibrium(hanging()).tension, rtol=1e-5)


def test_positions_survive_writing_and_reading(measured):
    scene = dj.load_scene(hanging(kind="positions", positions=measured.tolist()))
    for table in (scene.to_dict(), scene.as_written()):
        again = dj.load_scene(table)
        assert np.array_equal(again.start.positions, scene.start.positions)


def moved(positions, node, by):
    found = positions.copy()
    found[node] += by
    return found.tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:-1].tolist(), "has 13 rows; allowed: 14, both ends of each line included"),
        (lambda p: moved(p, 3, [0.1, 0.0, 0.0]), "line 'rope-1': node 3 is at (0.1, 0, 0) m; allowed: (0, 0, 0) m"),
        (lambda p: moved(p, 0, [0.0, 0.2, 0.0]), "nodes 0 and 10 are both point 'second', but at"),
        (lambda p: moved(p, 8, [0.0, 0.0, -3.0]), "times as long as unstretched; allowed: up to 2"),
    ],
)
def test_positions_that_disagree_give_one_line(measured, change, message, refusal):
    assert message in refusal(dj.load_scene, hanging(kind="positions", positions=change(measured)))


def test_a_node_of_a_system_that_starts_below_the_bed_is_named(measured, refusal):
    start = hanging(kind="positions", positions=measured.tolist())
    assert dj.load_scene(start | {"effects": {"weight": {}, "seabed": {"depth": 4.0}}})
    step = {"bed_x": [6.0, 6.5], "bed_y": [-9.0, 9.0], "bed_depth": [4.0, 4.0, 2.5, 2.5]}
    message = refusal(dj.load_scene, start | {"sea": {"depth": 4.0}, "effects": {"weight": {}, "seabed": step}})
    assert "start.positions: node 1 is at z = -2.91925 m, below the seabed; allowed: >= -2.5 m" in message
