"""One vocabulary of outputs: `--plot DIR`, `--out FILE`, `--report DIR`; names in help texts are those there are."""

from __future__ import annotations

import argparse
import json
from importlib import import_module

import numpy as np
import pytest
from PIL import Image

from dropper_jax.base.errors import SceneError
from dropper_jax.cli import main, options
from dropper_jax.cli.outputs import out_file, picture, plot_folder
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.study.source_figures import FIGURES, draw_figure, figure_of, scene_of
from fitting.cli import figure, sensitivity, sweep
from fitting.sensitivity import quantities
from fitting.sweep.plan import QUANTITIES

SHORT = ["double-pendulum-chaotic", "--duration", "0.2", "--dt", "0.01", "--quiet"]


def parsed(command, *argv):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args(argv)


def test_names_in_help_texts_are_those_that_there_are():
    assert tuple(INTEGRATORS) == options.SCHEMES
    assert tuple(QUANTITIES) == sweep.KEPT
    assert tuple(quantities.SIGNALS) == sensitivity.SIGNALS
    assert tuple(quantities.STATISTICS) == sensitivity.STATISTICS


@pytest.mark.parametrize(
    ("module", "wanted"),
    [
        ("dropper_jax.cli.run", {"--plot", "--out", "--report"}),
        ("dropper_jax.cli.accuracy", {"--plot", "--out"}),
        ("dropper_jax.cli.cost", {"--plot", "--out"}),
        ("dropper_jax.cli.sea", {"--plot", "--out", "--flow", "--regimes"}),
        ("dropper_jax.cli.equilibrium", {"--plot", "--out"}),
        ("dropper_jax.cli.modes", {"--plot", "--out"}),
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
    assert set(FIGURES) == {f"paper-{n}" for n in range(6, 20)} | {f"thesis-8.{n}" for n in (20, 27, 30, 32)}
    for one in FIGURES.values():
        assert scene_of(one).run.duration == (one.duration or scene_of(one).run.duration)
    damping = {name: scene_of(FIGURES[f"thesis-{name}"]).effects["linear_damping"]["b_l"] for name in ("8.20", "8.27")}
    assert {name: float(np.max(value)) for name, value in damping.items()} == {"8.20": 0.01, "8.27": 0.002}
    with pytest.raises(SceneError, match=r"figure: 'paper-5' is not one of them.*paper-1?5"):
        figure_of("paper-5")


def test_figures_are_drawn(made, tmp_path, capsys):
    assert figure.run(parsed(figure, "paper-14", "--plot", str(tmp_path), "--json")) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(tmp_path / "paper-14.png")]
    scene = scene_of(FIGURES["paper-6"])
    links = scene.lines[0].links
    t = 0.1 * np.arange(1501)
    nodes = np.linspace([0.0, 0.0, -30.0], [30.0, 0.0, -4.0], links + 1)
    moved = nodes + np.sin(t)[:, None, None] * np.linspace(0, 1, links + 1)[:, None] * [1.0, 0.0, 1.0]
    solution = made(scene, moved, 1000.0 + 100.0 * np.sin(t)[:, None] * np.ones(links))
    sizes = {}
    for name in ("paper-6", "paper-7"):
        (file,) = draw_figure(FIGURES[name], solution, tmp_path / f"{name}.png")
        with Image.open(file) as image:
            sizes[name] = image.size
    assert sizes["paper-6"][1] > 1.5 * sizes["paper-7"][1]  # x, z and tension; y stays


def test_a_list_of_figures_needs_no_run(capsys):
    assert figure.run(parsed(figure)) == 0
    assert "thesis-8.27" in capsys.readouterr().out
