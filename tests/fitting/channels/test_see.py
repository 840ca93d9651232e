"""What perfect sensors show of nodes and tensions that are known."""

import jax.numpy as jnp
import numpy as np

from fitting.channels.channel import SavedMotion
from fitting.channels.observe import at_times
from fitting.channels.position import Node
from fitting.channels.sensors import Angle, Depth, Pixel, Position, Tension, projection, read_camera

NODES = jnp.array([[[0.0, 0.0, 0.0], [1.0, 1.0, -2.0], [4.0, 5.0, -2.0]]] * 2)
SEEN = SavedMotion(NODES, NODES[1:], jnp.array([[3.0, 5.0]]))
COMMON = {"name": "a", "columns": ("c",), "unit": "-"}
#: From (0, -10, 0) towards +y: x is right, z is up.
CAMERA = projection(np.array([0.0, -10.0, 0.0]), np.zeros(3), 1000.0, np.array([320.0, 240.0]))


def dot(node):
    return Pixel(**COMMON, node=Node(node, node, 0.0), matrix=tuple(map(tuple, CAMERA)))


def test_angles_by_their_zero():
    show = lambda zero, first=0, second=1: float(Angle(**COMMON, first=first, second=second, zero=zero).see(SEEN)[0, 0])  # noqa: E731
    assert np.isclose(show("horizontal"), np.arctan2(2, 1))
    assert np.isclose(show("down"), np.arctan2(1, 2))
    assert np.isclose(show("azimuth", 1, 2), np.arctan2(4, 3))


def test_angles_continue_beyond_a_full_turn():
    turn = jnp.linspace(0, 4 * np.pi, 50)
    nodes = jnp.stack([jnp.zeros((50, 3)), jnp.stack([jnp.sin(turn), 0 * turn, -jnp.cos(turn)], 1)], axis=1)
    shown = Angle(**COMMON, zero="down").see(SavedMotion(nodes, nodes[1:], jnp.zeros((49, 1))))[:, 0]
    assert np.allclose(shown, turn, atol=1e-12)


def test_places_between_nodes_and_depths():
    assert np.allclose(Position(**COMMON, node=Node(0, 1, 0.25)).see(SEEN)[0], [0.25, 0.25, -0.5])
    assert np.allclose(Position(**COMMON, node=Node(2, 2, 0.0), axes=(2, 0)).see(SEEN)[0], [-2, 4])
    assert np.allclose(Depth(**COMMON, node=Node(0, 1, 0.25)).see(SEEN)[0], [0.5])


def test_two_lines_pull_a_point_by_their_resultant():
    """(1, 1, -2)/sqrt 6 backwards with 3 N and (3, 4, 0)/5 forwards with 5 N on the middle node."""
    pull = -3 * np.array([1, 1, -2]) / np.sqrt(6) + np.array([3, 4, 0])
    shown = Tension(**COMMON, ends=((1, 0, 0), (1, 2, 1))).see(SEEN)
    assert np.allclose(shown, np.linalg.norm(pull))
    assert np.allclose(Tension(**COMMON, link=1).see(SEEN), 5.0)


def test_a_camera_sees_right_to_the_right_and_up_above_by_the_focal_length_over_the_distance():
    """1 m at 10 m is a tenth of the focal length."""
    nodes = jnp.array([[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 10.0, -2.0]]])
    seen = SavedMotion(nodes, nodes, jnp.zeros((1, 1)))
    assert np.allclose([dot(node).see(seen)[0] for node in range(3)], [[420, 240], [320, 140], [320, 340]])


def test_a_camera_does_not_see_what_is_behind_it():
    """At 3 m from the axis, 5 m ahead and 5 m behind: a pinhole would show the latter mirrored, at -3/5."""
    nodes = jnp.array([[[3.0, y, 0.0]] for y in (-5.0, -10.0, -15.0)])
    seen = dot(0).see(SavedMotion(nodes, nodes, jnp.zeros((3, 1))))
    np.testing.assert_allclose(seen, [[920.0, 240.0], [np.nan, np.nan], [np.nan, np.nan]], atol=1e-9)


def test_a_projection_of_either_sign_looks_at_the_same_side():
    for sign in (1.0, -1.0):
        camera = read_camera({"name": "left", "projection": (sign * CAMERA).tolist()}, "camera.0")
        np.testing.assert_array_equal(camera.matrix, CAMERA)


def test_between_saved_times_cubics_are_met_exactly_and_other_motions_to_fourth_order():
    t = jnp.linspace(0.3, 4.0, 40)
    grid = lambda h: jnp.arange(0, 6, h)  # noqa: E731
    cubic = lambda x: (x**3 - 2 * x**2 + x)[:, None]  # noqa: E731
    assert np.allclose(at_times(cubic(grid(0.5)), 0.0, 0.5, t), cubic(t), atol=1e-11)
    off = [np.abs(at_times(jnp.sin(grid(h))[:, None], 0.0, h, t)[:, 0] - jnp.sin(t)).max() for h in (0.2, 0.1, 0.05)]
    assert np.allclose(np.log2(np.array(off[:-1]) / off[1:]), 4, atol=0.4)
