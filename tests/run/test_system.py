"""Systems of lines: the network solver, statics, snapping lines, floats and friction against independent answers."""

import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_line
from scene_parts import free_at, line_of, scene_of

from dropper_jax import Line, Model, Point, SceneError, build_model, equilibrium, load_scene, simulate, state
from dropper_jax.axial import Rope
from dropper_jax.effects import LinearDamping, Weight
from dropper_jax.model import Graph, Member
from dropper_jax.quantities.end_forces import fixed_point_loads
from dropper_jax.scene import line_offsets

PLACES = [(0, 0, 0), (6, 0, 0), (3, 5, 0), (3, 1, -1.0), (3, 2, -1.0)]


def net(members: tuple[Member, ...], held: tuple[bool, ...], places: list) -> tuple[Model, np.random.Generator]:
    rng = np.random.default_rng(1)
    graph = Graph(members, held)
    n = graph.links
    rope = Rope(EA=np.full(n, 1e4), damping=np.full(n, 10.0))
    line = Line(length=np.ones(n), mass=0.5 + rng.random(n), axial=rope, geometry=graph)
    points = [
        Point(position=np.array(p, float), name=str(i), kind="fixed" if h else "free")
        for i, (p, h) in enumerate(zip(places, held, strict=True))
    ]
    model = Model(points=tuple(points), lines=(line,), effects=(Weight(), LinearDamping(b_l=0.3)))
    return model.cast(jnp.float64), rng


def star() -> tuple[Model, np.random.Generator]:
    """Three held points, two free ones, a cycle, a line of one link, lines of unequal lengths."""
    members = [("a", 5, 0, 3), ("b", 3, 3, 1), ("c", 1, 3, 4), ("d", 4, 4, 2), ("e", 2, 3, 4)]
    return net(tuple(Member(*one) for one in members), (True, True, True, False, False), PLACES)


def ladder(rungs: int) -> tuple[Model, np.random.Generator]:
    """A backbone with a looped dropper in every bay: enough points for the banded matrix of points."""
    members, places = [], [(2.0 * i, 0.0, 0.0) for i in range(rungs + 2)]
    for i in range(rungs + 1):
        members.append(Member(f"bay{i}", 2, i, i + 1))
        members.append(Member(f"drop{i}", 3, i, i + 1))
    return net(tuple(members), (True, *(False,) * rungs, True), places)


@pytest.mark.parametrize("make", [star, lambda: ladder(20)], ids=["star", "ladder"])
def test_network_solve_and_its_transpose_are_those_of_the_dense_jacobian(network_is_exact, make):
    model, rng = make()
    r = rng.standard_normal((model.free_nodes, 3))
    s = state(model, r, 0.1 * rng.standard_normal(r.shape), tension=10 * rng.random(model.line.links))
    network_is_exact(model, s)


def test_a_state_has_the_shapes_of_its_model():
    model, _ = star()
    nodes = model.free_nodes
    for r, v, tension in (
        (np.zeros((1, 3)), None, None),  # which would count for every node
        (np.zeros((nodes + 3, 3)), None, None),  # with the fixed points
        (np.zeros((nodes, 2)), None, None),
        (np.zeros((nodes, 3)), np.zeros(3), None),
        (np.zeros((nodes, 3)), None, 1.0),
    ):
        with pytest.raises(ValueError, match=r"^state: has an array of the shape \("):
            state(model, r, v, tension)


CHAIN = {"name": "chain", "mass": 10.91, "diameter": 0.042, "EA": 48.884e6, "damping_ratio": 0.1}
HANGING = scene_of(
    {"a": [0.0, 0.0, 0.0], "joint": free_at([10.0, 0.0, -1.0], mass=100.0), "b": [20.0, 0.0, 0.0]},
    line_of("left", "a", "joint", 6, 12.0, type="chain"),
    line_of("right", "joint", "b", 6, 12.0, type="chain"),
    run={"dt": 0.02, "duration": 1.0},
    line_type=[CHAIN],
)
ROPE = {"name": "rope", "mass": 1.0, "diameter": 0.05, "EA": 1e5}


