"""Every command and every piece of Python of the documentation runs, in a folder with the files that the pages name.

Commands keep all their words; what makes them long (durations, numbers of cases) is cut short by words after them, of
which the last counts.
"""

import glob
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.cli import main, parse
from dropper_jax.cli.new import template
from dropper_jax.effects import EFFECTS
from fitting import Camera, observe, simulate_truth, write_trace

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
#: Words after a command's own that cut it short.
SHORTER = {
    "accuracy": "--quick --integrators energy_momentum rattle --dts 0.02 0.01 --span 0.2 --quiet",
    "demo": "",
    "fit": "--method windows --until 2.0 --quiet",
    "frequency": "--frequencies 8",
    "new": "--force",
    "offset": "--direction 0 --distance 0:1:0.5 --quiet",
    "plan": "--duration 1 --quiet",
    "response": "--no-higher-waves --quiet",
    "run": "--duration 0.3 --quiet",
    "sensitivity": "--duration 0.2 --quiet",
    "stability": "--short --quiet --cases hanging-kicked",
    "sweep": "--duration 0.1 --quiet",
}
#: Commands that are run by tests of their own, on smaller input: what they begin with, and the file of those tests.
ELSEWHERE = {
    "cases SITE.toml --out": "tests/fitting/farm/cases/test_cases.py",
    "fit encoder.csv": "tests/fitting/from_file/test_first_command.py",
    "fit mooring.toml": "tests/fitting/channels/test_fit_channels.py",
    "fit releases.toml": "tests/fitting/channels/test_between.py",
    "fit RUN.csv --scene measured-single-pendulum": "tests/fitting/calibration/test_measured.py",
    "optimise": "tests/fitting/farm/optimise/test_optimise.py",
    "frequency": "tests/study/test_frequency.py",
    "season": "tests/fitting/farm/season/test_season.py",
    "sweep dropper-release-a --paired --trace": "tests/fitting/sweep/test_against_trace.py",
}
#: Pages, or sections of pages, whose Python runs in tests of their own, or asks for data that only a user has.
PYTHON_ELSEWHERE = {
    "docs/README.md": "tests/docs/test_everything_runs.py",
    "docs/physics.md": "tests/docs/test_reference_step.py",
    "docs/python.md#Add an effect": "tests/docs/test_everything_runs.py",
    "docs/python.md#A rope in your own program": "tests/docs/test_rope_page.py",
    "docs/fits.md#Fit any channel": "tests/fitting/channels/test_fit_channels.py",
}


def blocks(page: Path, *kinds: str) -> list[str]:
    return [text for kind, text in BLOCK.findall(page.read_text()) if kind in kinds]


def python_by_section(page: Path) -> dict[str, list[str]]:
    """The Python of a page, by `PAGE#HEADING` of its sections; before the first heading `PAGE#`."""
    name = page.relative_to(ROOT).as_posix()
    parts = re.split(r"^## (.+)$", page.read_text(), flags=re.M)
    sections = zip(["", *parts[1::2]], parts[::2], strict=True)
    return {
        f"{name}#{head}": [code for kind, code in BLOCK.findall(text) if kind == "python"] for head, text in sections
    }


def python_run_here(page: Path) -> list[str]:
    """The Python of a page that no other test runs."""
    if page.relative_to(ROOT).as_posix() in PYTHON_ELSEWHERE:
        return []
    return [text for key, texts in python_by_section(page).items() if key not in PYTHON_ELSEWHERE for text in texts]


def commands() -> list[str]:
    """All commands of all pages, each once, as they are written."""
    found = {}
    for page in PAGES:
        texts = [
            *blocks(page, "", "sh", "bash"),
            *re.findall(r"^    (dropper .*\n(?:     .*\n)*)", page.read_text(), re.M),
        ]
        for text in texts:
            for line in re.sub(r"\\\n\s*", " ", text).splitlines():
                if line.startswith("dropper "):
                    found |= dict.fromkeys(part.split("  #")[0].strip() for part in line.split(" && "))
    return list(found)


def told_elsewhere(line: str) -> str | None:
    return next((file for start, file in ELSEWHERE.items() if line.startswith(f"dropper {start}")), None)


