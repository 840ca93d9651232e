"""One vocabulary of outputs: `--plot DIR`, `--out FILE`, `--report DIR`; names in help texts are those there are."""

import argparse
import json
from importlib import import_module

import pytest

from dropper_jax import INTEGRATORS
from dropper_jax.cli import options
from dropper_jax.cli.outputs import picture, plot_folder
from dropper_jax.quantities import motion_signals, statistics
from fitting.cli import sweep
from fitting.sweep import QUANTITIES

SHORT = ["double-pendulum-chaotic", "--duration", "0.2", "--dt", "0.01", "--quiet"]


def test_names_in_help_texts_are_those_that_there_are():
    assert [scheme.name for scheme in INTEGRATORS.values()] == list(INTEGRATORS) == list(options.SCHEMES)
    assert tuple(QUANTITIES) == sweep.DEFAULT_QUANTITIES
    assert tuple(motion_signals.SIGNALS) == options.SIGNALS
    assert statistics.NAMES == options.STATISTICS


@pytest.mark.parametrize(
    ("modules", "wanted"),
    [
        ("accuracy cost equilibrium modes offset response growth", "--plot --out"),
        ("stiffness design stability", "--out"),
        ("run", "--plot --out --report"),
        ("sea", "--plot --out --flow --regimes"),
        ("report", "--report --vtk"),
        ("fitting.season", "--plot --report"),
        ("fitting.optimise fitting.sensitivity fitting.sweep", "--plot --out"),
        ("fitting.plan", "--out"),
        ("fitting.fit", "--plot --out --report"),
    ],
)
def test_commands_take_the_same_words(modules, wanted):
    for module in modules.split():
        package, _, name = module.rpartition(".")
        parser = argparse.ArgumentParser()
        import_module(f"{package or 'dropper_jax'}.cli.{name}").add_arguments(parser)
        assert {*wanted.split()} <= {word for action in parser._actions for word in action.option_strings}


def test_a_folder_or_one_file_takes_pictures(tmp_path):
    assert picture(plot_folder(str(tmp_path / "a"), "--plot"), "cost") == tmp_path / "a" / "cost.png"
    assert picture(plot_folder(str(tmp_path / "b.png"), "--plot"), "cost") == tmp_path / "b.png"


def test_a_run_leaves_its_report(tmp_path, json_of):
    assert json_of(["run", *SHORT, "--json", "--report", str(tmp_path / "report")])["status"] == "ok"
    assert {"report.md", "report.json"} <= {path.name for path in (tmp_path / "report").iterdir()}


@pytest.mark.check
def test_a_sensitivity_leaves_picture_and_result(tmp_path, json_of):
    out, plots = tmp_path / "found.json", tmp_path / "plots"
    words = ["--of", "tension.max", "--to", "line.0.mass", "--json", "--out", str(out), "--plot", str(plots)]
    found = json_of(["sensitivity", *SHORT, *words])
    assert json.loads(out.read_text()) == found
    assert [path.name for path in plots.iterdir()] == ["tornado.png"]
