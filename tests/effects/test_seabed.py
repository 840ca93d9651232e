"""The seabed: contact force over depth and speed, on a flat bed and over a grid of depths."""

import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj

DIAMETER, LENGTH, STIFFNESS, DAMPING, DEPTH = 0.05, 0.5, 2e5, 3e4, 4.0
#: Plan area of a node [m^2]: in a single line each node has the link that ends there, its mass and its area.
AREA = DIAMETER * LENGTH


@pytest.fixture
def lying(chain):
    """`lying(z, bed)`: a model whose three nodes are at the heights z, and their kinematics at rest."""

    def make(z, **bed):
        nodes = [[0.5 * (i + 1), 0.0, height] for i, height in enumerate(z)]
        effects = {"weight": {}, "seabed": {"stiffness": STIFFNESS, "damping": DAMPING, **bed}}
        start = {"kind": "positions", "positions": [[0.5 * i, 0.0, 0.0] for i in range(4)]}
        model, s = dj.build(chain([LENGTH] * 3, 1.0, start, effects=effects, diameter=DIAMETER))
        return model, model.kinematics(jnp.array(nodes), jnp.zeros((3, 3)), s.t)

    return make


def test_a_node_below_the_bed_is_pushed_up_by_the_spring_under_its_plan_area(lying):
    depths = np.array([-0.02, 0.01, 0.03])  # the first is above the bed
    model, k = lying(list(-DEPTH - depths), depth=DEPTH)
    force = model.effect("seabed").force(k)
    np.testing.assert_allclose(force[:, 2], AREA * STIFFNESS * np.maximum(depths, 0.0), rtol=1e-9)
    np.testing.assert_array_equal(force[:, :2], 0.0)


@pytest.mark.parametrize("speed", [-0.1, 0.1, 1.2], ids=["pressed in", "rising slowly", "rising fast"])
def test_over_a_step_spring_and_damper_stand_at_its_end_and_never_pull(lying, speed):
    """N = A max(0, k p1 + c (p1 - p0)/h) with p0, p1 = p -+ h v/2 about the middle of the step."""
    h, depth = 0.01, 0.02
    model, k = lying([-DEPTH - depth] * 3, depth=DEPTH)
    moving = model.kinematics(k.r, jnp.zeros((3, 3)).at[:, 2].set(speed), k.t, h=h)
    after = depth - 0.5 * h * speed
    expected = AREA * max(STIFFNESS * after - DAMPING * speed, 0.0)
    np.testing.assert_allclose(model.effect("seabed").normal(moving), expected, rtol=1e-9)


def test_between_the_places_of_a_grid_the_bed_is_bilinear_and_goes_on_outside(lying):
    x, y = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 2.0])

    def depth_at(x, y):
        return 4.0 + 0.5 * x - 0.2 * y + 0.1 * x * y

    grid = [float(depth_at(a, b)) for a in x for b in y]
    model, _ = lying([0.0] * 3, bed_x=x.tolist(), bed_y=y.tolist(), bed_depth=grid)
    inside = np.array([[0.4, 0.3, 0.0], [2.2, -0.5, 0.0], [1.0, 2.0, 0.0]])
    bed = model.effect("seabed").bed
    np.testing.assert_allclose(bed(jnp.array(inside)), -depth_at(inside[:, 0], inside[:, 1]), rtol=1e-12)
    outside = bed(jnp.array([[9.0, 9.0, 0.0], [-9.0, -9.0, 0.0]]))
    np.testing.assert_allclose(outside, [-depth_at(3.0, 2.0), -depth_at(0.0, -1.0)], rtol=1e-12)
