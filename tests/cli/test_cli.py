"""The command line: exit codes, one object on standard output, one line for every mistake."""

import json
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from dropper_jax import Scene, Solution, as_toml, load_scene, scene_names
from dropper_jax.backend.programs import PROGRAMS
from dropper_jax.cli import main
from dropper_jax.cli.modes import _text as modes_text
from dropper_jax.cli.printing import progress
from dropper_jax.run import simulate

SCENE = "dropper-release-a"
GOOD = as_toml(
    {
        "description": "two links",
        "run": {"dt": 0.01, "duration": 0.1},
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [0.1, 0.0, 0.0]}],
        "line": [{"name": "loop", "from": "a", "to": "b", "links": 3, "length": 0.1, "mass": 0.01}],
        "effects": {"weight": {}},
    }
)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["run", SCENE, "--dt", "0"], ["run.dt: 0.0", "> 0 s"]),
        (["run", SCENE, "--dt", "nan"], ["run.dt: nan is not finite", "> 0 s"]),
        (["run", SCENE, "--duration", "-3"], ["run.duration: -3.0", "> 0 s"]),
        (["run", SCENE, "--dtype", "half"], ["run.dtype: 'half'", "float64, float32"]),
        (["run", SCENE, "--gamma", "2"], ["run.gamma: 2.0", "0 to 1"]),
        (["run", SCENE, "--integrator", "ratle"], ["run.integrator: 'ratle'", "'rattle'"]),
        (["run", SCENE, "--solver", "dens"], ["run.solver: 'dens'", "'dense'"]),
        (["run", SCENE, "--integrator", "rk4"], ["run.integrator: 'rk4'"]),
        (["run", SCENE, "--dt", "auto", "--accuracy", "0"], ["run.accuracy: 0"]),
        (["equilibrium", SCENE, "--set", "line.0.mass=-0.01"], ["line.0.mass: -0.01", "> 0 kg"]),
        (["run", SCENE, "--set", "effects.linear_dampin.b_l=1"], ["did you mean 'effects.linear_damping.b_l'"]),
        (["run", SCENE, "--set", "effects.linear_damping.b_l=-1"], ["effects.linear_damping.b_l: -1", ">= 0 kg/s"]),
        (["run", SCENE, "--out", "no-such-folder/run.npz"], ["--out", "'no-such-folder' does not exist"]),
        (["run"], ["SCENE: missing"]),
    ],
)
def test_bad_argument_is_refused_in_one_line(refused, argv, words):
    line = refused(argv)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    "name", ["dropper-farm-3", "edulis-tide", "dropper-release-a-undamped", "tests/moordyn/current.txt"]
)
def test_a_scene_is_printed_as_toml_that_reads_as_the_same_scene(name, printed):
    source = str(Path(__file__).parents[2] / name) if "/" in name else name
    assert Scene.from_dict(tomllib.loads(printed(["scenes", source]).out)) == load_scene(source)


def test_a_scene_is_written_for_moordyn_with_changes_and_what_is_lost_is_listed(tmp_path, printed):
    file = tmp_path / "mooring.txt"
    changed = ["scenes", "paper-case-4", "--set", "line.chain.length=51.5"]
    out, err = printed([*changed, "--moordyn", str(file), "--dt", "0.001", "--json"])
    found = json.loads(out)
    assert found["not_represented"] == ["sea.current: the power profile is written as a table over height"]
    assert f"warning: {found['not_represented'][0]}" in err
    assert load_scene(file).lines[0].total == pytest.approx(51.5)
    assert "0.001 dtM" in file.read_text()
    assert tomllib.loads(printed(changed).out)["line"][0]["length"] == 51.5
    for wrong, words in (
        (["scenes", "--moordyn", str(file)], "--moordyn: needs a scene"),
        (["scenes", SCENE, "--moordyn", str(file)], "MoorDyn's lines are elastic"),
        ([*changed, "--moordyn", str(file), "--dt", "0"], "--dt: 0 is out of range"),
    ):
        assert words in printed(wrong, 2).err


def test_toml_of_awkward_values_reads_back():
    awkward = {"text": 'a "b" \\ ü\n', "odd key": [1, -2.5e-300, True], "long": ["x y"] * 60, "none": []}
    awkward["t"] = {"a.b": {}}
    assert tomllib.loads(as_toml({**awkward, "left out": None})) == awkward


def test_scenes_lists_every_packaged_scene_with_a_description(printed, json_of):
    found = json_of(["scenes", "--json"])
    assert [scene["name"] for scene in found["scenes"]] == list(scene_names())
    assert all(scene["description"] for scene in found["scenes"])
    shown, listed = printed(["scenes"]).out, []
    assert all(len(line) <= 120 for line in shown.splitlines())
    for name, rest in re.findall(r"^  (\S+)(.*)$", shown, re.MULTILINE):
        also = re.search(r"\(also (.*)\)$", rest)
        listed += [name, *(name + ending for ending in (also[1].split(", ") if also else ()))]
    assert sorted(listed) == sorted(scene_names())


