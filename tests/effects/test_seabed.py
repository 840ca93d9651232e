"""The seabed: contact force over depth and speed, on a flat bed and over a grid of depths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

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
def test_the_damper_force_never_exceeds_the_spring_force(lying, speed):
    model, k = lying([-DEPTH - 0.02] * 3, depth=DEPTH)
    spring = STIFFNESS * 0.02
    expected = AREA * (spring + np.clip(-DAMPING * speed, -spring, spring))
    v = jnp.zeros((3, 3)).at[:, 2].set(speed)
    np.testing.assert_allclose(model.effect("seabed").normal(k.with_velocity(v)), expected, rtol=1e-9)


@pytest.mark.parametrize("speed", [-2.5, -0.1, 0.1, 2.5])
def test_over_a_step_the_spring_works_as_much_as_it_stores(lying, speed):
    h, depth = 0.01, 0.01
    model, k = lying([-DEPTH - depth] * 3, depth=DEPTH, damping=0.0)
    v = jnp.zeros((3, 3)).at[:, 2].set(speed)
    begin = k.with_velocity(2.0 * v)  # the step slows the node down
    moving = model.kinematics(k.r, v, k.t, h=h, prepared=model.prepare(begin))
    before, after = (max(depth + half * speed, 0.0) for half in (0.5 * h, -0.5 * h))
    stored = 0.5 * AREA * STIFFNESS * (after**2 - before**2)
    np.testing.assert_allclose(model.effect("seabed").normal(moving) * -speed * h, stored, rtol=1e-6)


def test_on_a_slope_the_bed_pushes_along_its_normal(lying):
    depth = [4.0, 4.0, 6.0, 6.0]  # falls by 1 in 2 along x
    model, k = lying([-4.6, -5.1, -5.3], bed_x=[0.0, 4.0], bed_y=[-1.0, 1.0], bed_depth=depth, damping=0.0)
    force = np.asarray(jax.jit(lambda r: model.effect("seabed").force(model.kinematics(r, k.v, k.t)))(k.r))
    deep = np.maximum(np.array([-4.25, -4.5, -4.75]) - np.array([-4.6, -5.1, -5.3]), 0.0)
    normal = np.array([1.0, 0.0, 2.0]) / np.sqrt(5.0)
    expected = (AREA * STIFFNESS * deep * normal[2])[:, None] * normal
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)


def sliding(friction):
    """A slack chain of 20 links released on a slope of 1 in 2; its ends are free."""
    slope, n, length = 0.5, 20, 0.1
    x = 2.0 + np.arange(n + 1) * length / np.sqrt(1 + slope**2)
    nodes = np.stack([x, 0 * x, -4.0 - slope * x], axis=1)
    bed = {"bed_x": [0.0, 40.0], "bed_y": [-5.0, 5.0], "bed_depth": [4.0, 4.0, 24.0, 24.0]}
    angle = np.arctan(slope)
    effects = {"weight": {}, "seabed": {"stiffness": 3e5, "damping": 3e4, **bed}}
    if friction is not None:
        effects["seabed_friction"] = {"kinetic": friction}
    ends = [free(name, *nodes[i].tolist(), mass=0.25) for name, i in (("a", 0), ("b", -1))]
    # the thread is slack: points need a path to a fixed one
    types = [{"name": "chain", "mass": 5.0, "diameter": 0.05, "EA": 1e5, "damping": 10.0}]
    types.append({"name": "thread", "mass": 1e-7, "diameter": 1e-6, "EA": 1.0})
    lines = [
        line_of("chain", "a", "b", n, n * length, type="chain"),
        line_of("thread", "far", "a", 1, 30.0, type="thread"),
    ]
    more = {"line_type": types, "effects": effects, "start": {"kind": "points"}}
    return system([*ends, fixed("far", 0.0, 0.0, -4.0)], lines, dt=0.002, **more), angle


@pytest.mark.check
@pytest.mark.parametrize(
    ("friction", "integrator"), [(None, "energy_momentum"), (0.2, "energy_momentum"), (0.2, "generalized_alpha")]
)
def test_a_chain_slides_down_a_slope_as_a_block_does(friction, integrator):
    scene, angle = sliding(friction)
    run = dj.simulate(scene, integrator=integrator)
    assert run.status == "ok"
    along = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    middle = run.positions[:, 10] @ along  # of the chain
    expected = 0.5 * 9.81 * (np.sin(angle) - (friction or 0.0) * np.cos(angle)) * run.t**2
    assert middle[-1] - middle[0] == pytest.approx(expected[-1], rel=0.01)


def test_the_bed_is_bilinear_between_points_of_a_grid_and_constant_outside(lying):
    x, y = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 2.0])

    def depth_at(x, y):
        return 4.0 + 0.5 * x - 0.2 * y + 0.1 * x * y

    grid = [float(depth_at(a, b)) for a in x for b in y]
    model, _ = lying([0.0] * 3, bed_x=x.tolist(), bed_y=y.tolist(), bed_depth=grid)
    inside = np.array([[0.4, 0.3, 0.0], [2.2, -0.5, 0.0], [1.0, 2.0, 0.0]])
    bed = model.effect("seabed").bed_height
    np.testing.assert_allclose(bed(jnp.array(inside)), -depth_at(inside[:, 0], inside[:, 1]), rtol=1e-12)
    outside = bed(jnp.array([[9.0, 9.0, 0.0], [-9.0, -9.0, 0.0]]))
    np.testing.assert_allclose(outside, [-depth_at(3.0, 2.0), -depth_at(0.0, -1.0)], rtol=1e-12)


def test_where_two_slopes_of_a_grid_meet_the_bed_turns_over_a_part_of_the_cells(lying):
    x, y, depth = [-10.0, 0.0, 20.0], [-1.0, 1.0], [9.0, 9.0, 10.0, 10.0, 6.0, 6.0]
    model, _ = lying([0.0] * 3, bed_x=x, bed_y=y, bed_depth=depth)
    bed = model.effect("seabed")
    width = 0.02 * 10.0  # of the smaller cell
    positions = jnp.array([[a * width, 0.0, 0.0] for a in (-1.5, -1.0, 0.0, 1.0, 1.5)])
    left, right = -0.1, 0.2  # its slopes
    sharp = -10.0 + np.where(positions[:, 0] < 0, left, right) * positions[:, 0]
    lifted = np.array([0.0, 0.0, 0.25 * width * (right - left), 0.0, 0.0])
    np.testing.assert_allclose(bed.bed_height(positions), sharp + lifted, rtol=1e-12)
    np.testing.assert_allclose(bed.bed_height(positions, rounded=0.0), sharp, rtol=1e-12)
    normal = np.asarray(bed.upward(positions))
    slope = np.array([left, left, 0.5 * (left + right), right, right])
    np.testing.assert_allclose(-normal[:, 0] / normal[:, 2], slope, atol=1e-12)


def test_a_depth_next_to_a_grid_is_refused(lying, refusal):
    grid = {"bed_x": [0.0, 1.0], "bed_y": [0.0, 1.0], "bed_depth": [4.0] * 4}
    line = refusal(lambda: lying([0.0] * 3, depth=5.0, **grid))
    assert line.startswith("effects.seabed.depth: 5.0 cannot be combined with a grid; allowed: `depth`, or `bed_x`")