def words(line: str) -> list[str]:
    """The words of a command cut short, with files that are there for names that stand for any."""
    line = line.replace("RUN.csv...", "RUN.csv").replace("SCENE", "double-pendulum-chaotic")
    argv = shlex.split(line)[1:]
    argv = [re.sub(r"^([\w.]+=[^:]+:[^:]+):\d+(:log)?$", r"\1:2\2", word) for word in argv]
    argv = [re.sub(r"^(\d[\d.]*:\d[\d.]*):\d+$", r"\1:2", word) for word in argv]
    argv = [name for word in argv for name in (sorted(glob.glob(word)) if "*" in word else [word])]
    shorter = SHORTER.get(argv[0], "")
    if "--global" in argv:
        shorter += " --samples 8"
    return argv + shlex.split(shorter.replace("--method windows", "") if "--method" in argv else shorter)


def test_what_is_run_elsewhere_is_there():
    for start, file in {**ELSEWHERE, **PYTHON_ELSEWHERE}.items():
        assert (ROOT / file).is_file(), (start, file)
    written = commands()
    assert [start for start in ELSEWHERE if not any(line.startswith(f"dropper {start}") for line in written)] == []


@pytest.mark.parametrize("line", commands())
def test_commands_on_the_pages_are_understood(line):
    # a misspelt option or a command that is gone ends in an error of the parser
    assert callable(parse(shlex.split(line)[1:]).run)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A folder with the files that the pages name."""
    from fitting import Motion, View, film, write_video
    from fitting.farm.site import site_text
    from fitting.films.render import chessboards
    from fitting.films.video import opencv

    folder = tmp_path_factory.mktemp("workshop")
    lab = dj.load_scene("dropper-release-a")
    trace = observe(simulate_truth(lab, 2.5, 60.0), Camera(rate=60.0, angle_noise=0.005), seed=0)
    for name in ("RUN.csv", "run.csv", "traces.csv", "measured.csv"):
        write_trace(folder / name, trace)
    solution = dj.simulate(lab, duration=0.5, dt=1 / 480, integrator="rattle")
    view = View(centre=(0.14, -0.14), distance=1.1, noise=4.0)
    for name in ("my-video.mp4", "swing.mp4"):
        write_video(folder / name, film(Motion(solution.t, solution.positions), view, fps=60.0), 60.0)
    for i, image in enumerate(chessboards(view, count=4), 1):
        opencv().imwrite(str(folder / f"board-{i}.png"), image)
    for page, name in (("README.md", "loop.toml"), ("longlines.md", "longline.toml")):
        (folder / name).write_text(blocks(ROOT / "docs" / page, "toml")[0])
    (folder / "my_scene.toml").write_text((ROOT / "dropper_jax/data/scenes/dropper-release-a.toml").read_text())
    (folder / "my-longline.toml").write_text(template("longline"))
    (folder / "states.csv").write_text(next(text for text in blocks(ROOT / "docs/longlines.md", "") if "hs,tp" in text))
    (folder / "SITE.toml").write_bytes(site_text("exposed-bay"))
    shutil.copy(ROOT / "tests/moordyn/decks/raft_semi.yaml", folder)
    long = dj.simulate("paper-case-1", duration=80.0, dt=0.05)
    short = dj.simulate("paper-case-1", duration=1.0, dt=0.05)
    for name in ("run.nc", "calm.nc", "storm.nc", "second.nc", "first.npz"):
        short.save(folder / name)
    for name in ("seed-1.npz", "seed-2.npz", "seed-3.npz", "case-1.npz", "longline.nc"):
        long.save(folder / name)
    assert main(["scenes", "paper-case-4", "--moordyn", str(folder / "mooring.txt"), "--dt", "0.001"]) == 0
    return folder


@pytest.fixture
def place(workshop, tmp_path, monkeypatch):
    """A copy of the workshop, in which a test works."""
    shutil.copytree(workshop, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")


@pytest.mark.check
@pytest.mark.parametrize("line", [line for line in commands() if told_elsewhere(line) is None], ids=str)
def test_command_runs(line, place, capsys):
    argv = words(line)
    if "seed-*.npz" in line:  # the example counts its start from 300 s on
        argv[argv.index("300")] = "20"
    too_long = line == "dropper run SCENE --dt 0.15"  # the example of such a step
    assert main(argv) == (3 if too_long else 0), capsys.readouterr().err[-2000:]


@pytest.mark.check
@pytest.mark.parametrize("page", [p for p in PAGES if python_run_here(p)], ids=str)
def test_python_of_a_page_runs(page, place):
    names = {"__name__": page.stem}
    for text in python_run_here(page):
        exec(compile(text, page.name, "exec"), names)
    if page.stem == "python":
        assert names["lines"].status == "ok"
        assert np.all(np.isfinite(names["track"]))


@pytest.fixture
def registry():
    """The registry of effects as it was, after a page has registered some."""
    before = dict(EFFECTS)
    yield EFFECTS
    EFFECTS.clear()
    EFFECTS.update(before)


def run_texts(texts, page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {"__name__": page}
    for text in texts:
        exec(compile(text, page, "exec"), names)
    return names


@pytest.mark.check
@pytest.mark.slow
def test_the_section_on_effects_runs_and_keeps_what_it_promises(tmp_path, monkeypatch, registry, capsys):
    page = ROOT / "docs/python.md"
    names = run_texts(python_by_section(page)["docs/python.md#Add an effect"], "python.md", tmp_path, monkeypatch)
    assert registry["shock_cord"] is names["ShockCord"]
    (section,) = re.findall(r"^## Add an effect$(.*?)(?=^## |\Z)", page.read_text(), re.M | re.S)
    assert capsys.readouterr().out.strip() in section
    model, start = names["model"], names["start"]
    force = jax.make_jaxpr(lambda r: model.effects[1].force(model.instant(r, start.v, start.t)))(start.r)
    assert "scatter" not in str(force), "a scatter keeps a run from being one kernel"
    # the promise that nothing else changes: no stepper or solver was replaced, the effect is the scene's own
    assert names["model"].effects[1].name == "shock_cord"


@pytest.mark.check
@pytest.mark.slow
def test_the_scene_and_the_code_of_the_first_page_run(tmp_path, monkeypatch):
    page = ROOT / "docs/README.md"
    (tmp_path / "loop.toml").write_text(blocks(page, "toml")[0])
    trace = observe(simulate_truth("dropper-release-a", 2.0, 60.0, 8), Camera(rate=60.0, angle_noise=0.005), seed=0)
    write_trace(tmp_path / "traces.csv", trace)
    names = run_texts(blocks(page, "python"), "README.md", tmp_path, monkeypatch)
    assert names["solution"].status == "ok"
    assert names["result"].method == "gradient"
    assert names["result"].values == pytest.approx([0.002, 0.001], abs=0.002)


def test_python_of_every_page_is_run_somewhere():
    sections = {}
    for page in PAGES:
        sections |= python_by_section(page)
    for place in PYTHON_ELSEWHERE:
        assert [key for key, texts in sections.items() if texts and key.startswith(place)], place
    for key, texts in sections.items():
        for text in texts:
            compile(text, key, "exec")


@pytest.mark.check
def test_the_gradient_of_a_run_in_the_readme_is_that_of_two_runs():
    (text,) = [text for text in blocks(ROOT / "README.md", "python") if "jax.grad" in text]
    names = {}
    exec(compile(text, "README.md", "exec"), names)
    model, lowest, slope = names["model"], jax.jit(names["lowest"]), names["slope"]

    def difference(change):
        return (lowest(change(1e-6)) - lowest(change(-1e-6))) / 2e-6

    def with_damping(by):
        linear = model.effect("linear_damping")
        effects = [e if e is not linear else replace(linear, b_l=linear.b_l + by) for e in model.effects]
        return replace(model, effects=tuple(effects))

    def with_mass(by):
        line = model.lines[0]
        return replace(model, lines=(replace(line, mass=line.mass.at[4].add(by)),))

    assert float(slope.effect("linear_damping").b_l) == pytest.approx(float(difference(with_damping)), rel=1e-5)
    assert float(slope.lines[0].mass[4]) == pytest.approx(float(difference(with_mass)), rel=1e-5)


@pytest.mark.check
def test_the_first_screen_of_the_readme_shows_the_results():
    text = (ROOT / "README.md").read_text()
    largest, when = re.search(r"(\d+\.\d) kN in the western chain at (\d+) s", text).groups()
    run = dj.simulate("edulis-longline", duration=60.0)
    links = next(line.links for line in run.lines if line.name == "west-leg")
    largest_n = run.tension_max[:, links]
    row, link = np.unravel_index(np.argmax(largest_n), largest_n.shape)
    assert run.status == "ok"
    assert f"{largest_n[row, link] / 1e3:.1f}" == largest
    assert f"{run.tension_max_time[:, links][row, link]:.0f}" == when