def test_a_clump_weight_between_two_equal_lines_is_held_by_half_the_total_weight_at_each_end():
    pose = equilibrium(HANGING)
    assert pose.status == "ok"
    # nodes at the ends take half a link each: the rest hangs on the two first links
    hanging = (24.0 - 2.0) * 10.91 * 9.81 + 100.0 * 9.81
    drop = np.diff(pose.positions[:7], axis=0)
    vertical = pose.tension[0] * abs(drop[0, 2]) / np.linalg.norm(drop[0])
    assert vertical == pytest.approx(0.5 * hanging, rel=1e-9)
    # the horizontal force is one and the same along the line
    level = pose.tension[:6] * drop[:, 0] / np.linalg.norm(drop, axis=1)
    np.testing.assert_allclose(level, level[0], rtol=1e-9)


def test_lines_of_a_system_are_found_in_the_solution():
    solution = simulate(HANGING)
    assert [line.name for line in solution.lines] == ["left", "right"]
    left, right = solution.lines
    np.testing.assert_array_equal(solution.positions[:, left.nodes][:, -1], solution.positions[:, right.nodes][:, 0])
    np.testing.assert_array_equal(solution.point_path("joint"), solution.positions[:, 6])
    # started in its static pose it stays there
    assert np.max(np.abs(solution.positions[-1] - solution.positions[0])) < 1e-6


def test_held_points_are_pulled_along_the_links_that_end_there():
    table = scene_of(
        {"a": [0.0, 0.0, 0.0], "free": free_at([6.0, 0.0, -8.0]), "b": [12.0, 0.0, 0.0]},
        line_of("left", "a", "free", 2, 10.0, type="rope"),
        line_of("right", "b", "free", 2, 10.0, type="rope"),
        line_type=[ROPE],
    )
    scene = load_scene(table)
    nodes = np.array([[0, 0, 0], [3, 0, -4], [6, 0, -8], [12, 0, 0], [12, 0, -5], [6, 0, -8]], float)
    found = fixed_point_loads(scene, nodes, np.array([50.0, 40.0, 70.0, 60.0]))
    assert found.keys() == {"a", "b"}
    half_link = 9.81 * 1.0 * 2.5
    np.testing.assert_allclose(found["a"], [30.0, 0.0, -40.0 - half_link])
    np.testing.assert_allclose(found["b"], [0.0, 0.0, -70.0 - half_link])
    offsets = [(row["name"], row["first_node"], row["first_link"]) for row in line_offsets(scene)]
    assert offsets == [("left", 0, 0), ("right", 3, 2)]


def test_points_of_a_vessel_move_together():
    places = {"anchor": [0.0, 0.0, -10.0], "bow": [9.0, 1.0, 0.0], "stern": [9.0, -1.0, 0.0]}
    motion = {"point": "bow", "also": ["stern"], "amplitude": [1.0, 0.0, 0.5], "period": 8.0}
    lines = [line_of(name, "anchor", name, 2, 14.0, type="rope") for name in ("bow", "stern")]
    table = scene_of(places, *lines, line_type=[ROPE], effects={"weight": {}, "end_motion": motion})
    scene = load_scene(table)
    assert load_scene(scene.to_dict()) == scene
    ends = build_model(scene).ends(2.0)
    # a quarter of a period: the full amplitude, at rest
    shift = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [1.0, 0.0, 0.5]])
    np.testing.assert_allclose(ends.positions, np.array(list(places.values())) + shift, atol=1e-12)
    np.testing.assert_allclose(ends.velocities, 0.0, atol=1e-12)
    with pytest.raises(SceneError, match="effects.end_motion.also.0: 'stren' is not a fixed point"):
        load_scene({**table, "effects": {"weight": {}, "end_motion": {**motion, "also": ["stren"]}}})


def hung(**line) -> dict:
    """A link of 2 kg below a fixed point."""
    own = {"name": "link", "axial": {"law": "rope", "EA": 1e4}} | line
    return hung_line(1, 1.0, 2.0, **own) | {"run": {"dt": 0.01, "duration": 0.1}}


