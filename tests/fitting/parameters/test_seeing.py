"""What camera and markers make of angles, against places of nodes drawn by hand; the scale of a rig."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError, build_model
from fitting.parameters.observation import camera_angles
from fitting.parameters.parameter import with_parameter_values
from fitting.parameters.paths import resolve

LENGTH = np.array([0.3, 0.2, 0.25, 0.3])
THETA = np.array([1.2, 0.4, -0.5, -1.1])


@pytest.fixture(scope="module")
def model(chain):
    return build_model(dj.load_scene(chain(LENGTH, 0.1, {"kind": "static"}, [0.6, 0, 0])))


def test_markers_off_their_nodes_are_seen_where_geometry_puts_them(model):
    assert [p.name for p in resolve(model, ["marker.offset"])] == [f"marker.offset.{j}" for j in range(4)]
    names = ["camera.offset", "marker.offset.2", "marker.node.0.1", "marker.node.2", "marker.node.4.0"]
    parameters = resolve(model, names)
    values = np.array([0.02, -0.01, 0.004, 0.003, -0.005, 0.006])
    assert [p.unit for p in parameters] == ["rad", "rad", "m", "m", "m", "m"]
    link = LENGTH[:, None] * np.stack([np.cos(THETA), -np.sin(THETA)], axis=1)
    marker = np.concatenate([[[0.0, 0.0]], np.cumsum(link, axis=0)])
    along = link[1] / LENGTH[1]
    across = np.array([along[1], -along[0]])  # a quarter turn towards larger angles, which go down
    marker[0] += [0.0, 0.004]
    marker[2] += 0.003 * along - 0.005 * across
    marker[4] += [0.006, 0.0]
    d = np.diff(marker, axis=0)
    expected = np.arctan2(-d[:, 1], d[:, 0]) + 0.02 + np.array([0, 0, -0.01, 0])
    see = lambda v: camera_angles(model, parameters, v, jnp.asarray(THETA))  # noqa: E731
    np.testing.assert_allclose(see(jnp.asarray(values)), expected, atol=1e-12)
    slope = jax.jacfwd(see)(jnp.asarray(values))
    np.testing.assert_allclose(slope, jax.jacrev(see)(jnp.asarray(values)), atol=1e-12)
    for i in range(len(values)):
        step = 1e-6 * np.eye(len(values))[i]
        difference = (see(values + step) - see(values - step)) / 2e-6
        np.testing.assert_allclose(slope[:, i], difference, atol=1e-6 * max(1, np.abs(difference).max()))


def test_the_scale_of_a_rig_grows_lengths_and_the_gap_together(model):
    (scale,) = resolve(model, ["rig.scale"])
    grown = with_parameter_values(model, [scale], jnp.array([1.1]))
    np.testing.assert_allclose(grown.line.length, 1.1 * LENGTH)
    np.testing.assert_allclose(grown.points[1].position, [0.66, 0, 0])
    np.testing.assert_allclose(grown.line.mass, model.line.mass)
    assert scale.value == 1.0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("marker.offset.4", "allowed: marker.offset.0 to marker.offset.3"),
        ("marker.node.5", "allowed: marker.node.0 to marker.node.4"),
        ("marker.node.2.2", "allowed: marker.node.0 to marker.node.4"),
        ("clock.lost", "allowed: clock.lost.RUN.FRAME"),
        ("clock.lost.0.x", "allowed: clock.lost.RUN.FRAME"),
    ],
)
def test_what_no_camera_has_is_refused(model, name, words):
    with pytest.raises(SceneError, match=words):
        resolve(model, [name])
