"""The figures of the sources: their table, their scenes, and the curves of every kind."""

import numpy as np
import pytest
import source_figures
from figure_table import Run, cases_of, figure_of, figures, scene_of
from PIL import Image
from source_figures import PANELS, draw, draw_figure

from dropper_jax import SceneError


def test_figures_of_the_sources_are_named_and_their_scenes_are_there():
    head, thesis = ["2.5", "2.6", "3.3", "3.4", "3.5", "3.6", "5.3", "5.4"], [f"8.{n}" for n in range(2, 35)]
    tail = ["C.1", "C.2", "E.4", "E.6", "F.1.1", "F.1.2", "G.1", "G.2"]
    paper = [f"paper-{n}" for n in (3, *range(6, 20))]
    assert list(figures()) == paper + [f"thesis-{n}" for n in (*head, *thesis, *tail)]
    for one in figures().values():
        for case in cases_of(one):
            scene = scene_of(*case.key)
            assert scene.run.duration == (one.duration or scene.run.duration)
            assert one.span is None or one.span[1] <= scene.run.duration
            assert all(link <= sum(line.links for line in scene.lines) for link in one.links)
    pairs = {name: figure_of(f"thesis-{name}").pairs for name in ("8.14", "8.20", "8.21", "8.27")}
    assert pairs == {  # Tables 8.3 and 8.4, and what is chosen from them
        "8.14": ((0.01, 0.0), (0.01, 0.001), (0.01, 0.03)),
        "8.20": ((0.01, 0.001),),
        "8.21": ((0.001, 0.001), (0.002, 0.001), (0.001, 0.002)),
        "8.27": ((0.002, 0.001),),
    }
    damped = scene_of(*cases_of(figure_of("thesis-8.21"))[1].key).effects
    assert float(np.max(damped["linear_damping"]["b_l"])) == 0.002
    assert [case.label for case in cases_of(figure_of("thesis-8.14"))][2] == "b_l = 0.01, b_q = 0.03"
    with pytest.raises(SceneError, match=r"figure: 'paper-5' is unknown.*paper-1?5"):
        figure_of("paper-5")


def test_figures_are_drawn(made, tmp_path, capsys):
    assert draw(["paper-14", "thesis-8.30", "paper-14"], tmp_path, None)
    names = [str(tmp_path / name) for name in ("paper-14.png", "thesis-8.30.png")]
    assert capsys.readouterr().out.split() == names
    scene = scene_of(*cases_of(figure_of("paper-6"))[0].key)
    links = scene.lines[0].links
    t = 0.1 * np.arange(1501)
    nodes = np.linspace([0.0, 0.0, -30.0], [30.0, 0.0, -4.0], links + 1)
    moved = nodes + np.sin(t)[:, None, None] * np.linspace(0, 1, links + 1)[:, None] * [1.0, 0.0, 1.0]
    solution = made(scene, moved, 1000.0 + 100.0 * np.sin(t)[:, None] * np.ones(links))
    sizes = {}
    for name in ("paper-6", "paper-7"):
        (file,) = draw_figure(figure_of(name), [Run("", solution)], tmp_path / f"{name}.png")
        with Image.open(file) as image:
            sizes[name] = image.size
    assert sizes["paper-6"][1] > 1.5 * sizes["paper-7"][1]  # x, z and tension; y stays


def test_every_kind_of_curve_has_its_panels(made, tmp_path):
    """Of a chain whose links turn by known angles: panels, curves and their values."""
    t, links = 0.05 * np.arange(1001), 7
    angle = 1.0 + 0.1 * np.sin(2 * np.pi * 1.0 * t)[:, None] * np.arange(1, links + 1)
    steps = np.stack([np.cos(angle), 0.0 * angle, -np.sin(angle)], axis=-1)
    nodes = np.concatenate([np.zeros((len(t), 1, 3)), np.cumsum(0.1 * steps, axis=1)], axis=1)
    run = Run("b_l = 0.01", made("dropper-release-a", nodes, np.ones((len(t), links)), dt=0.05))
    measured = t, angle
    curves, _ = PANELS["curve"](figure_of("thesis-8.2"), [run, run], measured)
    (name, x, y), (_, time, simulated), _ = curves[0].curves
    assert name == "measured"
    assert (x[0], x[-1]) == pytest.approx((0.0, 12.0))
    np.testing.assert_allclose(simulated, np.interp(time, x, y), atol=1e-9)
    spectra, _ = PANELS["spectrum"](figure_of("thesis-8.3"), [run], None)
    _, frequency, amplitude = spectra[0].curves[0]
    assert frequency[np.argmax(amplitude)] == pytest.approx(1.0, abs=0.05)
    assert amplitude.max() == pytest.approx(0.2, rel=0.02)  # link 2
    phase, _ = PANELS["phase"](figure_of("thesis-F.1.1"), [run], None)
    assert [panel.title for panel in phase] == [f"b_l = 0.01; link {n}" for n in range(1, 8)]
    for name in ("thesis-2.5", "thesis-3.3", "thesis-3.5", "thesis-8.2", "thesis-8.3", "thesis-8.20", "thesis-F.1.1"):
        (file,) = draw_figure(figure_of(name), [run], tmp_path / f"{name}.png", measured)
        assert file.stat().st_size > 10_000


def test_steps_of_some_links_are_drawn_by_their_numbers(tmp_path, monkeypatch):
    rows = np.geomspace(1e-2, 1e-6, 12).reshape(4, 3)
    found = {"label": "energy_momentum", "dts": [0.04, 0.02, 0.01, 0.005], "status": ["ok"] * 4}
    found |= {"polar": np.c_[rows, rows, rows[:, :1]], "azimuth": None}
    drawn = []
    monkeypatch.setattr(source_figures, "_compared_steps", lambda *_: [found])
    monkeypatch.setattr(source_figures.accuracy_pictures, "marks", lambda link: drawn.append(link) or {"marker": "o"})
    (file,) = draw_figure(figure_of("thesis-C.2"), [], tmp_path / "steps.png")
    assert file.stat().st_size > 10_000
    assert drawn == [0, 1, 2, 3]  # links 4 to 7