def with_line_far_away(scene: dict, **line) -> dict:
    far = [{"name": "x", "position": [50.0, 0.0, 0.0]}, {"name": "y", "position": [52.0, 0.0, 0.0]}]
    other = {**scene["line"][0], "name": "other", "from": "x", "to": "y", "links": 3, **line}
    return {**scene, "point": [*scene["point"], *far], "line": [*scene["line"], other]}


@pytest.mark.parametrize(("nodes", "mass"), [(None, 2.0), ("far", 2.0), ("shared", 1.0)])
def test_a_line_that_touches_nothing_changes_no_masses_and_no_tension(nodes, mass):
    scene = hung(**({} if nodes is None else {"nodes": nodes}))
    for one in (scene, with_line_far_away(scene), with_line_far_away(scene, nodes="shared")):
        model = build_model(load_scene(one))
        end = model.geometry.node("link" if one is not scene else 0, 1)
        assert float(model.node_mass[end]) == mass
        assert float(equilibrium(one).tension[0]) == pytest.approx(mass * 9.81, rel=1e-9)


def test_far_and_shared_links_meet_at_a_point_with_their_own_masses():
    scene = hung(nodes="far")
    scene["point"].append({"name": "low", "kind": "free", "position": [0.0, 0.0, -3.0]})
    below = {"name": "below", "from": "end", "to": "low", "links": 2, "mass": 3.0, "nodes": "shared"}
    scene["line"].append({**scene["line"][0], **below})
    tension = equilibrium(scene).tension
    np.testing.assert_allclose(tension, 9.81 * np.array([2.0 + 6.0, 4.5, 1.5]), rtol=1e-9)
    scene["line"][1]["nodes"] = "far"
    np.testing.assert_allclose(equilibrium(scene).tension, 9.81 * np.array([2.0 + 6.0, 6.0, 3.0]), rtol=1e-9)


def test_water_forces_of_far_links_go_to_their_far_nodes():
    water = {"sea": {"depth": 20.0, "density": 1025.0}, "effects": {"weight": {}, "buoyancy": {}}}
    scene = hung(nodes="far", diameter=0.03) | water
    for point, z in zip(scene["point"], (-5.0, -6.0), strict=True):
        point["position"] = [0.0, 0.0, z]
    displaced = 1025.0 * np.pi / 4 * 0.03**2
    for one in (scene, with_line_far_away(scene, nodes="shared")):
        if one is not scene:
            one["point"][2]["position"], one["point"][3]["position"] = [50.0, 0.0, -5.0], [52.0, 0.0, -5.0]
        assert float(equilibrium(one).tension[0]) == pytest.approx(9.81 * (2.0 - displaced), rel=1e-6)


def test_where_the_mass_of_links_goes_is_reported_and_what_cannot_be_is_refused():
    scene = load_scene(with_line_far_away(hung()))
    assert scene.link_mass_nodes == {"link": "far", "other": "far"}
    assert load_scene(scene.to_dict()).link_mass_nodes == scene.link_mass_nodes
    upside_down = hung(**{"from": "end", "to": "top", "nodes": "far"})
    with pytest.raises(SceneError, match=r"line.0.nodes: 'far' leaves the free point 'end' without mass"):
        load_scene(upside_down)
    kind = {"name": "rope", "mass": 2.0, "diameter": 0.02, "EA": 1e4}
    by_the_metre = {"name": "link", "from": "top", "to": "end", "type": "rope", "length": 1.0, "links": 1}
    scene = {**hung(), "line_type": [kind], "line": [by_the_metre]}
    assert load_scene(scene).link_mass_nodes == {"link": "shared"}
    scene["line"] = [{**by_the_metre, "nodes": "far"}]
    assert float(build_model(load_scene(scene)).node_mass[0]) == 2.0
    scene["line"] = [{**by_the_metre, "mass": 7.0}]
    with pytest.raises(SceneError, match="line.0.mass: belongs to the line's type"):
        load_scene(scene)
