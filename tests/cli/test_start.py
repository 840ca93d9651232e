"""What starts without JAX, what the package offers at its root, and that float64 comes first all the same."""

import ast
import json
import os
import shlex
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import EntryPoint, version
from pathlib import Path

import pytest

import dropper_jax
from dropper_jax import cli, scene_names
from dropper_jax.cli import main
from dropper_jax.load.packaged import is_packaged
from dropper_jax.scene import run
from dropper_jax.solvers import SOLVERS

ROOT = Path(dropper_jax.__file__).parents[1]
#: Runs the command line and ends with one line on standard error: the heavy packages that were imported.
PROBE = """
import sys
from dropper_jax.cli import main
try:
    code = main(sys.argv[1:])
except SystemExit as end:
    code = end.code
print(*(name for name in ("jax", "scipy", "matplotlib", "xarray", "cv2") if name in sys.modules), file=sys.stderr)
sys.exit(code)
"""


def python(code: str, *argv: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter with this package, whose setting of JAX's precision is not inherited."""
    inherited = {key: value for key, value in os.environ.items() if key != "JAX_ENABLE_X64"}
    found = {**inherited, "PYTHONPATH": str(ROOT), **environment}
    call = [sys.executable, "-c", code, *argv]
    return subprocess.run(call, capture_output=True, text=True, check=False, env=found)


def started(*argv: str) -> tuple[int, str, list[str], list[str]]:
    """Exit code, standard output, lines of standard error and heavy imports of a command."""
    done = python(PROBE, *argv)
    *lines, imported = done.stderr.splitlines()
    return done.returncode, done.stdout, lines, imported.split()


@pytest.fixture
def broken(tmp_path):
    file = tmp_path / "broken.toml"
    file.write_text('name = "broken"\nrun = = 1\n')
    return str(file)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["run", "missing.toml"], "cannot read 'missing.toml'"),
        (["run", "broken"], "TOML syntax: Invalid value (at line 2"),
        (["scenes", "broken"], "TOML syntax"),
        (["equilibrium", "paper-case-11"], "did you mean 'paper-case-1'?"),
        (["run", "paper-case-1", "--dt", "abc"], "'abc' is not a number"),
        (["run", "paper-case-1", "--set", "run.dt"], "is not KEY=VALUE"),
        (["run", "paper-case-1", "--out", "run.txt"], "no known suffix; allowed: .npz, .nc"),
        (["run", "paper-case-1", "--animate", "film.mkv"], "no known suffix"),
        (["run", "paper-case-1", "--tables", __file__], "is a file; allowed: a folder"),
        (["run", "paper-case-1", "--colour"], "unrecognized arguments: --colour"),
        (["scenes", "paper-case-1", "--moordyn", "mooring.txt", "--dt", "0"], "--dt: 0 is out of range"),
        (["accuracy", "paper-case-1", "--dts", "-1"], "--dts: -1 is out of range"),
        (["cost", "paper-case-1", "--plot", "costs.svg"], "no known suffix; allowed: .png"),
        (["cost", "paper-case-1", "--plot", "costs.gif"], "no known suffix; allowed: .png, or a folder"),
        (["cost", "paper-case-1", "--out", "costs.csv"], "no known suffix; allowed: .json"),
        (["design", "paper-case-1", "--vary", "x", "--target", "y", "--value", "1"], "is not PATH=LOW:HIGH"),
        (["modes", "paper-case-1", "--count", "0"], "'0' is not a whole number"),
        (["report", "missing.npz"], "missing.npz: cannot be read"),
        (["report", "missing.npz", "--skip", "-1"], "--skip: -1 is out of range"),
        (["view", "missing.nc", "--out", "view.html"], "missing.nc: cannot be read"),
        (["rnu"], "invalid choice: 'rnu'"),
        (["--colour"], "required: COMMAND"),
        (["new", "boat", "boat.toml"], "invalid choice: 'boat'"),
        (["new", "lab", __file__], "no known suffix; allowed: .toml"),
    ],
)
def test_mistakes_that_need_no_scene_are_reported_in_one_line_without_jax(broken, argv, words):
    code, out, lines, imported = started(*(broken if word == "broken" else word for word in argv))
    assert (code, out, imported) == (2, "", [])
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert words in lines[0]


