"""Error bars of loads against truths that are known: SciPy's bouncing mass, a chain at rest, chaos."""

import json

import numpy as np
import pytest
from hard_scenes import hung_line
from scene_parts import fixed, free, line_of, system
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax import load_scene
from dropper_jax.study.load_convergence import load_convergence
from dropper_jax.study.twice_the_links import twice_the_links

PERIOD = 0.2


@pytest.fixture(scope="module")
def bounce(falling):
    """The largest and the mean tension of the falling mass over its 0.4 s, from SciPy."""
    scene = falling(PERIOD, 0.01)
    mass = float(dj.build(scene)[0].node_mass[0])
    EA, length = scene["line"][0]["axial"]["EA"], 2.0
    pull = lambda z: EA / length * np.maximum(-z - length, 0.0)  # noqa: E731
    rates = lambda t, y: [y[1], pull(y[0]) / mass - 9.81]  # noqa: E731
    found = solve_ivp(rates, (0.0, 0.4), [-1.8, 0.0], rtol=1e-10, atol=1e-12, max_step=1e-4)
    tension = pull(found.y[0])
    return float(tension.max()), float(np.trapezoid(tension, found.t) / 0.4)


def row(scene, **run):
    found = dj.simulate(scene, errors=True, **run).settings["load_errors"]
    return found, found["loads"][0]


@pytest.mark.check
@pytest.mark.slow
def test_errors_of_a_bounce_hold_and_are_not_much_too_large(falling, bounce):
    """One link, so that the step is all there is to err; twice the links is another pendulum of springs."""
    held = []
    for steps in (10, 20, 40, 80):
        _, found = row(falling(PERIOD, PERIOD / steps))
        for name, truth in zip(("maximum", "mean"), bounce, strict=True):
            error = abs(found[name]["value"] - truth)
            held.append((error <= 2.0 * found[name]["step"] + 1e-6 * truth, found[name]["step"] / max(error, 1e-9)))
    assert np.mean([ok for ok, _ in held]) >= 0.9
    assert np.median([ratio for _, ratio in held]) < 4.0


def hanging(links, **more):
    """A rope of 10 m and 20 kg that hangs from one end."""
    axial = {"law": "rope", "EA": 1e5, "damping": 100.0}
    return hung_line(links, 10.0 / links, 20.0 / links, axial=axial, **more) | {"run": {"dt": 0.01, "duration": 0.4}}


def test_halves_of_links_are_the_same_line():
    diameter = np.array([0.1, 0.2, 0.3, 0.4])
    scene = load_scene(hanging(4, diameter=diameter.tolist(), outer_diameter=(2.0 * diameter).tolist()))
    finer = twice_the_links(scene).lines[0]
    assert (finer.links, finer.total, finer.mass.sum()) == pytest.approx((8, 10.0, 20.0))
    np.testing.assert_allclose(finer.diameter, np.repeat(diameter, 2))
    np.testing.assert_allclose(finer.outer_diameter, np.repeat(2.0 * diameter, 2))
    np.testing.assert_allclose(finer.EA, 1e5)
    np.testing.assert_allclose(finer.axial_damping, 100.0)


@pytest.mark.parametrize("name", ["paper-case-1", "edulis-longline", "dropper-current", "platform-longline"])
def test_halves_of_packaged_scenes_have_the_same_numbers(name):
    scene = load_scene(name)
    finer = twice_the_links(scene)
    for key in ("length", "mass"):
        assert getattr(finer.line, key).sum() == pytest.approx(getattr(scene.line, key).sum())
    assert finer.line.links == 2 * scene.line.links
    assert twice_the_links(finer).line.links == 4 * scene.line.links


