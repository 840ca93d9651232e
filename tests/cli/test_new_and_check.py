"""Own scenes from templates, and what a check shows before anything is compiled."""

import json
import re

import numpy as np
import pytest

from dropper_jax import as_toml, equilibrium, load_scene, simulate
from dropper_jax.cli import main
from dropper_jax.cli.new import KINDS
from dropper_jax.load.periods import suggest_step
from dropper_jax.quantities.end_forces import end_force_vectors
from dropper_jax.scene import line_slices, whole_lines

#: Templates whose programs take longest to compile.
LARGE = ("farm", "longline", "mussels")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.check) if kind in LARGE else kind for kind in KINDS]
)
def test_a_template_runs_without_warnings_and_every_section_is_commented(tmp_path, capsys, printed, kind):
    file = tmp_path / f"{kind}.toml"
    assert main(["new", kind, str(file)]) == 0
    capsys.readouterr()
    scene = load_scene(file)
    solution = simulate(scene.with_values({"run.duration": 20 * scene.run.interval}))
    assert (solution.status, solution.warnings) == ("ok", ())
    sections = re.findall(r"^(\[.*?\])(.*?)(?=^\[|\Z)", file.read_text(), flags=re.MULTILINE | re.DOTALL)
    commented = {header for header, body in sections if "#" in body}
    assert {header for header, body in sections if "=" in body} <= commented
    assert "exists" in printed(["new", kind, str(file)], 2).err
    assert main(["new", kind, str(file), "--force"]) == 0


#: What a user of the lab template uncomments, by what the mass of a link then is.
LAB = {"points": (), "halves": ("nodes = ",), "bars": ("centre_of_mass = ", "inertia = ")}


@pytest.mark.parametrize("kind", LAB)
def test_the_lab_template_states_where_the_mass_of_a_link_is(tmp_path, kind):
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


def test_check_shows_masses_weights_and_the_suggested_step(tmp_path, printed, json_of):
    file = tmp_path / "farm.toml"
    assert json_of(["new", "farm", str(file), "--json"])["file"] == str(file)
    found = json_of(["check", str(file), "--json"])
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
    assert (found["suggested_dt_s"], found["compiled"]["solver"]) == (0.02, "network")
    text = printed(["check", str(file)]).out
    assert "follow an accuracy of 0.01; equal steps, where a study needs them, of 0.02 s" in text


def test_explicit_schemes_get_a_step_below_their_stability_limit():
    scene = load_scene("paper-case-1").with_values({"run.integrator": "rk4"})
    omega = np.sqrt(np.max(4.0 * scene.line.EA / (scene.line.length * scene.line.mass)))
    assert suggest_step(scene) < 2.0 / omega
    assert suggest_step(load_scene("paper-case-1")) == 0.04


def test_an_automatic_step_follows_an_accuracy(printed):
    out, err = printed(["run", "dropper-release-a", "--dt", "auto", "--duration", "0.2", "--json", "--quiet"])
    assert err.splitlines()[0] == "--dt auto: the steps follow an accuracy of 0.01 (--accuracy)"
    assert json.loads(out)["accuracy"] == 0.01


@pytest.mark.parametrize("wet", [False, True])
def test_masses_of_a_scene_in_air_have_no_lift_and_its_lines_no_weight_in_water(tmp_path, printed, wet):
    bob = {"name": "bob", "kind": "free", "position": [0.0, 0.0, -2.0], "mass": 2.0}
    scene = {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [{"name": "top", "position": [0.0, 0.0, 0.0]}, bob],
        "line": [{"name": "rope", "from": "top", "to": "bob", "links": 2, "length": 1.0, "mass": 0.1}],
        "effects": {"weight": {}},
    }
    if wet:
        scene["sea"] = {"depth": 10.0}
    file = tmp_path / "scene.toml"
    file.write_text(as_toml(scene), encoding="utf-8")
    shown = printed(["check", str(file)]).out
    assert "2 kg" in shown
    assert ("submerged" in shown) == wet
    assert ("in water" in shown) == wet
