"""A season of mussels on the lines of a system: layers by month and depth, random along a line, harvest, drop-off."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError, build_model, report_run
from dropper_jax.modelling import scene_model
from dropper_jax.modelling.growth import overgrown, season_table
from dropper_jax.plausibility.line_weights import line_weights
from dropper_jax.report import sections
from dropper_jax.run.step_facts import step_facts
from fitting.parameters.scene_parameters import scene_parameter

ROPE = {"name": "rope", "mass": 0.5, "diameter": 0.02, "EA": 1e6}
GROWTH = {
    "lines": ["dropper-*"],
    "month": 6.0,
    "months": [0.0, 12.0],
    "depth": [2.0, 6.0],
    "thickness": [[0.0, 0.0], [0.08, 0.04]],
    "density": 1300.0,
}


def scene(**growth):
    points, lines = {}, []
    for i, name in enumerate(("dropper-1", "dropper-2", "mooring")):
        points[f"top-{i}"] = [3.0 * i, 0.0, -2.0]
        points[f"end-{i}"] = free_at([3.0 * i, 0.0, -6.0], mass=30.0, volume=0.01)
        lines.append(line_of(name, f"top-{i}", f"end-{i}", 4, 4.0, type="rope"))
    return scene_of(
        points,
        *lines,
        run={"dt": 0.05, "duration": 2.0},
        sea={"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.5, "period": 6.0}},
        line_type=[ROPE],
        effects={"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.2}},
        growth={**GROWTH, **growth},
    )


#: Depth of the middles of the links, which hang straight down, to the stretch of the rope.
DEPTH = 2.5 + np.arange(4.0)


def test_a_month_between_two_is_the_layer_between_on_the_named_lines_alone():
    grown = overgrown(dj.load_scene(scene()))
    thick = 0.5 * np.interp(DEPTH, [2.0, 6.0], [0.08, 0.04])
    outer = np.pi / 4 * (0.02 + 2 * thick) ** 2
    for line in grown.lines[:2]:
        assert line.diameter == pytest.approx(0.02 + 2 * thick, rel=3e-4)
        assert line.mass == pytest.approx(0.5 + 1300.0 * (outer - np.pi / 4 * 0.02**2), rel=3e-4)
    assert np.all(grown.lines[2].mass == 0.5)


def test_mussels_do_not_grow_at_the_depths_of_a_pose_that_was_not_found(monkeypatch):
    bare = scene()
    del bare["growth"]
    lost = dataclasses.replace(dj.equilibrium(bare), status="not_converged", message="no equilibrium found")
    monkeypatch.setattr(scene_model, "equilibrium", lambda *_: lost)
    with pytest.raises(SceneError, match="^start: no equilibrium found$"):
        build_model(dj.load_scene(scene()))


def test_the_month_is_a_number_of_the_scene():
    bare = dj.load_scene(scene())
    assert dj.load_scene(bare.as_written()) == bare
    assert dj.load_scene(bare.to_dict()) == bare
    assert bare.value("growth.month") == 6.0
    seeded = bare.with_values({"growth.month": 0.0})
    assert np.all(overgrown(seeded).lines[0].mass == 0.5)
    thicker = bare.with_values({"growth.thickness.1.0": 0.1})
    assert overgrown(thicker).lines[0].mass[0] > overgrown(bare).lines[0].mass[0]


def test_a_rope_without_mussels_may_float_next_to_lines_with_them():
    """Polypropylene of 0.8 kg/dm^3: the droppers sink with their mussels."""
    light = {**scene(), "line_type": [{**ROPE, "mass": 800.0 * np.pi / 4 * 0.02**2}]}
    rows = line_weights(dj.load_scene(light))
    assert [(row["lines"], row["wet_weight_n_per_m"] > 0.0, row["meant_heavy"]) for row in rows] == [
        (["dropper-1", "dropper-2"], True, True),
        (["mooring"], False, False),
    ]


def test_harvest_takes_its_share_of_the_crop_and_no_rope():
    full = overgrown(dj.load_scene(scene()))
    half = overgrown(dj.load_scene(scene(harvested=0.25, harvested_lines=["dropper-2"])))
    bare = overgrown(dj.load_scene(scene(harvested=1.0)))
    assert np.all(half.lines[0].mass == full.lines[0].mass)
    assert half.lines[1].mass - 0.5 == pytest.approx(0.75 * (full.lines[1].mass - 0.5))
    assert bare.lines[0].mass == pytest.approx(0.5, abs=1e-12)
    assert bare.lines[0].diameter == pytest.approx(0.02)


def test_random_layers_have_their_mean_deviation_and_correlation():
    season = dj.load_scene(scene(deviation=0.3, correlation=2.0, seed=4)).season
    arc = np.arange(0.0, 40_000.0, 0.5)
    factor = season.thickness_factor("dropper-1", arc)
    assert np.all(factor > 0.0)
    assert np.mean(factor) == pytest.approx(1.0, abs=0.02)
    assert np.std(factor) == pytest.approx(0.3, rel=0.05)
    # at grid points, a tenth of the correlation length apart, and between them
    spread = np.log(season.thickness_factor("dropper-1", np.arange(0.0, 40_000.0, 0.05)).reshape(-1, 4))
    assert np.std(spread, axis=0) == pytest.approx(np.sqrt(np.log(1.09)), rel=0.01)
    field = np.log(factor) - np.mean(np.log(factor))
    # four samples apart is one correlation length
    assert np.mean(field[4:] * field[:-4]) / np.mean(field**2) == pytest.approx(np.exp(-1.0), abs=0.03)
    assert np.array_equal(season.thickness_factor("dropper-1", arc[::7]), factor[::7])
    assert not np.allclose(season.thickness_factor("dropper-2", arc), factor)
    assert not np.allclose(dataclasses.replace(season, seed=5).thickness_factor("dropper-1", arc), factor)


def test_links_vibrate_with_the_mass_of_their_mussels():
    given = dj.load_scene(scene(lines=["*"]))
    line = overgrown(given).line
    run = SimpleNamespace(scene=given, settings={"dt": 0.05, "save_every": 2}, t=np.zeros(3))
    period = np.pi * np.sqrt(np.min(line.length * line.mass) / ROPE["EA"])
    assert step_facts(run)["axial_period_s"] == pytest.approx(period)
    assert np.min(line.mass) > 2.0 * np.min(given.line.mass)


def test_growth_by_month_and_depth_is_tabulated():
    rows = season_table(dj.load_scene(scene()), [12.0])
    assert [row["depth_m"] for row in rows] == [2.0, 6.0]
    assert rows[0]["lines"] == ["dropper-1", "dropper-2"]
    outer = np.pi / 4 * 0.18**2
    mass = 0.5 + 1300.0 * (outer - np.pi / 4 * 0.02**2)
    assert rows[0]["mass_kg_per_m"] == pytest.approx(mass)
    assert rows[0]["wet_weight_n_per_m"] == pytest.approx(9.81 * (mass - 1025.0 * outer))


def test_a_season_of_one_month_is_tabulated():
    one = dj.load_scene(scene(month=12.0, months=[12.0], thickness=[[0.08, 0.04]]))
    assert season_table(one) == season_table(dj.load_scene(scene(month=12.0)), [12.0])


def test_every_rope_of_a_line_is_tabulated():
    two_ropes = scene()
    two_ropes["line_type"].append({"name": "thick", "mass": 0.9, "diameter": 0.03, "EA": 1e6})
    first = two_ropes["line"][0]
    for key in ("links", "length", "type"):
        del first[key]
    first["sections"] = [{"type": kind, "links": 2, "length": 2.0} for kind in ("rope", "thick")]
    rows = season_table(dj.load_scene(two_ropes), [0.0])
    found = [(row["lines"], row["diameter_m"], row["mass_kg_per_m"]) for row in rows if row["depth_m"] == 2.0]
    assert found == [
        (["dropper-1", "dropper-2"], pytest.approx(0.02), pytest.approx(0.5)),
        (["dropper-1"], pytest.approx(0.03), pytest.approx(0.9)),
    ]


@pytest.mark.check
def test_drop_off_compares_accelerations_with_what_holds_a_mussel():
    weak, strong = (
        report_run(dj.simulate(scene(attachment=force, mussel_mass=0.004), halvings=0))["crop"]
        for force in (0.0085, 10.0)
    )
    # a mussel of 4 g displaces 4/1300*1025 g: it weighs 8.3 mN in water, and 5.58 g move with it
    displaced = 0.004 * 1025.0 / 1300.0
    limit = (0.0085 - 9.81 * (0.004 - displaced)) / (0.004 + 0.5 * displaced)
    assert weak[0]["drop_off"]["limit_m_per_s2"] == pytest.approx(limit, rel=1e-6)
    assert weak[0]["drop_off"]["share_beyond"] > 0.0
    assert 0.0 < weak[0]["drop_off"]["mass_at_risk_kg"] <= weak[0]["mass_kg"] * (1 + 1e-12)
    assert strong[0]["drop_off"]["mass_at_risk_kg"] == 0.0
    assert [row["line"] for row in weak] == ["dropper-1", "dropper-2"]
    assert "| dropper-1 |" in sections.crop(weak)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"month": 13.0}, "growth.month: 13.0 is out of range; allowed: 0 to 12"),
        ({"lines": []}, "growth.lines: is empty"),
        ({"lines": ["droper-*"]}, "growth.lines.0: 'droper-.' does not match any line"),
        ({"thickness": []}, "growth.thickness"),
        ({"thickness": [[0.0, 0.0]]}, "growth.thickness"),
        ({"thickness": [[0.0, 0.0], [0.1]]}, "growth.thickness.1"),
        ({"thickness": [[0.0, 0.0], [0.1, -0.1]]}, "growth.thickness.1.1"),
        ({"months": [12.0, 0.0]}, "growth.months"),
        ({"harvested": 1.5}, "growth.harvested"),
        ({"attachment": 1.0}, "growth.mussel_mass: missing"),
        ({"densty": 1.0}, "growth.densty"),
    ],
)
def test_a_season_that_makes_no_sense_is_refused_by_its_path(change, message):
    with pytest.raises(dj.SceneError, match=message):
        dj.load_scene(scene(**change))


def test_a_line_has_one_kind_of_growth():
    table = scene()
    table["line"][0]["growth"] = {"depth": [2.0], "thickness": [0.05], "density": 1300.0}
    with pytest.raises(dj.SceneError, match="line.0.growth: given, but .growth. lists 'dropper-1' too"):
        dj.load_scene(table)


def test_sensitivities_follow_the_month():
    found = dj.load_scene(scene())
    model = build_model(found)
    moved = scene_parameter(found, model, "growth.month").where
    thick = 0.5 * np.interp(DEPTH, [2.0, 6.0], [0.08, 0.04])
    rate = np.interp(DEPTH, [2.0, 6.0], [0.08, 0.04]) / 12.0
    expected = 1300.0 * np.pi / 4 * 2.0 * (0.02 + 2.0 * thick) * 2.0 * rate

    def mass(month):
        return moved.set_in(model, month).line.mass[:4]

    # the depths of the links are those of a rope that stretches a little
    assert np.asarray(jax.jacfwd(mass)(6.0)) == pytest.approx(expected, rel=1e-3)
    heavier = build_model(found.with_values({"growth.month": 6.001})).line.mass[:4]
    lighter = build_model(found.with_values({"growth.month": 5.999})).line.mass[:4]
    assert np.asarray(jax.jacrev(mass)(6.0)) == pytest.approx(np.asarray(heavier - lighter) / 0.002, rel=1e-6)
