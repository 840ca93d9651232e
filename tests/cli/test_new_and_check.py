"""Own scenes from templates, and what a check shows before anything is compiled."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from dropper_jax import equilibrium, load_scene, simulate
from dropper_jax.cli import main
from dropper_jax.cli.new import KINDS
from dropper_jax.run.growth import end_force_vectors
from dropper_jax.run.resolution import suggest_step
from dropper_jax.scene import line_slices, whole_lines


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_runs_without_warnings_and_every_section_is_commented(tmp_path, capsys, kind):
    file = tmp_path / f"{kind}.toml"
    assert main(["new", kind, str(file)]) == 0
    capsys.readouterr()
    scene = load_scene(file)
    solution = simulate(scene.with_values({"run.duration": 20 * scene.run.dt}), step_check=False)
    assert (solution.status, solution.warnings) == ("ok", ())
    sections = re.findall(r"^(\[.*?\])(.*?)(?=^\[|\Z)", file.read_text(), flags=re.MULTILINE | re.DOTALL)
    commented = {header for header, body in sections if "#" in body}
    assert {header for header, body in sections if "=" in body} <= commented
    assert main(["new", kind, str(file)]) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["new", kind, str(file), "--force"]) == 0


#: What a user of the lab template uncomments, by what the mass of a link then is.
LAB = {"points": (), "halves": ("nodes = ",), "bars": ("centre_of_mass = ", "inertia = ")}


@pytest.mark.parametrize("kind", LAB)
def test_the_lab_template_says_where_the_mass_of_a_link_is(tmp_path, kind):
    file = tmp_path / "lab.toml"
    assert main(["new", "lab", str(file)]) == 0
    text = file.read_text()
    for key in LAB[kind]:
        assert f"\n# {key}" in text
        text = text.replace(f"\n# {key}", f"\n{key}")
    file.write_text(text)
    scene = load_scene(file).with_values({"start.release_force": [[0.0, 0.0, 0.0]]})
    pose = equilibrium(scene)
    forces = end_force_vectors(scene, pose.positions[None], pose.tension[None], line_slices(scene))["dropper"][0]
    weight = 0.033 * 9.81
    # of seven points at the far nodes one is on the second hook
    assert -forces[:, 2] == pytest.approx([3.0 * weight, 4.0 * weight] if kind == "points" else [3.5 * weight] * 2)
    assert scene.start.release_nodes == (1,)


def test_check_shows_masses_weights_and_the_suggested_step(tmp_path, capsys):
    file = tmp_path / "farm.toml"
    assert main(["new", "farm", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["file"] == str(file)
    assert main(["check", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    scene = load_scene(file)
    legs = {row["line"]: row for row in found["lines"]}
    # 60 m of rope of 0.8 kg/m and 40 mm in sea water
    wet = 60.0 * 9.81 * (0.8 - scene.sea.density * np.pi / 4 * 0.04**2)
    assert legs["west-leg"]["mass_kg"] == pytest.approx(48.0)
    assert legs["west-leg"]["wet_weight_n"] == pytest.approx(wet, rel=1e-3)
    assert sum(row["mass_kg"] for row in found["lines"]) == pytest.approx(
        sum(float(np.sum(line.spec.mass)) for line in whole_lines(scene))
    )
    # 13 floats of 0.13 m^3 that weigh 80 kg/m^3
    assert found["points"]["lift_n"] == pytest.approx(13 * 0.13 * (scene.sea.density - 80.0) * 9.81, rel=1e-6)
    # the shortest link is 1 m long, and swings in 2.01 s
    assert found["periods_s"]["swing"] == pytest.approx(2 * np.pi * np.sqrt(1.0 / 9.81))
    assert found["suggested_dt_s"] == 0.02
    assert found["compiled"]["solver"] == "network"
    assert main(["check", str(file)]) == 0
    assert "0.05 s in the scene, 0.02 s suggested" in capsys.readouterr().out


def test_explicit_schemes_get_a_step_below_their_stability_limit():
    scene = load_scene("paper-case-1").with_values({"run.integrator": "rk4"})
    line = scene.line
    omega = np.sqrt(np.max(4.0 * line.EA / (line.length * line.mass)))
    assert suggest_step(scene) < 2.0 / omega
    assert suggest_step(load_scene("paper-case-1")) == 0.04


def test_run_takes_the_suggested_step_and_prints_it(capsys):
    code = main(
        ["run", "dropper-release-a", "--dt", "auto", "--duration", "0.2", "--json", "--quiet", "--no-step-check"]
    )
    out, err = capsys.readouterr()
    assert code == 0
    assert err.splitlines()[0] == "time step: 0.0064 s (--dt auto)"
    assert json.loads(out)["dt"] == 0.0064


def test_run_shortens_the_suggested_step_until_its_check_passes(capsys):
    """The first step is off by 3 % of the travel; the exact motion is a circle at the start's inclination."""
    assert main(["run", "conical-pendulum", "--dt", "auto", "--json", "--quiet"]) == 0
    out, err = capsys.readouterr()
    first, second = (line for line in err.splitlines() if line.startswith("time step"))
    assert first == "time step: 0.02 s (--dt auto)"
    assert "too long; the run is repeated with" in second
    found = json.loads(out)
    assert found["dt"] < 0.02
    assert found["step_check"]["positions"] < 0.02
    assert not any(text.startswith("time step") for text in found["warnings"])


@pytest.mark.parametrize("scene", ["paper-case-3", "longline-rows"])
def test_check_takes_less_than_three_seconds_of_processor_time(scene):
    code = (
        f"import time; from dropper_jax.cli import main; assert main(['check', {scene!r}]) == 0; "
        "print(time.process_time())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout.splitlines()[-1]) < 3.0