KEYS = {
    *("schema", "status", "scene", "integrator", "solver", "dt", "duration", "steps", "failed_steps", "retried_steps"),
    *("max_residual", "max_closure_error_m", "energy_drift_j", "energy_scale_j", "compile_s", "run_s", "us_per_step"),
    *("realtime_factor", "final_positions_m", "tension_n"),
}


@pytest.mark.slow
def test_run_prints_one_object_and_writes_what_was_asked(tmp_path, json_of):
    out, gif, plots = tmp_path / "run.npz", tmp_path / "film.gif", tmp_path / "plots"
    argv = ["run", SCENE, "--json", "--duration", "0.1", "--dt", "0.01", "--set", "effects.linear_damping.b_l=0.01"]
    argv += ["--no-companion"]
    found = json_of([*argv, "--out", str(out), "--animate", str(gif), "--plot", str(plots)])
    assert found.keys() >= KEYS
    assert (found["schema"], found["status"], found["scene"]) == (1, "ok", SCENE)
    assert (found["steps"], found["dt"], found["duration"]) == (10, 0.01, 0.1)
    assert np.shape(found["final_positions_m"]) == (8, 3)
    assert found["final_positions_m"][-1] == [0.28, 0.0, 0.0]
    assert found["tension_n"].keys() == {"first", "last", "all"}
    assert found["tension_n"]["all"].keys() == {"min", "mean", "max", "final", "min_s", "max_s"}
    solution = Solution.load(out)
    assert solution.scene.effects["linear_damping"]["b_l"] == 0.01
    np.testing.assert_array_equal(solution.positions[-1], found["final_positions_m"])
    assert gif.stat().st_size > 0
    names = ("snapshot", "tension", "motion", "angles", "phase", "spectrum")
    assert {file.name for file in plots.iterdir()} == {f"{name}.png" for name in names}


ELASTIC = ["--set", "line.0.axial.law=elastic", "--set", "line.0.axial.EA=50.0", "--set", "line.0.axial.damping=0.05"]


@pytest.mark.check
@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        [],
        ["--integrator", "rattle", "--dt", "0.004"],
        ["--integrator", "theta_midpoint", "--gamma", "0.6", "--solver", "dense"],
        ["--integrator", "rk4", "--dt", "0.001", *ELASTIC],
        ["--dtype", "float32", "--set", "run.save_interval=0.05"],
    ],
)
def test_rerun_from_provenance_gives_the_same_numbers_to_the_bit(tmp_path, more):
    assert main(["run", SCENE, "--duration", "0.2", "--quiet", "--out", str(tmp_path / "run.npz"), *more]) == 0
    first = Solution.load(tmp_path / "run.npz")
    PROGRAMS.clear()  # the program too is made again
    jax.clear_caches()
    second = first.rerun()
    for name in ("t", "positions", "velocities", "tension", "kinetic", "potential", "work"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_run_for_people_ends_with_a_result_line(printed):
    out, err = printed(["run", SCENE, "--duration", "0.5", "--quiet"])
    assert out.splitlines()[-1].startswith("ok: 0.5 s simulated")
    assert err == ""


def test_equilibrium_gives_pose_angles_and_tensions(printed, json_of):
    found = json_of(["equilibrium", SCENE, "--json"])
    assert found.keys() >= {"schema", "status", "angles_rad", "positions_m", "tension_n", "residual"}
    assert np.shape(found["positions_m"]) == (8, 3)
    assert np.shape(found["angles_rad"]) == (7, 2)
    assert np.shape(found["tension_n"]) == (7,)
    assert printed(["equilibrium", SCENE]).out.splitlines()[-1].startswith("ok: ")


def failed_run(scene, **_) -> Solution:
    """What a run that blew up in its first step leaves."""
    rest = np.zeros((1, 8, 3))
    settings = {"integrator": "theta", "solver": "dense", "dtype": "float64", "dt": 0.01, "duration": 1.0, "steps": 100}
    numbers = dict.fromkeys(("t", "t_tension", "kinetic", "potential"), np.zeros(1))
    numbers |= {"positions": rest, "velocities": rest, "tension": np.full((1, 7), np.nan), "work": np.zeros((1, 0))}
    ended = {"status": "non_finite", "failed_steps": 1, "step_status": np.ones(1, np.int8), "max_residual": np.nan}
    bad = {"step": 1, "time_s": 0.01, "residual": float("nan"), "reason": "not finite"}
    return Solution(scene=scene, settings=settings, work_names=(), first_bad=bad, **numbers, **ended)


def test_failed_run_keeps_its_output_and_exits_with_3(tmp_path, printed, monkeypatch):
    monkeypatch.setattr(simulate, "simulate", failed_run)
    out = tmp_path / "run.npz"
    stdout, stderr = printed(["run", SCENE, "--json", "--quiet", "--out", str(out)], 3)
    found = json.loads(stdout)
    assert found["status"] == "non_finite"
    assert "step 1 at t = 0.01 s" in found["error"]
    assert found["max_residual"] is None
    assert stderr == f"error: {found['error']}\n"
    assert Solution.load(out).status == "non_finite"
    stdout, stderr = printed(["run", SCENE, "--quiet", "--report", str(tmp_path / "report")], 3)
    assert "failed: non_finite: step 1" in stdout
    assert "warning: no report: " in stderr


def interrupted(scene, **_):
    raise KeyboardInterrupt


def interrupted_while_jax_compares_keys(scene, **_):
    """JAX raises a ValueError from it."""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise ValueError("Exception raised while checking equality") from error


@pytest.mark.parametrize("end", [interrupted, interrupted_while_jax_compares_keys])
def test_interrupted_run_exits_with_130_and_reports_it(printed, monkeypatch, end):
    monkeypatch.setattr(simulate, "simulate", end)
    out, err = printed(["run", SCENE, "--json"], 130)
    assert json.loads(out) == {"schema": 1, "status": "interrupted", "error": "interrupted"}
    assert err == "error: interrupted\n"


def test_run_stopped_on_the_way_keeps_its_part_and_exits_with_130(tmp_path, json_of, monkeypatch):
    stopped = lambda scene, **_: replace(failed_run(scene), status="interrupted", first_bad=None)  # noqa: E731
    monkeypatch.setattr(simulate, "simulate", stopped)
    found = json_of(["run", SCENE, "--json", "--quiet", "--out", str(tmp_path / "run.npz")], 130)
    assert (found["status"], found["error"]) == ("interrupted", "interrupted: at t = 0 s of 1 s")
    assert Solution.load(tmp_path / "run.npz").status == "interrupted"


def test_progress_away_from_a_terminal_is_a_few_lines(capsys):
    show = progress()
    for i in range(1001):
        show(i / 1000, f"t = {i} s")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[0] for line in lines] == ["25", "50", "75", "100"]
    progress(quiet=True)(1.0, "done")


