"""Effects of installed packages reach the command line by their entry points."""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax import Effect, component, register
from dropper_jax.cli import find_commands, main
from dropper_jax.effects import EFFECTS

EFFECT = """
from typing import ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component, parameter
from dropper_jax.effects import Effect


@component
class Push(Effect):
    name: ClassVar[str] = "push"
    constant: ClassVar[bool] = True
    x: jax.Array = parameter("force on every node along x", unit="N")

    def force(self, k):
        return jnp.zeros_like(k.r).at[:, 0].set(self.x)
"""
SCENE = rods([0.0], 1.0, 2.0, {"weight": {"gravity": 10.0}, "push": {"x": 20.0}})
SCENE["run"] = {"dt": 0.01, "duration": 0.1}


def installed(folder: Path, value: str) -> None:
    """A package `pushing` in the folder, as an installer leaves it."""
    (folder / "pushing.py").write_text(EFFECT)
    info = folder / "pushing-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pushing\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[dropper.effects]\npush = {value}\n")
    (folder / "scene.toml").write_text(dj.as_toml(SCENE))


def equilibrium(folder: Path) -> subprocess.CompletedProcess[str]:
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, str(folder)])}
    call = [sys.executable, "-m", "dropper_jax", "equilibrium", "scene.toml", "--json"]
    return subprocess.run(call, capture_output=True, text=True, env=environment, cwd=folder, check=False)


def test_an_installed_effect_acts_in_a_scene_of_the_command_line(tmp_path):
    installed(tmp_path, "pushing:Push")
    done = equilibrium(tmp_path)
    assert done.returncode == 0, done.stderr
    tension = json.loads(done.stdout)["tension_n"]
    assert tension[0] == pytest.approx(2.0**0.5 * 20.0)  # it hangs at 45 degrees between push and weight


def test_one_that_cannot_be_loaded_is_named(tmp_path):
    installed(tmp_path, "pushing:Pull")
    done = equilibrium(tmp_path)
    assert done.returncode == 2
    assert "effects.push: 'pushing:Pull' cannot be used" in done.stderr


def own_file(folder: Path, text: str = EFFECT) -> Path:
    """A file `push.py` with an effect, and a scene that uses it."""
    (folder / "scene.toml").write_text(dj.as_toml(SCENE))
    file = folder / "push.py"
    file.write_text(text)
    return file


def test_an_effect_of_a_file_acts_in_a_scene_and_in_its_saved_run(tmp_path, json_of, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = own_file(tmp_path)
    try:
        tension = json_of(["equilibrium", "scene.toml", "--effects", str(file), "--json"])["tension_n"]
        assert tension[0] == pytest.approx(2.0**0.5 * 20.0)
        assert main(["run", "scene.toml", "--effects", str(file), "--out", "a.npz", "--quiet", "--no-companion"]) == 0
        del EFFECTS["push"]  # as in another process
        assert main(["view", "a.npz", "--out", "a.html"]) == 2
        assert main(["view", "a.npz", "--out", "a.html", "--effects", str(file)]) == 0
    finally:
        EFFECTS.pop("push", None)


def test_the_error_of_an_unknown_effect_names_the_option_and_the_entry_point(tmp_path, printed):
    own_file(tmp_path)
    output = printed(["check", str(tmp_path / "scene.toml")], 2).err
    assert "effects.push: unknown key; " in output
    assert "--effects FILE.py, or an entry point of the group dropper.effects" in output


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.py", "", "is not a Python file; allowed: an existing FILE.py"),
        ("scene.toml", "", "is not a Python file; allowed: an existing FILE.py"),
        ("push.py", "x = 1", "has no effect; needed: a class of dropper_jax.Effect with `name` and @component"),
        ("push.py", "x = ", "cannot be used: SyntaxError"),
        ("push.py", "import not_there", "cannot be used: ModuleNotFoundError"),
        ("push.py", EFFECT.replace("@component\n", ""), "cannot be used: ValueError: Push: is not a component"),
        (
            "push.py",
            EFFECT.replace('"push"', '"weight"'),
            "Push: the name 'weight' is already used by dropper_jax.effects.weight.",
        ),
    ],
)
def test_a_file_without_a_usable_effect_is_refused_by_name(tmp_path, printed, name, text, words):
    file = own_file(tmp_path, text).with_name(name)
    known = dict(EFFECTS)
    (line,) = printed(["check", str(tmp_path / "scene.toml"), "--effects", str(file)], 2).err.splitlines()
    assert line.startswith("error: --effects: ")
    assert words in line
    assert known == EFFECTS


def test_an_effect_has_a_name_and_is_registered_once():
    with pytest.raises(ValueError, match="has no `name`"):
        register(type("Nameless", (Effect,), {}))
    assert register(EFFECTS["weight"]) is EFFECTS["weight"]


def test_every_command_that_reads_scenes_or_runs_takes_effects_of_a_file():
    """Others read no scene of the user, or are those of the sources."""
    without = {"demo", "doctor", "library", "new", "stability", "track"}
    for entry in find_commands():
        parser = argparse.ArgumentParser()
        entry.load().add_arguments(parser)
        options = {option for action in parser._actions for option in action.option_strings}
        assert ("--effects" in options) == (entry.name not in without), entry.name


@pytest.mark.parametrize(
    ("methods", "words"),
    [
        ({"force": lambda k: jnp.zeros(3)}, "force: returns shape (3,) of float64; needed: shape (1, 3)"),
        ({"force": lambda k: jnp.zeros((1, 1))}, "force: returns shape (1, 1)"),
        ({"force": lambda k: k.r.astype("float32")}, "force: returns shape (1, 3) of float32; needed: shape (1, 3)"),
        (
            {"force": lambda k: 0.0 * k.r, "potential": lambda k: k.r[:, 2]},
            "potential: returns shape (1,) of float64; needed: shape ()",
        ),
        ({"inertia": lambda k, a: a, "kinetic": lambda k: jnp.sum(k.v**2, axis=1)}, "kinetic: returns shape (1,)"),
        ({"point_mass": lambda model: jnp.ones(3)}, "point_mass: returns shape (3,)"),
        ({"begin": lambda model: jnp.zeros(1), "advance": lambda *step: jnp.zeros(2)}, "advance: returns shape (2,)"),
    ],
)
def test_an_effect_that_returns_another_shape_than_its_slot_is_refused_by_name(methods, words, refusal):
    own = {name: staticmethod(method) for name, method in methods.items()}
    if "begin" in own:
        own["entered"] = lambda self, state: self
    register(component(type("Strange", (Effect,), {"name": "strange", **own})))
    try:
        assert f"effects.strange.{words}" in refusal(dj.build, {**SCENE, "effects": {"weight": {}, "strange": {}}})
    finally:
        del EFFECTS["strange"]
