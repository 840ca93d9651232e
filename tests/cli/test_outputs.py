"""One vocabulary of outputs: `--plot DIR`, `--out FILE`, `--report DIR`; names in help texts are those there are."""

from __future__ import annotations

import argparse
import json
from importlib import import_module

import numpy as np
import pytest
from PIL import Image

from dropper_jax import INTEGRATORS, SceneError
from dropper_jax.cli import main, options
from dropper_jax.cli.outputs import out_file, picture, plot_folder
from dropper_jax.run import quantities
from dropper_jax.study import source_figures
from dropper_jax.study.figure_table import Run, cases_of, figure_of, figures, scene_of
from dropper_jax.study.source_figures import PANELS, draw_figure
from fitting.cli import figure, sweep
from fitting.sweep import QUANTITIES

SHORT = ["double-pendulum-chaotic", "--duration", "0.2", "--dt", "0.01", "--quiet"]


def parsed(command, *argv):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args(argv)


def test_names_in_help_texts_are_those_that_there_are():
    assert [scheme.name for scheme in INTEGRATORS.values()] == list(INTEGRATORS) == list(options.SCHEMES)
    assert tuple(QUANTITIES) == sweep.DEFAULT_QUANTITIES
    assert tuple(quantities.SIGNALS) == options.SIGNALS
    assert tuple(quantities.STATISTICS) == options.STATISTICS


@pytest.mark.parametrize(
    ("module", "wanted"),
    [
        ("dropper_jax.cli.run", {"--plot", "--out", "--report"}),
        ("dropper_jax.cli.accuracy", {"--plot", "--out"}),
        ("dropper_jax.cli.cost", {"--plot", "--out"}),
        ("dropper_jax.cli.sea", {"--plot", "--out", "--flow", "--regimes"}),
        ("dropper_jax.cli.equilibrium", {"--plot", "--out"}),
        ("dropper_jax.cli.modes", {"--plot", "--out"}),
        ("dropper_jax.cli.offset", {"--plot", "--out"}),
        ("dropper_jax.cli.response", {"--plot", "--out"}),
        ("dropper_jax.cli.growth", {"--plot", "--out"}),
        ("dropper_jax.cli.stiffness", {"--out"}),
        ("dropper_jax.cli.design", {"--out"}),
        ("dropper_jax.cli.stability", {"--out"}),
        ("fitting.cli.season", {"--plot", "--out", "--report"}),
        ("fitting.cli.optimise", {"--plot", "--out", "--picture"}),
        ("fitting.cli.plan", {"--out"}),
        ("dropper_jax.cli.report", {"--report", "--out"}),
        ("fitting.cli.sensitivity", {"--plot", "--out", "--picture"}),
        ("fitting.cli.sweep", {"--plot", "--out"}),
        ("fitting.cli.fit", {"--plot", "--out", "--report"}),
    ],
)
def test_commands_take_the_same_words(module, wanted):
    parser = argparse.ArgumentParser()
    import_module(module).add_arguments(parser)
    assert wanted <= {word for action in parser._actions for word in action.option_strings}


def test_a_folder_or_one_file_takes_pictures(tmp_path):
    assert picture(plot_folder(str(tmp_path / "a")), "cost") == tmp_path / "a" / "cost.png"
    assert picture(plot_folder(str(tmp_path / "b.png")), "cost") == tmp_path / "b.png"
    with pytest.raises(SceneError, match=r"--plot: .*allowed: \.png, or a folder"):
        plot_folder(str(tmp_path / "c.gif"))
    with pytest.raises(SceneError, match=r"--out: .*allowed: \.json"):
        out_file(str(tmp_path / "c.csv"))


def test_a_run_leaves_its_report(tmp_path, capsys):
    assert main(["run", *SHORT, "--json", "--report", str(tmp_path / "told")]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"
    assert {"report.md", "report.json"} <= {path.name for path in (tmp_path / "told").iterdir()}


@pytest.mark.check
def test_a_sensitivity_leaves_picture_and_result(tmp_path, capsys):
    out, plots = tmp_path / "found.json", tmp_path / "plots"
    words = ["--of", "tension.max", "--to", "line.0.mass", "--json", "--out", str(out), "--plot", str(plots)]
    assert main(["sensitivity", *SHORT, *words]) == 0
    assert json.loads(out.read_text()) == json.loads(capsys.readouterr().out)
    assert [path.name for path in plots.iterdir()] == ["tornado.png"]


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
    assert figure.run(parsed(figure, "paper-14", "thesis-8.30", "--plot", str(tmp_path), "--json")) == 0
    names = [str(tmp_path / name) for name in ("paper-14.png", "thesis-8.30.png")]
    assert json.loads(capsys.readouterr().out)["files"] == names
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
    monkeypatch.setattr(source_figures.pictures, "marks", lambda link: drawn.append(link) or {"marker": "o"})
    (file,) = draw_figure(figure_of("thesis-C.2"), [], tmp_path / "steps.png")
    assert file.stat().st_size > 10_000
    assert drawn == [0, 1, 2, 3]  # links 4 to 7


def test_a_list_of_figures_needs_no_run(capsys):
    assert figure.run(parsed(figure)) == 0
    assert "thesis-8.27" in capsys.readouterr().out