def test_installed_command_keeps_standard_output_clean():
    code = "import sys; from dropper_jax.cli import main; sys.exit(main(sys.argv[1:]))"
    argv = [sys.executable, "-c", code, "run", "string", "--duration", "0.05", "--json"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "ok"
    assert done.stdout.count("\n") == 1


def test_set_reads_numbers_lists_and_names(json_of):
    change = ["--set", "point.right.position=[0.3, 0.0, 0.0]", "--set", "run.solver=dense"]
    assert json_of(["equilibrium", SCENE, "--json", *change])["positions_m"][-1] == [0.3, 0.0, 0.0]
    assert load_scene(SCENE).points[1].position[0] == 0.28


def test_a_reader_that_stops_early_is_no_error() -> None:
    """`dropper scenes | head -0`: the pipe is closed before anything is written."""
    end, writing = os.pipe()
    os.close(end)
    try:
        command = [sys.executable, "-m", "dropper_jax", "scenes"]
        done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.check
def test_run_with_errors_prints_loads_with_what_they_are_off_by(tmp_path, printed, json_of):
    scene = tmp_path / "scene.toml"
    scene.write_text(GOOD, encoding="utf-8")
    shown = printed(["run", str(scene), "--errors", "--skip", "0.02", "--quiet"]).out
    assert "+-" in shown
    assert "errors of step and links together" in shown
    found = json_of(["run", str(scene), "--errors", "--quiet", "--json"])["load_errors"]
    assert set(found) == {"loads", "chaotic", "horizon_s", "not_resolved", "left_out"}
    assert set(found["loads"][0]["mean"]) == {"value", "step", "links", "chance", "error"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--errors", "--skip", "0.1"], "--skip: 0.1 is out of range"),
        (["--errors", "--skip", "-1"], "--skip: -1 is out of range"),
        (["--errors", "--skip", "nan"], "--skip: nan is out of range"),
        (["--errors", "--skip", "0.09"], "needed: at least 3"),
        (["--skip", "0.02"], "can only be left out together with --errors"),
        (["--errors", "--verify"], "companion: 'finer' (--verify) is not used with errors"),
        (["--verify", "--no-companion"], "not allowed with argument --verify"),
    ],
)
def test_options_that_leave_nothing_or_exclude_each_other_are_refused(options, said, tmp_path, refused):
    scene = tmp_path / "scene.toml"
    scene.write_text(GOOD, encoding="utf-8")
    assert said in refused(["run", str(scene), *options, "--quiet"])


@pytest.mark.parametrize("argv", [["run"], ["scenes"], [], ["run", "string", "--out"], ["run", "string", "--set"]])
def test_a_message_does_not_repeat_a_word_of_100_000_letters(argv, printed):
    word = "x" * 100_000
    out, err = printed([*argv, f"{word}=1" if "--set" in argv else word], 2)
    assert "xxx... (10000" in err
    assert len(err) < 1000
    assert len(out) < 1000


def test_a_damping_ratio_that_is_rounding_is_printed_as_zero():
    modes = SimpleNamespace(period=np.ones(2), shape=np.ones((2, 2, 3)), damping_ratio=np.array([-1e-17, 0.02]))
    rows = modes_text(SimpleNamespace(bodies=()), modes, {"number": [1, 2]}).splitlines()[1:]
    assert [row.split()[3] for row in rows] == ["0", "0.02"]
