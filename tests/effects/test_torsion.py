"""Twist of rods against closed forms, and the tension it brings."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.analysis import writhe

LENGTH, GJ, POLAR, MOMENT, LINKS = 2.0, 1.0, 0.01, 0.3, 40
SPEED = np.sqrt(GJ / POLAR)  # of a wave of twist [m/s]
MASS, EA, COUPLING, LINKED = 5.0, 2000.0, 20.0, 6


#: A link of the rod per metre.
OWN = {"diameter": 0.02, "axial": {"EA": EA, "law": "elastic", "damping": 200.0}}


def twisted(points, rods, dt=0.005, duration=0.6, **torsion):
    """A scene with weight and torsion."""
    effects = {"weight": {}, "torsion": {"GJ": GJ, "polar_inertia": POLAR, **torsion}}
    return system(points, rods, dt=dt, duration=duration, effects=effects)


def rod(links=LINKS, loaded=False, **more):
    """A rod that hangs down, with a mass at its end where it is loaded."""
    each = LENGTH / links
    points = [fixed("a", 0.0, 0.0, 0.0), free("b", 0.0, 0.0, -LENGTH, **({"mass": MASS} if loaded else {}))]
    return twisted(points, [line_of("rod", "a", "b", links, each, mass=0.1 * each, **OWN)], **more)


@pytest.mark.check
def test_a_moment_twists_a_rod_by_t_l_over_gj():
    solution = dj.simulate(rod(torque=MOMENT, duration=0.1))
    assert solution.status == "ok"
    s = np.linspace(0.0, LENGTH, LINKS + 1)
    for row in solution.twist:
        np.testing.assert_allclose(row, MOMENT * s / GJ, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(solution.torque, MOMENT, rtol=1e-9)


@pytest.mark.check
def test_a_rod_turned_at_its_end_carries_gj_by_its_turn():
    solution = dj.simulate(rod(turn=1.5, turn_time=0.2, last="held", damping=0.05, duration=3.0))
    np.testing.assert_allclose(solution.torque[-1], GJ * 1.5 / LENGTH, rtol=1e-3)
    assert solution.twist[-1, -1] == pytest.approx(1.5)
    assert solution.twist[20, -1] == pytest.approx(0.75)


@pytest.mark.parametrize("hand", [1.0, -1.0])
def test_writhe_of_a_helix_is_its_turns_by_one_minus_the_cosine_of_its_pitch(hand):
    turns, angle, links = 3.0, 0.7, 600
    phase = np.linspace(0.0, 2 * np.pi * turns, links + 1)
    helix = np.stack([np.tan(angle) * np.cos(phase), hand * np.tan(angle) * np.sin(phase), phase], axis=1)
    # the first and last links run along the axis: the tangent goes from the pole to its circle and back
    ends = [helix[:1] - [0.0, 0.0, 1.0], helix[-1:] + [0.0, 0.0, 1.0]]
    found = writhe(np.concatenate([ends[0], helix, ends[1]])[None], [0.0, 0.0, 1.0])
    assert found[0] == pytest.approx(hand * turns * (1.0 - np.cos(angle)), rel=3e-3)
    arc = np.linspace(-1.0, 1.0, 50)
    assert writhe(np.stack([arc, 0 * arc, arc**2], axis=1)[None], [1.0, 0.0, 0.0])[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.check
def test_a_run_reports_where_its_torque_would_form_loops():
    scene = rod(torque=MOMENT, duration=0.02)
    plain = dj.simulate(scene)
    assert not any("loops" in words for words in plain.warnings)
    pull = float(np.min(plain.tension[plain.tension > 0.0]))
    # Greenhill: 2 sqrt(EI T) = Q at EI = Q^2/(4 T)
    for share, warned in ((1.1, False), (0.5, True)):
        stiff = {**scene, "effects": {**scene["effects"], "bending": {"EI": share * MOMENT**2 / (4.0 * pull)}}}
        assert any("it would form loops" in words for words in dj.simulate(stiff).warnings) == warned


@pytest.mark.check
def test_a_moment_put_on_at_once_swings_the_rod_with_its_natural_periods():
    solution = dj.simulate(rod(torque=MOMENT, begins="untwisted", dt=0.002, duration=2.2))
    # of sin((2 m + 1) pi s/(2 L)) the moment holds a_m = 8 T L/(GJ pi^2) (-1)^m/(2 m + 1)^2; put on at once it
    # goes as a_m (1 - cos(omega_m t)), omega_m = (2 m + 1) pi c/(2 L)
    j, weight = np.arange(LINKS + 1), np.ones(LINKS + 1)
    weight[[0, -1]] = 0.5
    for m in (0, 1):
        odd = 2 * m + 1
        share = solution.twist @ (weight * np.sin(0.5 * odd * np.pi * j / LINKS)) * 2.0 / LINKS
        holds = 8.0 * MOMENT * LENGTH / (GJ * np.pi**2) * (-1.0) ** m / odd**2
        exact = holds * (1.0 - np.cos(0.5 * odd * np.pi * SPEED / LENGTH * solution.t))
        np.testing.assert_allclose(share, exact, atol=(0.01 if m == 0 else 0.1) * 2.0 * abs(holds))
    phi, rate = solution.own["torsion.0"], solution.own["torsion.1"]
    inertia = np.full(LINKS + 1, POLAR * LENGTH / LINKS)
    inertia[[0, -1]] *= 0.5
    stored = 0.5 * np.sum(inertia * rate**2, axis=1) + 0.5 * GJ * LINKS / LENGTH * np.sum(np.diff(phi) ** 2, axis=1)
    np.testing.assert_allclose(stored - MOMENT * phi[:, -1], 0.0, atol=1e-11)


@pytest.mark.check
@pytest.mark.parametrize("loaded", [False, True])
def test_twist_brings_tension_and_strain_torque_as_in_the_papers_20(loaded):
    solution = dj.simulate(rod(LINKED, loaded, duration=8.0, dt=0.02, coupling=COUPLING, damping=0.4))
    assert solution.status == "ok", solution.failure
    assert solution.settings["solver"] == ("network" if loaded else "banded")
    # a free end: GJ tau/l + k e = 0, and T = EA e + k tau/l is the load
    # (a mass at the end is a system, whose links put half of their mass on either node)
    below = LINKED - 0.5 * loaded - np.arange(LINKED)
    load = 9.81 * (MASS * loaded + 0.1 * LENGTH / LINKED * below)
    strain = load / (EA - COUPLING**2 / GJ)
    length = np.linalg.norm(np.diff(solution.positions[-1], axis=0), axis=1)
    np.testing.assert_allclose(length / (LENGTH / LINKED) - 1, strain, rtol=0.01)
    np.testing.assert_allclose(np.diff(solution.twist[-1]) / (LENGTH / LINKED), -COUPLING * strain / GJ, rtol=0.01)
    np.testing.assert_allclose(solution.torque[-1], 0.0, atol=1e-3 * COUPLING * np.max(strain))


@pytest.mark.check
def test_derivatives_are_those_of_differences_both_ways(slopes_of):
    model, s = dj.build(rod(3, True, torque=MOMENT, coupling=COUPLING, begins="untwisted"))
    stepper = dj.make_stepper(model, halvings=0)

    def end(x):
        weight, torsion = model.effects[:2]
        changed = replace(torsion, GJ=x[0] * torsion.GJ, coupling=x[1] * torsion.coupling, torque=x[2] * torsion.torque)
        last, _ = dj.integrate(stepper, replace(model, effects=(weight, changed, *model.effects[2:])), s, 0.01, 30)
        return jnp.sum(last.own["torsion"][0] ** 2) + 1e3 * last.r[-1, 2]

    slopes_of(end, jnp.ones(3))


def test_a_broken_link_passes_neither_torque_nor_tension_by_twist():
    scene = rod(LINKED, torque=MOMENT, coupling=COUPLING, duration=0.2)
    solution = dj.simulate({**scene, "failure": [{"line": "rod", "link": 3, "time": 0.1}]})
    after = [-10, -1]
    share = np.array([1.0, 1.0, 1.0, 0.5])  # of a link's polar inertia, on the nodes below the broken one
    gained = np.diff(solution.own["torsion.1"][after, 3:] @ share)[0] * POLAR * LENGTH / LINKED
    assert gained == pytest.approx(MOMENT * np.diff(solution.t[after])[0], rel=1e-9)
    fallen = np.diff(np.mean(solution.velocities[after, 3:, 2], axis=1))[0]  # equal masses, at the links' far nodes
    assert fallen == pytest.approx(-9.81 * np.diff(solution.t[after])[0], rel=1e-9)
    assert solution.torque[-1, 2] == 0.0


def two_pieces(turned_round=False, pairs=True, **torsion):
    """The hanging rod in two lines of 3 and 5 links; `turned_round`: the second line runs upwards."""
    each = LENGTH / 8
    ends = ("b", "middle") if turned_round else ("middle", "b")
    points = [fixed("a", 0.0, 0.0, 0.0), free("middle", 0.0, 0.0, -3 * each), free("b", 0.0, 0.0, -LENGTH, mass=MASS)]
    lines = [line_of("upper", "a", "middle", 3, each, mass=0.1 * each, **OWN)]
    lines.append(line_of("lower", *ends, 5, each, mass=0.1 * each, **OWN))
    if pairs:
        torsion = {"joined": [["upper", "lower"]], **torsion}
    return twisted(points, lines, duration=0.2, **torsion)


def test_joined_lines_twist_as_one_rod():
    torsion = {"torque": MOMENT, "begins": "untwisted", "damping": 0.01, "coupling": COUPLING}
    both = dj.simulate(two_pieces(False, **torsion))
    one = dj.simulate(rod(8, True, duration=0.2, **torsion))
    assert both.status == one.status == "ok"
    np.testing.assert_allclose(np.delete(both.twist, 4, axis=1), one.twist, atol=1e-9)
    np.testing.assert_allclose(both.torque, one.torque, atol=1e-7)
    assert np.ptp(one.twist[:, -1]) > 0.1


@pytest.mark.check
def test_a_joined_line_that_runs_the_other_way_passes_the_same_torque():
    scene = two_pieces(True, last="held", first="held", turn=0.0, coupling=COUPLING, torque=0.0)
    scene["line"][0] |= {"from": "middle", "to": "a"}  # last points: the rod's upper end, and `middle`
    scene["effects"]["torsion"] |= {"turn": 0.5}
    run = dj.simulate(scene)
    straight = dj.simulate(two_pieces(False, last="held", turn=0.5, coupling=COUPLING))
    # turned by 0.5 about the upward axis at the top, or about the downward one at the bottom: the same twist
    np.testing.assert_allclose(run.torque[:, 2::-1], straight.torque[:, :3], rtol=1e-9)
    np.testing.assert_allclose(run.torque[:, :2:-1], straight.torque[:, 3:], rtol=1e-9)


@pytest.mark.check
def test_lines_that_are_not_joined_pass_no_torque():
    apart = dj.simulate(two_pieces(False, pairs=False, torque=MOMENT))
    np.testing.assert_allclose(apart.torque[-1], MOMENT, rtol=1e-9)  # each has the moment at its own last point
    shared = dj.simulate(two_pieces(False, torque=MOMENT))
    np.testing.assert_allclose(shared.twist[-1, -1], MOMENT * LENGTH / GJ, rtol=1e-9)
    np.testing.assert_allclose(apart.twist[-1, -1], MOMENT * LENGTH * 5 / 8 / GJ, rtol=1e-9)


def winched_rod(**torsion):
    """The rod, whose last link a winch shortens."""
    scene = rod(LINKED, **torsion)
    scene["line"][0]["length_in_time"] = [{"end": "to", "time": [0.0, 1.0], "length": [LENGTH / LINKED, 0.3]}]
    return scene


@pytest.mark.parametrize(
    ("lines", "change", "words"),
    [
        (rod, {"lines": ["rope"]}, "lines.0: 'rope' is not a line"),
        (rod, {"first": "free"}, "last: 'free' lets lines spin"),
        (rod, {"last": "held", "torque": 1.0}, "torque: 1 only applies to last points that are free"),
        (winched_rod, {"coupling": 1.0}, "coupling: needs strains over constant lengths"),
        (rod, {"turn": 1.0}, "turn: 1 only applies to last points that are held"),
        (two_pieces, {"joined": [["upper", "lover"]]}, "joined.0: 'lover' is not a line with torsion"),
        (two_pieces, {"joined": [["upper", "lower"], ["lower", "upper"]]}, "joined.1: 'lower' is joined to another"),
        (two_pieces, {"first": "free"}, "last: 'free' lets lines spin freely (upper, lower)"),
        (two_pieces, {"lines": ["upper"]}, "joined.0: 'lower' is not a line with torsion"),
    ],
)
def test_what_cannot_twist_is_refused(lines, change, words, refusal):
    assert f"effects.torsion.{words}" in refusal(dj.load_scene, lines(**change))
