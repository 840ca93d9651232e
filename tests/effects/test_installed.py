"""Effects of installed packages reach the command line by their entry points."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

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
SCENE = """
[run]
dt = 0.01
duration = 0.1

[[point]]
name = "top"
position = [0.0, 0.0, 0.0]

[[point]]
name = "end"
kind = "free"
position = [0.0, 0.0, -1.0]

[[line]]
name = "rod"
from = "top"
to = "end"
links = 1
length = 1.0
mass = 2.0

[effects.weight]
gravity = 10.0

[effects.push]
x = 20.0
"""


def installed(folder: Path, value: str) -> None:
    """A package `pushing` in the folder, as an installer leaves it."""
    (folder / "pushing.py").write_text(EFFECT)
    info = folder / "pushing-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pushing\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[dropper.effects]\npush = {value}\n")
    (folder / "scene.toml").write_text(SCENE)


def dropper(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, str(folder)])}
    call = [sys.executable, "-m", "dropper_jax", *arguments]
    return subprocess.run(call, capture_output=True, text=True, env=environment, cwd=folder, check=False)


def test_an_installed_effect_acts_in_a_scene_of_the_command_line(tmp_path):
    installed(tmp_path, "pushing:Push")
    done = dropper(tmp_path, "equilibrium", "scene.toml", "--json")
    assert done.returncode == 0, done.stderr
    tension = json.loads(done.stdout)["tension_n"]
    assert tension[0] == pytest.approx(2.0**0.5 * 20.0)  # it hangs at 45 degrees between push and weight


def test_one_that_cannot_be_loaded_is_named(tmp_path):
    installed(tmp_path, "pushing:Pull")
    done = dropper(tmp_path, "equilibrium", "scene.toml")
    assert done.returncode == 2
    assert "effects.push: 'pushing:Pull' cannot be used" in done.stderr
