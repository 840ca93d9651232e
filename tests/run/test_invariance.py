"""Runs do not depend on the frame: a steady current is a moving frame, and all directions turn together."""

import numpy as np
import pytest
from scene_parts import line_of, scene_of

import dropper_jax as dj

#: Nodes of a slack line between two fixed points, released at rest.
X = np.linspace(0.0, 3.0, 5)
NODES = np.stack([X, 0.1 * X, -5.0 - 0.4 * np.sin(np.pi * X / 3.0)], axis=1)
FLOW = np.array([0.5, 0.3, 0.0])
END = 0.5


def loop(sea, nodes=NODES, velocity=(0.0, 0.0, 0.0), **more):
    """An elastic line of four links under water, all nodes with the same velocity at the start."""
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.2, "cdt": 0.1}, "morison_inertia": {"can": 1.0}}
    rope = {"mass": 0.5, "diameter": 0.03, "axial": {"law": "elastic", "EA": 3000.0, "damping": 5.0}}
    speeds = np.broadcast_to(velocity, nodes.shape).tolist()
    return scene_of(
        {"a": list(nodes[0]), "b": list(nodes[-1])},
        line_of("rope", "a", "b", 4, 0.8, **rope),
        run={"dt": 0.01, "duration": END},
        sea={"depth": 20.0, **sea},
        effects=effects | more,
        start={"kind": "positions", "positions": nodes.tolist(), "velocities": speeds},
    )


def current(flow, direction=0.0):
    return {"kind": "uniform", "speed": float(np.hypot(*flow[:2])), "direction": float(np.arctan2(flow[1], flow[0]))}


@pytest.mark.check
def test_a_current_is_the_same_as_ends_towed_against_it_in_still_water():
    """Galilei: in the frame of the water the line's points move by -U."""
    rest = dj.simulate(loop({"current": current(FLOW)}))
    t = np.linspace(-END, 2.0 * END, 7)  # longer than the run: points rest before and after the table
    places = np.concatenate([NODES[i] - np.outer(t, FLOW) for i in (0, -1)])
    towing = {"points": ["a", "b"], "time": t.tolist(), "positions": places.tolist()}
    towed = dj.simulate(loop({}, velocity=-FLOW, recorded_motion=towing))
    assert rest.status == towed.status == "ok"
    back = towed.positions + towed.t[:, None, None] * FLOW
    assert np.max(np.abs(rest.positions - rest.positions[0])) > 0.1
    np.testing.assert_allclose(back, rest.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(towed.tension[1:], rest.tension[1:], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("angle", [0.7, -2.0])
def test_everything_turned_about_the_vertical_has_the_same_tensions(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])

    def sea(by):
        waves = {"kind": "regular", "height": 1.0, "period": 4.0, "direction": 0.4 + by}
        return {"current": current(turn @ FLOW if by else FLOW), "waves": waves}

    straight = dj.simulate(loop(sea(0.0)))
    turned = dj.simulate(loop(sea(angle), NODES @ turn.T))
    assert straight.status == turned.status == "ok"
    np.testing.assert_allclose(turned.positions, straight.positions @ turn.T, rtol=0, atol=1e-10)
    np.testing.assert_allclose(turned.tension, straight.tension, rtol=1e-9, atol=1e-9)