def test_wrong_values_are_reported_without_scipy_and_pictures(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(python("from dropper_jax.cli import main; main()", "scenes", "paper-case-1").stdout)
    for argv in (["--set", "run.dt=0"], ["--set", "effects.wight.x=1"], ["--solver", "dens"], ["--integrator", "eulr"]):
        code, _, lines, imported = started("run", str(file), *argv)
        assert (code, len(lines), imported) == (2, 1, ["jax"])


def quick(*argv: str) -> str:
    """Standard output of a command that ends well, without JAX and without a word on standard error."""
    code, out, lines, imported = started(*argv)
    assert (code, lines, imported) == (0, [], [])
    return out


def test_scenes_are_listed_and_printed_without_jax():
    assert [scene["name"] for scene in json.loads(quick("scenes", "--json"))["scenes"]] == list(scene_names())
    for name in ("paper-case-1", "dropper-release-a-undamped", "dropper-farm-2"):
        assert tomllib.loads(quick("scenes", name))["name"] == name


def test_versions_are_those_of_the_installed_packages():
    assert quick("--version").splitlines() == [f"{package} {version(package)}" for package in ("dropper-jax", "jax")]


OWN = [entry for entry in cli.find_commands() if entry.value.startswith("dropper_jax.")]


@pytest.mark.parametrize("entry", OWN, ids=lambda entry: entry.name)
def test_help_of_a_command_comes_without_jax(entry):
    assert entry.load().help in " ".join(quick(entry.name, "--help").split())


@pytest.mark.parametrize("argv", [[], ["--help"]])
def test_help_comes_without_jax_and_without_any_argument(argv):
    assert "simulate a scene" in quick(*argv)


def test_help_names_every_command_with_its_line(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    for entry in cli.find_commands():
        assert f" {entry.name} {entry.load().help}" in said


def test_every_command_is_in_one_group_and_every_group_is_listed_in_order(capsys):
    named = [name for names in cli.GROUPS.values() for name in names]
    assert sorted(named) == [entry.name for entry in cli.find_commands()]
    with pytest.raises(SystemExit):
        main([])
    heads = [line for line in capsys.readouterr().out.splitlines() if line in cli.GROUPS]
    assert heads == list(cli.GROUPS)


@pytest.mark.parametrize("entry", cli.find_commands(), ids=lambda entry: entry.name)
def test_help_of_a_command_ends_with_two_examples_that_it_accepts(entry, capsys):
    with pytest.raises(SystemExit):
        main([entry.name, "--help"])
    head, examples = capsys.readouterr().out.split("\nexamples:\n")
    assert "usage:" in head
    found = [shlex.split(line) for line in examples.splitlines()]
    assert len(found) == 2
    for words in found:
        assert words[:2] == ["dropper", entry.name]
        args = vars(cli.parse(words[1:]))
        scenes = args.get("scenes") or [args.get("scene")]
        assert all(is_packaged(scene) or scene.endswith(".toml") for scene in scenes if scene)
        if args.get("set") and is_packaged(args["scene"]):
            assert main(["scenes", args["scene"], *(word for value in args["set"] for word in ("--set", value))]) == 0
            capsys.readouterr()


def test_only_the_command_that_is_asked_for_is_imported():
    done = python(f"{PROBE.replace('sys.exit(code)', '')}\nprint([m for m in sys.modules if 'fitting' in m])", "scenes")
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_command_that_cannot_be_imported_is_refused_and_leaves_the_others(capsys, printed, monkeypatch):
    lost = EntryPoint(name="lost", value="no_such_package.cli", group=cli.GROUP)
    monkeypatch.setattr(cli, "find_commands", lambda: [*OWN, lost])
    assert printed(["lost"], 2).err == "error: dropper lost: is not available: No module named 'no_such_package'\n"
    assert main(["scenes"]) == 0
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "dropper lost: is not available" in " ".join(capsys.readouterr().out.split())


def test_packages_on_the_path_that_are_not_installed_have_no_commands_and_say_so(printed, monkeypatch):
    monkeypatch.setattr(cli, "find_commands", list)
    assert "no commands; needed: pip install" in printed(["run", "string"], 2).err


ZEROS = "print(jax.numpy.zeros(1).dtype)"


@pytest.mark.parametrize(
    "imports",
    [
        "import dropper_jax; import jax",
        "import jax; import dropper_jax",
        "import jax.numpy; jax.numpy.ones(1); from dropper_jax import plots",
        "from dropper_jax.cli import main; main(['scenes']); import jax",
    ],
)
def test_float64_comes_first_whoever_imports_jax(imports):
    assert python(f"{imports}; {ZEROS}").stdout.splitlines()[-1] == "float64"


@pytest.mark.parametrize("imports", ["import dropper_jax; import jax", "import jax; import dropper_jax"])
@pytest.mark.parametrize(("setting", "dtype"), [("0", "float32"), ("1", "float64")])
def test_the_user_may_decide_on_float64_before(imports, setting, dtype):
    assert python(f"{imports}; {ZEROS}", JAX_ENABLE_X64=setting).stdout == f"{dtype}\n"


def test_the_root_is_imported_without_jax_and_without_parsing_a_stub():
    code = "import sys; before = {*sys.modules}; import dropper_jax; dir(dropper_jax); new = {*sys.modules} - before"
    assert python(f"{code}; print(new & {{'ast', 'jax'}})").stdout == "set()\n"


def test_root_names_are_those_of_their_modules():
    for name, home in dropper_jax.PUBLIC.items():
        assert getattr(dropper_jax, name) is getattr(import_module(f"dropper_jax.{home}"), name)


def test_the_stub_of_the_root_offers_the_same_names():
    stub = ast.parse(Path(dropper_jax.__file__).with_suffix(".pyi").read_text())
    offered = {name.asname: node.module for node in stub.body[1:] for name in node.names}
    assert offered == {name: f"dropper_jax.{home}" for name, home in dropper_jax.PUBLIC.items()}


def test_a_star_takes_the_public_names_and_dir_shows_them():
    names = {}
    exec("from dropper_jax import *", names)
    assert names.keys() - {"__builtins__"} == set(dropper_jax.__all__)
    assert set(dropper_jax.__all__) <= set(dir(dropper_jax))


def test_rooms_are_attributes_of_the_package_and_step_stays_a_function():
    code = """
import dropper_jax as dj
print(dj.plots.snapshot.__name__, dj.statics.catenary.__name__, dj.step.__name__)
import dropper_jax.residual.step
from dropper_jax import plots, step
print(dj.step is step, hasattr(dj, "setp"), hasattr(dj, "_step"))
"""
    assert python(code).stdout.splitlines() == ["snapshot dropper_jax.statics.catenary step", "True False False"]


def test_solvers_that_a_scene_may_name_are_those_there_are():
    assert set(run.SOLVERS) == {"auto", *SOLVERS}
