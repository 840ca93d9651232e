"""Wakes of lines: one dropper against Schlichting, momentum against drag, rows, scenes."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.modelling.wake_model import Elements, solve_wakes
from dropper_jax.modelling.wakes import scene_wakes

D, C = 0.2, 1.3


def droppers(x, y=0.0, z=-4.0, high=8.0, diameter=D, drag=C):
    x = np.atleast_1d(np.asarray(x, float))
    each = [np.broadcast_to(np.asarray(v, float), x.shape).copy() for v in (y, z, 0.0, high, diameter, drag)]
    return Elements(x, *each)


def block(rows, apart=1.0, between=3.0, half=15):
    x, y = np.meshgrid(np.arange(rows) * between, np.arange(-half, half + 1) * apart)
    return droppers(x.ravel(), y.ravel()), x.shape


def scattered(count, long, wide, seed):
    """Droppers and ropes at random, from the surface to 8 m of depth."""
    low, high = np.transpose([(0, long), (0, wide), (-8, -1), (0, 3), (1, 5), (0.05, 0.2), (1.0, 1.4)])
    draw = np.random.default_rng(seed)
    return Elements(*draw.uniform(low[:, None], high[:, None], (7, count)))


def inflows_by_all_pairs(e, speed, depth, turbulence=0.05):
    """Inflow of each element over the current, every pair of wakes summed at the plane of every element."""
    met, at, share = np.full(len(e.x), speed), -np.inf, None
    nodes, weight = np.polynomial.legendre.leggauss(48)
    nodes, weight = 0.5 * depth * (nodes - 1.0), 0.5 * depth * weight
    over = lambda z, i, high: sum(  # noqa: E731
        np.exp(-0.5 * ((z - centre) / high) ** 2) for centre in (e.z[i], -e.z[i], -2 * depth - e.z[i])
    )
    for i in np.argsort(e.x):
        if e.x[i] > at + e.diameter[i]:
            at = e.x[i]
            up = np.flatnonzero(e.x < at - 2.0 * e.diameter)
            away, size = at - e.x[up], e.drag_coefficient[up] * e.diameter[up]
            grown = (0.5 * size) ** 2 + (0.25 / 1.1774) ** 2 * size * away + (turbulence * away) ** 2
            wide, high = (np.sqrt(grown + extent[up] ** 2 / (2 * np.pi)) for extent in (e.width, e.height))
            h = np.array([over(nodes, j, high[k]) for k, j in enumerate(up)]).reshape(len(up), 48)
            spread = np.add.outer(wide**2, wide**2)
            g = np.outer(wide, wide) * np.sqrt(2 * np.pi / spread)
            both = g * np.exp(-0.5 * np.subtract.outer(e.y[up], e.y[up]) ** 2 / spread) * ((h * weight) @ h.T)
            one, two = np.sqrt(2 * np.pi) * wide * (h @ weight), np.diag(both)
            thrust = 0.5 * e.drag_coefficient[up] * e.area[up] * met[up] ** 2
            amplitude = (met[up] * one - np.sqrt((met[up] * one) ** 2 - 4 * two * thrust)) / (2 * two)
            share = amplitude * (met[up] - amplitude * two / one)
            if len(up):
                roots = np.roots([share @ both @ share, -speed * (share @ one), share @ one])
                share *= np.min(roots.real)
        if len(up):
            across = np.exp(-0.5 * ((e.y[i] - e.y[up]) / wide) ** 2)
            met[i] -= share @ (across * [over(e.z[i], j, high[k]) for k, j in enumerate(up)])
    return met


def lost(wakes, x, depth):
    """Momentum `int (U - U_s) U_s dA` lost at x, by quadrature over the plane."""
    y = np.linspace(-80.0, 80.0, 8001)
    nodes, weight = np.polynomial.legendre.leggauss(40)
    deficit = wakes.plane(x).deficit_on_grid(y, 0.5 * depth * (nodes - 1.0))
    return float(np.sum((wakes.speed - deficit) * deficit @ (0.5 * depth * weight)) * (y[1] - y[0]))


@pytest.mark.parametrize("away", [20.0, 50.0, 200.0, 1000.0])
def test_one_dropper_leaves_the_wake_of_schlichting(away):
    # over the whole depth and without turbulence a plane wake: u/U = 0.98 sqrt(C D/x), half-width 0.25 sqrt(C D x)
    wakes = solve_wakes(droppers([0.0], z=-5.0, high=10.0), 0.5, 10.0, turbulence=0.0)
    x = away * C * D
    half = 0.25 * np.sqrt(C * D * x)
    deficit = wakes.plane(x).deficit_on_grid(np.array([0.0, half]), np.array([-5.0]))[:, 0] / 0.5
    assert deficit[0] == pytest.approx(0.98 * np.sqrt(C * D / x), rel=0.2)
    assert deficit[1] / deficit[0] == pytest.approx(0.5, abs=0.02 if away > 100 else 0.1)  # far behind it


def test_a_cylinders_far_wake_is_as_wide_and_deep_as_measured():
    # Browne, Antonia and Shah (1987), ERCOFTAC case 3: half-width 12.3 mm at 420 d behind d = 2.67 mm, Re = 1190 (C_D
    # about 1); the defect is that of a Gaussian so wide with the momentum of the drag
    d, width = 2.67e-3, 12.3e-3
    wakes = solve_wakes(droppers([0.0], z=-0.5, high=1.0, diameter=d, drag=1.0), 6.7, 1.0, turbulence=0.0)
    nodes, weight = np.polynomial.legendre.leggauss(20)
    y = np.linspace(0.0, 0.05, 2001)
    defect = wakes.plane(420.0 * d).deficit_on_grid(y, 0.5 * (nodes - 1.0)) @ (0.5 * weight) / 6.7
    assert np.interp(-0.5 * defect[0], -defect, y) == pytest.approx(width, rel=0.15)
    assert defect[0] == pytest.approx(0.5 * d / (width * np.sqrt(np.pi / np.log(2.0))), rel=0.1)


def test_one_dropper_meets_the_whole_current_and_takes_its_drag_from_it():
    wakes = solve_wakes(droppers([0.0]), 0.4, 11.0)
    assert wakes.inflow[0] == 0.4
    assert wakes.drag[0] == pytest.approx(0.5 * C * D * 8.0 * 0.4**2)
    for x in (2.0, 20.0, 100.0):
        assert lost(wakes, x, 11.0) == pytest.approx(wakes.drag[0], rel=0.01)


@pytest.mark.parametrize("rows", [2, 3])
def test_momentum_lost_behind_rows_is_their_drag(rows):
    elements, _ = block(rows, apart=2.0, between=4.0, half=8)
    wakes = solve_wakes(elements, 0.3, 11.0)
    for x in (elements.x.max() + 3.0, elements.x.max() + 40.0):
        assert lost(wakes, x, 11.0) == pytest.approx(wakes.drag.sum(), rel=0.01)
    assert wakes.balance == pytest.approx(1.0, abs=1e-9)


def test_rows_behind_each_other_meet_less_and_less():
    elements, shape = block(4, apart=2.0, between=4.0)
    met = solve_wakes(elements, 0.3, 11.0).inflow.reshape(shape)[15] / 0.3
    assert met[0] == 1.0
    assert np.all(np.diff(met) < -0.02)
    assert met[-1] > 0.5
    across = solve_wakes(droppers(np.zeros(9), np.arange(9.0)), 0.3, 11.0)
    np.testing.assert_array_equal(across.inflow, 0.3)  # side by side


def test_a_dense_farm_is_slowed_as_much_as_was_measured():
    # Plew et al. (2005): 36 to 63 % within the farm
    elements, _ = block(20, half=12)
    wakes = solve_wakes(elements, 0.2, 11.0)
    assert 0.36 < 1.0 - wakes.inflow.mean() / 0.2 < 0.63
    assert wakes.balance < 0.9  # said: water would turn aside


def test_shares_do_not_depend_on_the_speed_or_on_where_the_farm_lies():
    elements, _ = block(3)
    one = solve_wakes(elements, 0.2, 11.0).inflow / 0.2
    moved = replace(elements, x=elements.x + 300.0, y=elements.y - 70.0)
    np.testing.assert_allclose(solve_wakes(moved, 1.3, 11.0).inflow / 1.3, one, rtol=1e-9)


@pytest.mark.parametrize(
    ("count", "long", "wide", "depth"),
    [(120, 60.0, 40.0, 12.0), (150, 400.0, 30.0, 20.0), (150, 60.0, 1000.0, 12.0)],
    ids=["compact", "long", "wide"],
)
def test_inflows_are_those_of_all_pairs_of_wakes(count, long, wide, depth):
    # long: wakes as wide as the farm and as high as the water; wide: most wakes out of each other's reach
    elements = scattered(count, long, wide, seed=count)
    met = solve_wakes(elements, 0.3, depth).inflow
    assert met.min() < 0.29
    np.testing.assert_allclose(met, inflows_by_all_pairs(elements, 0.3, depth), atol=3e-13, rtol=0.0)


@pytest.mark.check
def test_two_hundred_rows_slow_the_water_by_their_drag():
    elements, shape = block(200, apart=8.0, between=12.0, half=8)
    wakes = solve_wakes(elements, 0.3, 25.0)
    assert wakes.balance == pytest.approx(1.0, abs=1e-9)
    middle = wakes.inflow.reshape(shape)[8]
    assert np.all(np.diff(middle) < 0.0)
    assert len(wakes.inflow) > 3000
    assert 0.1 < middle[-1] < 0.27


ENDS = [(fixed(f"top-{i}", 4.0 * i, 0.0, -1.0), free(f"end-{i}", 4.0 * i, 0.0, -7.0)) for i in range(3)]
SCENE = system(
    [point for pair in ENDS for point in pair],
    [line_of(f"d{i}", f"top-{i}", f"end-{i}", 3, 6.0, type="sock") for i in range(3)],
    dt=0.05,
    duration=0.2,
    line_type=[{"name": "sock", "mass": 80.0, "diameter": 0.2, "EA": 1e5, "cdn": 1.3, "cdt": 0.0}],
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {"wakes": "porous"}},
    start={"kind": "points"},
    sea={"depth": 15.0, "current": {"speed": 0.4}},
)


@pytest.mark.check
def test_scenes_take_the_shares_by_the_direction_of_the_current(tmp_path, json_of):
    scene = dj.load_scene(SCENE)
    share = scene_wakes(scene).share.reshape(3, 3).mean(axis=1)
    assert share[0] > 0.95  # a leaning dropper is hardly in its own wake
    assert share[2] < share[1] < 0.9
    back = scene.with_values({"sea.current.direction": np.pi})
    np.testing.assert_allclose(scene_wakes(back).share.reshape(3, 3).mean(axis=1)[::-1], share, rtol=1e-6)
    beside = scene.with_values({"sea.current.direction": 0.5 * np.pi})
    np.testing.assert_array_equal(scene_wakes(beside).share, 1.0)
    model, _ = dj.build(scene)
    numbers = {"morison_drag": {"shelter": scene_wakes(scene).share.tolist()}}
    given, _ = dj.build({**SCENE, "effects": {**SCENE["effects"], **numbers}})
    assert jax.tree.structure(model) == jax.tree.structure(given)
    assert dj.Scene.from_dict(scene.to_dict()) == scene
    file, picture = tmp_path / "scene.toml", tmp_path / "flow.png"
    file.write_text(dj.as_toml(scene.to_dict()))
    found = json_of(["sea", str(file), "--json", "--flow", str(picture)])["wakes"]
    assert found["balance"] == pytest.approx(1.0, abs=0.01)
    assert found["drag_over_unsheltered"] < 0.9
    assert picture.stat().st_size > 10_000
    folder = tmp_path / "maps.v1"  # an existing folder whose name has a dot
    folder.mkdir()
    json_of(["sea", str(file), "--json", "--plot", str(folder)])
    assert (folder / "flow.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("drag", "current", "words"),
    [
        ({"shelter": 0.8}, {}, "cannot be combined with shelter"),
        ({}, {"amplitude": [1.0], "period": [100.0]}, "the current reverses here"),
        ({"wakes": "none", "turbulence": 0.1}, {}, "is only used with wakes 'porous'"),
        ({"turbulence": 2.0}, {}, "is out of range"),
        ({}, {"speed": 0.0}, "current is zero|no current"),
        ({}, None, "'porous' needs a current"),
    ],
)
def test_wakes_that_cannot_be_are_refused(drag, current, words):
    sea = {"depth": 15.0} if current is None else {"depth": 15.0, "current": {"speed": 0.4, **current}}
    effects = {**SCENE["effects"], "morison_drag": {"wakes": "porous", **drag}}
    with pytest.raises(dj.SceneError, match=words):
        dj.build({**SCENE, "effects": effects, "sea": sea})
