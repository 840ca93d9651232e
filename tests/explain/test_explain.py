"""Answers on moorings against an integration of the line's equations by SciPy, and against other equilibria."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scene_parts import fixed, line_of, system
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.explain.answers import explain
from dropper_jax.explain.catenary import Hanging, offset_until_uplift, solve
from dropper_jax.explain.line_facts import LineFacts, line_facts
from dropper_jax.scene import whole_lines


def laid_out(line, horizontal, vertical):
    """Span and rise [m] of a line from its upper end down, by the forces there: dT/ds = w, stretch T/EA."""

    def slopes(s, y):
        v = vertical - line.weight * s
        if line.on_bed and v <= 0.0:
            return [1.0 + horizontal / line.EA, 0.0]
        tension = np.hypot(horizontal, v)
        stretch = 1.0 + tension / line.EA
        return [stretch * horizontal / tension, stretch * v / tension]

    touch = min(vertical / line.weight, line.length) if line.on_bed else line.length
    hung = solve_ivp(slopes, (0.0, touch), [0.0, 0.0], rtol=1e-11, atol=1e-11).y[:, -1]
    if touch == line.length:
        return hung
    return hung + (line.length - touch) * np.array([1.0 + horizontal / line.EA, 0.0])


@pytest.mark.parametrize(
    "line",
    [
        Hanging(300.0, 80.0, 350.0, 600.0, 3e8, True),
        Hanging(300.0, 80.0, 320.0, 600.0, 2e5, True),
        Hanging(2.5, 0.3, 12.0, 40.0, 1e4, False),
        Hanging(3.0, 0.5, 2.6, 3e-5, 36.0, False),
        Hanging(0.4, 60.0, 61.0, 500.0, 1e7, False),
    ],
    ids=["long", "soft", "loop", "taut", "steep"],
)
def test_the_closed_form_is_the_line_that_its_forces_lay_out(line):
    shape = solve(line)
    np.testing.assert_allclose(laid_out(line, shape.horizontal, shape.vertical), [line.span, line.rise], rtol=1e-7)
    # its stiffness is that of a difference
    moved = [solve(replace(line, span=line.span + d)).horizontal for d in (1e-4, -1e-4)]
    slope = (moved[0] - moved[1]) / 2e-4
    assert shape.stiffness[0, 0] == pytest.approx(slope, rel=1e-4)


def test_a_line_lifts_its_anchor_at_the_reported_offset():
    line = Hanging(300.0, 80.0, 350.0, 600.0, 3e8, True)
    reserve = offset_until_uplift(line)
    at = solve(replace(line, span=line.span + reserve))
    assert at.bed == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < reserve < 40.0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rise", [0.0, 5.0])
def test_a_fold_below_one_vertical_has_no_closed_form(rise):
    assert solve(Hanging(np.float64(0.0), np.float64(rise), 12.0, 40.0, 1e4, False)) is None


def chain(x, length, links=60):
    """A chain of 70 kg/m from an anchor at x, 80 m deep, to a fairlead at 10 m."""
    kind = {"mass": 70.0 * length / links, "diameter": 0.1, "breaking_load": 4e6, "nodes": "shared"}
    axial = {"law": "rope", "EA": 3e8, "damping": 4e6}
    return system(
        [fixed("anchor", x, 0.0, -80.0), fixed("top", 0.0, 0.0, -10.0)],
        [line_of("chain", "anchor", "top", links, length / links, **kind, axial=axial)],
        sea={"depth": 80.0},
        effects={"weight": {}, "buoyancy": {}, "seabed": {}},
    )


@pytest.fixture(scope="module")
def answers():
    return explain(dj.load_scene(chain(120.0, 160.0)), dj.equilibrium(chain(120.0, 160.0)))


def test_tensions_and_stiffness_are_those_of_the_closed_form_within_the_links(answers):
    (line,) = answers.lines
    assert line.upper_n == pytest.approx(line.closed_upper_n, rel=3e-3)
    assert line.lower_n == pytest.approx(line.closed_lower_n, rel=1e-2)
    assert answers.held == ("top",)
    np.testing.assert_allclose(np.diag(answers.stiffness)[:2], answers.closed_stiffness, rtol=0.05)
    assert line.verdict.startswith("long enough: its anchor lifts after")
    # half a wave between held ends
    assert line.axial_period_s == pytest.approx(2.0 * 160.0 / np.sqrt(3e8 / 70.0))


FRICTION = {"seabed_friction": {"kinetic": 1.0, "statics": "outward"}}
SLOPE = {"seabed": {"bed_x": [0.0, 120.0], "bed_y": [0.0, 1.0], "bed_depth": [70.0, 70.0, 80.0, 80.0]}}


@pytest.mark.parametrize(("effects", "applies"), [({}, True), (FRICTION, False), (SLOPE, False)])
def test_no_closed_form_is_stated_on_a_bed_that_it_does_not_know(effects, applies):
    table = chain(120.0, 160.0)
    table["effects"] |= effects
    scene = dj.load_scene(table)
    nodes = np.array([[120.0, 0.0, -80.0]] * 59 + [[100.0, 0.0, -80.0], [0.0, 0.0, -10.0]])
    facts, _ = line_facts(scene, whole_lines(scene)[0], nodes, 1e5, np.ones(2), np.zeros(2))
    assert (facts.closed_upper_n is not None) == applies


def test_damping_ratios_of_a_line_of_chain_and_rope_are_those_of_its_links():
    """The ratio of the stiffest link took the mass of one section, the stiffness and the damping of another."""
    kinds = [
        {"name": "chain", "mass": 70.0, "diameter": 0.1, "EA": 3e8, "damping_ratio": 0.1},
        {"name": "rope", "mass": 2.0, "diameter": 0.06, "EA": 2e6, "damping_ratio": 0.2},
    ]
    sections = [{"type": "chain", "length": 20.0, "links": 10}, {"type": "rope", "length": 60.0, "links": 5}]
    table = system(
        [fixed("anchor", 60.0, 0.0, -50.0), fixed("top", 0.0, 0.0, -10.0)],
        [{"name": "leg", "from": "anchor", "to": "top", "sections": sections}],
        line_type=kinds,
        sea={"depth": 50.0},
        effects={"weight": {}, "buoyancy": {}, "seabed": {}},
    )
    scene = dj.load_scene(table)
    (leg,) = whole_lines(scene)
    nodes = np.linspace([60.0, 0.0, -50.0], [0.0, 0.0, -10.0], 16)
    facts, _ = line_facts(scene, leg, nodes, 1e4, np.ones(2), np.zeros(2))
    assert facts.link_damping_ratio == pytest.approx(0.1)  # links of chain are the stiffest
    # one tension stretches links by length/EA, with losses of damping ratio times length times sqrt(EA mass)
    stretch = np.array([20.0 / 3e8, 60.0 / 2e6])
    damping = np.array([0.1 * 2.0 * np.sqrt(3e8 * 70.0), 0.2 * 12.0 * np.sqrt(2e6 * 2.0)])
    rate = np.pi / np.sqrt(stretch.sum() * (20.0 * 70.0 + 60.0 * 2.0))
    expected = 0.5 * rate * np.sum(damping / [3e8, 2e6] * stretch) / stretch.sum()
    assert facts.damping_ratio == pytest.approx(expected)


@pytest.mark.check
def test_mussels_lengthen_the_axial_period_of_a_line():
    table = chain(120.0, 160.0, links=10)
    table["line"][0]["growth"] = {"depth": [0.0, 90.0], "thickness": [0.05, 0.05], "density": 1300.0}
    scene = dj.load_scene(table)
    (line,) = explain(scene, dj.equilibrium(scene)).lines
    mass = 70.0 + 1300.0 * np.pi / 4.0 * (0.2**2 - 0.1**2)  # a layer of 5 cm on a bar of 10 cm
    assert line.axial_period_s == pytest.approx(2.0 * 160.0 / np.sqrt(3e8 / mass), rel=1e-6)


def test_wear_by_the_derivative_is_that_of_another_equilibrium(answers):
    (row,) = answers.wear
    assert row.by_derivative_n == pytest.approx(row.by_equilibrium_n, rel=5e-3)
    assert row.by_equilibrium_n < row.tension_n
    # load and strength fall together
    assert row.worn_use == pytest.approx(row.use, rel=0.02)


@pytest.mark.check
def test_wear_of_a_straight_table_is_that_of_its_stiffness(answers):
    scene = chain(120.0, 160.0)
    scene["line"][0]["axial"] = {"law": "tabulated", "strain": [0.0, 0.5], "tension": [0.0, 1.5e8], "damping": 4e6}
    (row,) = explain(dj.load_scene(scene), dj.equilibrium(scene)).wear
    (expected,) = answers.wear
    assert row.by_equilibrium_n == pytest.approx(expected.by_equilibrium_n, rel=1e-6)
    assert row.by_derivative_n == pytest.approx(expected.by_derivative_n, rel=1e-6)


@pytest.mark.check
def test_a_line_that_hangs_straight_down_is_too_long(json_of, tmp_path):
    file = tmp_path / "long.toml"
    file.write_text(dj.as_toml(chain(60.0, 150.0, links=50)))
    (line,) = json_of(["explain", str(file), "--json"])["lines"]
    assert line["verdict"].startswith("too long by 20 m")
    assert line["closed_upper_n"] == pytest.approx(42537.0, rel=1e-3)
    assert line["closed_lower_n"] == line["lower_n"] == 0.0


def test_rigid_links_are_refused():
    with pytest.raises(SceneError, match="line dropper: rigid links have no stiffness"):
        explain(dj.load_scene("dropper-release-a"), dj.equilibrium("dropper-release-a"))


def test_a_slack_line_that_rests_on_the_bed_over_its_length_is_not_said_to_hang():
    numbers = dict.fromkeys((field.name for field in fields(LineFacts)), 0.0)
    own = {"length_m": 50.0, "apart_m": 45.0, "on_bed_m": 50.0, "reserve_m": None, "excess_m": 5.0}
    facts = LineFacts(**numbers | own)
    assert facts.verdict == "rests on the bed"
    assert "hangs straight down" in replace(facts, on_bed_m=30.0).verdict