def test_halves_have_the_table_of_tensions_of_their_link():
    soft = ([0.0, 0.1, 0.2], [0.0, 1e3, 3e3])
    stiff = ([0.0, 0.1], [0.0, 1e4])
    for strain, tension in (soft, zip(soft, stiff, strict=True)):
        scene = hanging(2)
        axial = {"law": "tabulated", "strain": list(strain), "tension": list(tension), "damping": [10.0, 20.0]}
        scene["line"][0]["axial"] = axial
        scene = load_scene(scene)
        line = scene.lines[0]
        finer = twice_the_links(scene).lines[0]
        assert finer.axial_damping.tolist() == [10.0, 10.0, 20.0, 20.0]
        for link, half in enumerate(finer.tables):
            np.testing.assert_array_equal(half.strain, line.tables[link // 2].strain)
            np.testing.assert_array_equal(half.tension, line.tables[link // 2].tension)


@pytest.mark.parametrize(
    ("where", "finer"),
    [({"end": "to"}, range(6, 8)), ({"end": "from", "links": 3}, range(6)), ({"link": 4}, range(6, 8))],
)
def test_both_halves_of_hauled_links_are_hauled(where, finer):
    length = 2.5 * where.get("links", 1)
    haul = {**where, "time": [0.0, 1.0], "length": [length, 2.0 * length]}
    hauled = twice_the_links(load_scene(hanging(4, length_in_time=[haul]))).lines[0].length_in_time[0]
    assert (hauled.numbers(8), hauled.length.tolist()) == (finer, [length, 2.0 * length])


def test_new_nodes_of_a_given_start_are_in_the_middle_of_links_never_between_lines():
    x = [0.0, 1.0, 2.0, 2.0, 3.0, 4.0]
    z = [0.0, -1.0, -1.0, -1.0, -1.0, 0.0]
    positions = np.stack([x, np.zeros(6), z], axis=1).tolist()
    points = [fixed("west", *positions[0]), free("middle", *positions[2]), fixed("east", *positions[-1])]
    rope = {"mass": 1.0, "axial": {"law": "rope", "EA": 1e5}}
    lines = [line_of("a", "west", "middle", 2, 1.1, **rope), line_of("b", "middle", "east", 2, 1.1, **rope)]
    start = {"kind": "positions", "positions": positions}
    finer = twice_the_links(load_scene(system(points, lines, start=start))).start.positions
    np.testing.assert_array_equal(finer[[0, 2, 4, 5, 7, 9]], positions)
    np.testing.assert_array_equal(finer[[1, 6]], [[0.5, 0.0, -0.5], [2.5, 0.0, -1.0]])


def test_what_has_no_halves_is_refused(refusal):
    refused = refusal(twice_the_links, load_scene("dropper-release-a-compound"))
    assert "centre_of_mass: compound links have no halves" in refused
    hauled = load_scene(hanging(4, length_in_time=[{"link": 2, "time": [0.0, 1.0], "length": [2.5, 5.0]}]))
    assert "length_in_time.link: 2 has no halves" in refusal(twice_the_links, hauled)


@pytest.mark.check
def test_a_rope_at_rest_has_no_errors(tmp_path):
    """Halves of links' masses to both nodes: the middle of the top link carries what hangs below it."""
    solution = dj.simulate(hanging(4, nodes="shared"), errors=True)
    found = solution.settings["load_errors"]
    assert not found["chaotic"]
    assert found["not_resolved"] == []
    assert found["left_out"] == {}
    assert found["loads"][0]["mean"]["value"] == pytest.approx(20.0 * 9.81 * (1.0 - 1.0 / 8), rel=1e-9)
    assert all(found["loads"][0][name]["error"] < 1e-6 * 20.0 * 9.81 for name in ("mean", "deviation", "maximum"))
    solution.save(tmp_path / "run.npz")
    again = dj.Solution.load(tmp_path / "run.npz")
    assert again.settings["load_errors"]["loads"][0]["line"] == "rope"
    json.dumps(solution.summary())


@pytest.mark.check
def test_errors_hold_for_links_of_first_order():
    """Links' masses at their far nodes: the top link carries the whole rope, half a link more than it should."""
    found, rope = row(hanging(2, nodes="far"), dt=0.1)
    assert not found["chaotic"]
    error = abs(rope["mean"]["value"] - 20.0 * 9.81 * (1.0 - rope["at_m"] / 10.0))
    assert error == pytest.approx(20.0 * 9.81 / 4, rel=1e-6)
    assert error <= rope["mean"]["error"] <= 1.5 * error


def test_a_step_that_fails_is_named():
    scene = hanging(2)
    scene["run"] |= {"integrator": "rk4", "dt": 0.2, "duration": 2.0}
    assert dj.simulate(scene, errors=True).settings.get("load_errors") is None


@pytest.mark.check
@pytest.mark.parametrize(
    ("key", "values"), [("dt", (0.02, 0.01, 0.005, 0.0025)), ("accuracy", (0.1, 0.01, 1e-3, 1e-4))]
)
def test_loads_of_a_bounce_converge_and_the_advice_counts_from_below(falling, bounce, key, values):
    largest, mean = bounce
    found = load_convergence(load_scene(falling(PERIOD, 0.01)), key, values)
    (loads,) = found["loads"]
    assert loads["maximum"] == pytest.approx(largest, rel=2e-3)
    assert loads["mean"] == pytest.approx(mean, rel=2e-3)
    errors = [row["errors"]["maximum"] for row in found["rows"]]
    assert errors == sorted(errors, reverse=True)
    for item in found["advice"]:
        passed = [row["errors"][item["load"]] <= item["within"] for row in found["rows"]]
        first = next((i for i in range(len(passed)) if all(passed[i:])), None)
        assert item["dt"] == (None if first is None else found["rows"][first]["dt"])
