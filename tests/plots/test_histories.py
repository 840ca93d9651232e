"""Tension and motion over time: what is drawn is what moves, and a long record keeps its extremes."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import dropper_jax as dj
from dropper_jax import load_scene, plots
from dropper_jax.cli.outputs import draw
from dropper_jax.plots import figures, spectra, tension, time_panels
from dropper_jax.plots.movement import chosen_links
from dropper_jax.plots.run import readable
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.wave_theories import regimes
from dropper_jax.quantities.end_links import Motion, loaded_fixed_points, point_loads


def test_envelope_of_a_long_record_holds_every_sample():
    t = np.linspace(0.0, 3600.0, 50001)
    values = np.sin(t) + 5.0 * np.exp(-((t - 1234.5) ** 2))  # one short peak
    at, mean, least, largest = time_panels.reduce_samples(t, values, values, values)
    assert len(at) == time_panels.INTERVALS
    assert (largest.max(), least.min()) == (values.max(), values.min())
    assert np.all((least <= mean) & (mean <= largest))
    assert mean.mean() == pytest.approx(values.mean(), abs=1e-3)


def test_mean_of_a_long_record_has_no_beat_with_its_waves():
    t = np.linspace(0.0, 3600.0, 36001)
    values = 2.0 + np.sin(2 * np.pi * t / 8.33)
    at, mean, _, _ = time_panels.reduce_samples(t, values, values, values)
    assert np.ptp(mean) > 0.2  # stretches of 11 s beat with waves of 8.33 s
    assert np.ptp(time_panels._without_beat(at, mean, 8.33)[20:-20]) < 0.05
    slow = np.linspace(0.0, 1.0, 320)
    np.testing.assert_array_equal(time_panels._without_beat(at, slow, 100.0), slow)


def test_ratio_of_heave_to_surface_is_that_of_their_amplitudes():
    t = np.linspace(0.0, 200.0, 4001)
    eta = sum(np.cos(w * t + w**2) for w in (0.5, 0.7, 0.9))
    both = [
        time_panels.Panel("z from its start [m]", [time_panels.Curve("buoy", t, 0.4 * eta)]),
        time_panels.Panel("surface [m]", [time_panels.Curve("", t, eta)]),
    ]
    (ratio,) = spectra._heave_ratio([spectra._spectra(panel) for panel in both])
    frequency = ratio.curves[0].t
    assert 0.05 < frequency.min() < 0.5 / (2 * np.pi) < 0.9 / (2 * np.pi) < frequency.max() < 0.2
    np.testing.assert_allclose(ratio.curves[0].values, 0.4, rtol=1e-9)
    assert spectra._heave_ratio([spectra._spectra(both[0])]) == []


def test_a_zoom_has_the_scale_of_its_envelope_and_a_constant_keeps_it(tmp_path, monkeypatch):
    t = np.linspace(0.0, 4000.0, 40001)
    wave = np.sin(2 * np.pi * t / 8.0) * np.exp(-(((t - 3000.0) / 500.0) ** 2))
    late = np.where(t < 3500.0, 0.0, 0.5)  # constant in the zoom
    both = [
        time_panels.Panel("force [N]", [time_panels.Curve("", t, wave)]),
        time_panels.Panel("tension [N]", [time_panels.Curve("", t, late)]),
        time_panels.Panel("z [m]", [time_panels.Curve("", t, 0.5 * wave)]),
    ]
    drawn = []
    monkeypatch.setattr(figures, "finish", lambda figure, *_: drawn.append(figure))
    time_panels.history(SimpleNamespace(t=t), tmp_path / "history.png", "histories", both)
    limits = np.array([axes.get_ylim() for axes in drawn[0].axes]).reshape(3, 2, 2)
    np.testing.assert_array_equal(limits[:, 0], limits[:, 1])
    np.testing.assert_array_equal(limits[0, 0], limits[1, 0])
    assert 2.0 < np.ptp(limits[0, 0]) < 2.5
    assert 1.0 < np.ptp(limits[2, 0]) < 1.25


def test_turns_count_waves_and_not_rounding():
    t = np.linspace(0.0, 100.0, 20001)
    assert time_panels.turns(np.sin(2 * np.pi * t / 8.0)) == 25  # two in each of 12.5 waves
    assert time_panels.turns(1.0 + 1e-9 * np.sin(t)) == 0
    assert time_panels.cycle(t, 3.0 + np.sin(2 * np.pi * t / 8.0)) == pytest.approx(8.0, abs=0.01)


def test_zoom_holds_the_largest_value_and_a_few_cycles():
    t = np.linspace(0.0, 3600.0, 36001)
    values = np.sin(2 * np.pi * t / 8.0) * (1.0 + np.exp(-(((t - 2000.0) / 20) ** 2)))
    start, end = time_panels.zoom_of([time_panels.Panel("x [m]", [time_panels.Curve("", t, values)])])
    assert start < t[np.argmax(values)] < end
    assert end - start == pytest.approx(time_panels.CYCLES * 8.0, rel=0.02)


@pytest.mark.parametrize(("forces", "unit"), [([1.0, 4999.0], "N"), ([1.0, -5000.0], "kN"), ([np.nan], "N")])
def test_one_unit_for_a_figure(forces, unit):
    assert force_unit(np.array(forces))[0] == unit


def test_links_at_rest_have_no_panel(longline):
    solution = longline()
    solution.positions[:, :5] = solution.positions[0, :5]  # the first line's nodes stay
    run = readable(solution)
    assert chosen_links(run, 12).min() >= 4
    assert len(chosen_links(run, 3)) <= 3


def test_loads_of_a_point_are_the_pull_of_its_lines_along_them():
    kind = {"links": 1, "length": 5.0, "mass": 1.0, "axial": {"law": "rope", "EA": 1e4}}
    scene = load_scene(
        {
            "run": {"dt": 0.1, "duration": 1.0},
            "point": [
                {"name": "a", "position": [0.0, 0.0, 0.0]},
                {"name": "b", "kind": "free", "position": [3.0, 0.0, 4.0]},
            ],
            "line": [{"name": "l", "from": "a", "to": "b", **kind}, {"name": "m", "from": "b", "to": "a", **kind}],
            "start": {"kind": "points"},
        }
    )
    t = np.array([0.0, 1.0])
    r = np.array([[0.0, 0, 0], [3, 0, 4], [3, 0, 4], [0, 0, 0]])
    positions = np.stack([r, r + [[0, 0, 0], [2.0, 0, 0], [2, 0, 0], [0, 0, 0]]])
    motion = Motion(scene, t, positions, np.array([0.0, 0.5]), np.array([[10.0, 20.0], [1.0, 2.0]]))
    load = point_loads(motion)["a"]
    np.testing.assert_allclose(load[0], 30.0 * np.array([0.6, 0.0, 0.8]))
    np.testing.assert_allclose(load[1], 3.0 * np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0))  # half way: (4, 0, 4)
    assert loaded_fixed_points(scene) == ["a"]


@pytest.mark.parametrize("name", ["tension_history", "motion_history"])
@pytest.mark.parametrize("samples", [2, 41])
def test_histories_of_a_system_are_pictures(longline, tmp_path, name, samples):
    with Image.open(getattr(plots, name)(longline(1.0, samples=samples), tmp_path / "history.png")) as image:
        assert len(np.unique(np.asarray(image.convert("L")))) > 10


def test_a_run_in_which_nothing_moves_has_no_pictures_of_motion(longline, tmp_path, capsys):
    solution = longline()
    for values in (solution.positions, solution.velocities, solution.tension):
        values[:] = values[0]
    names = {path.stem for path in draw(solution, tmp_path / "plots")}
    assert names.isdisjoint({"motion", "phase", "spectrum", "response"})
    assert {"snapshot", "tension", "surface"} <= names
    assert "angles" not in names  # those of many lines in one picture show nothing
    assert "no motion" in capsys.readouterr().err


def test_a_snapshot_shows_the_peak_and_unloaded_anchors_have_no_curve(longline):
    solution = longline()
    solution.tension[23, 3] = 5000.0
    run = readable(solution)
    assert run.peak == 23
    names = loaded_fixed_points(solution.scene)
    lazy = next(line for line in solution.scene.lines if names[0] in (line.start, line.end))
    others = [line.name for line in solution.scene.lines if line is not lazy and names[0] in (line.start, line.end)]
    assert not others
    solution.tension[:, next(w.links for w in solution.lines if w.name == lazy.name)] = 0.0
    run = readable(solution)
    panel = tension.fixed_points_panel(run, tension.scale_tensions(run))
    assert names[0] not in [curve.name for curve in panel.curves]
    assert "1 below 1% of the maximum" in panel.title


def test_lines_of_a_drifting_body_have_no_panel_of_fixed_points(made, tmp_path):
    """Two ropes of two links below a body that nothing holds."""
    rope = {"from": "base", "links": 2, "length": 3.0, "mass": 1.0, "axial": {"law": "rope", "EA": 1e5}}
    body = {"name": "spar", "position": [0.0, 0.0, -2.0], "mass": 1000.0, "centre_of_mass": [0.0, 0.0, 1.0]}
    scene = {
        "run": {"dt": 0.1, "duration": 1.0},
        "point": [{"name": name, "kind": "free", "position": [x, 0.0, -8.0]} for name, x in (("a", 0.0), ("b", 1.0))],
        "line": [{"name": f"rope-{name}", "to": name, **rope} for name in ("a", "b")],
        "body": [{**body, "inertia": [1500.0, 1500.0, 80.0], "attachments": {"base": [0.0, 0.0, 0.0]}}],
        "effects": {"weight": {}},
        "start": {"kind": "points"},
    }
    nodes = np.tile(np.array([[0.0, 0, -2], [0, 0, -5], [0, 0, -8]] * 2), (12, 1, 1))
    tension = 5.0 + np.arange(12.0)[:, None] * np.ones(4)
    assert plots.tension_history(made(scene, nodes, tension), tmp_path / "tension.png").exists()


def test_spectra_of_x_and_y_that_coincide_are_both_visible(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "finish", lambda figure, *_: drawn.append(figure))
    plots.amplitude_spectrum(dj.simulate("conical-pendulum", dt=0.02, duration=20.0), tmp_path / "spectrum.png")
    assert [line.get_linestyle() for line in drawn[0].axes[0].get_lines()] == ["-", "--"]


def test_of_two_curves_that_coincide_the_later_is_dashed():
    t = np.linspace(0.0, 10.0, 50)
    waves = {"a": np.sin(t), "b": np.cos(t), "c": np.sin(t)}
    curves = [time_panels.Curve(name, t, values) for name, values in waves.items()]
    assert [time_panels.line_style(curves, i) for i in range(3)] == ["-", "-", time_panels.DASHES]
    axes = figures.new_figure(4, 3).subplots()
    time_panels.draw_panel(axes, time_panels.Panel("x [m]", curves))
    assert [line.get_linestyle() for line in axes.get_lines()] == ["-", "-", "--"]


@pytest.mark.parametrize(("period", "depth"), [(4.0, 200.0), (60.0, 0.5)])
def test_any_wave_is_on_the_map_of_theories(period, depth, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "save", lambda figure, _: drawn.append(figure))
    regimes([("wave", 0.1, period, depth)], 9.81, tmp_path / "map.png")
    low, high = drawn[0].axes[0].get_xlim()
    assert low < depth / (9.81 * period**2) < high


@pytest.mark.parametrize(("waves", "columns"), [(195, 1), (260, 2)])
def test_a_record_of_at_most_200_waves_is_drawn_wave_by_wave(waves, columns, tmp_path, monkeypatch):
    t = np.linspace(0.0, 60.0, 6001)
    panel = time_panels.Panel("tension [N]", [time_panels.Curve("", t, np.sin(2 * np.pi * waves * t / 60.0))])
    drawn = []
    monkeypatch.setattr(figures, "finish", lambda figure, run, what, path: drawn.append(figure) or path)
    run = SimpleNamespace(t=t, name="sine", status="ok", settings={"integrator": "energy_momentum", "dt": 0.01})
    time_panels.history(run, tmp_path / "tension.png", "tension", [panel])
    assert len(drawn[0].axes) == columns


@pytest.mark.parametrize("missing", [2e-3, 5e-4, 2e-6])
def test_a_spectrum_leaves_out_a_last_step_that_is_shorter_by_however_little(missing):
    t = 0.01 * np.arange(401)
    full, amplitudes = spectra.uniform_spectrum(t[:-1], np.sin(20.0 * t[:-1]))
    t[-1] -= 0.01 * missing
    frequency, found = spectra.uniform_spectrum(t, np.sin(20.0 * t))
    np.testing.assert_array_equal(frequency, full)
    np.testing.assert_array_equal(found, amplitudes)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_the_response_of_a_run_that_ended_at_once_is_drawn(longline, tmp_path, samples):
    run = longline(samples=3)
    run.positions[samples:] = np.nan
    with Image.open(plots.response(run, tmp_path / "response.png")) as image:
        assert image.format == "PNG"
