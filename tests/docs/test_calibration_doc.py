"""The pages on calibration agree with the committed results, and their examples name things that exist."""

import re
from pathlib import Path

import pytest

import dropper_jax as dj
from fitting import read_trace
from fitting.parameters.of_scene import full_names

ROOT = Path(__file__).parents[2]
PAGES = ("calibration.md", "statistics-of-fits.md", "tutorial-lab-dropper.md")
TEXT = "\n".join((ROOT / "docs" / page).read_text() for page in PAGES)


def test_the_example_trace_is_read_as_it_is_described(tmp_path):
    block = re.search(r"```\n(# zero=down.*?)```", TEXT, re.DOTALL).group(1)
    rows = block + "".join(f"{0.004 * i:.3f},{0.01 * i:.3f},0.4\n" for i in range(2, 20))
    (tmp_path / "run.csv").write_text(rows)
    trace = read_trace(tmp_path / "run.csv", 2)
    assert trace.convention.zero == "down"
    assert trace.theta[0, 0] == -0.526
    assert trace.theta[1, 1] != trace.theta[1, 1]


@pytest.mark.parametrize("command", re.findall(r"^dropper fit .*?(?<!\\)$", TEXT, re.DOTALL | re.MULTILINE))
def test_commands_name_scenes_and_parameters_that_exist(command):
    scene, names = (re.search(rf"--{key} (\S+)", command).group(1) for key in ("scene", "free"))
    assert len(full_names(dj.load_scene(scene), names.split(","))) == len(names.split(","))


def test_pictures_are_there():
    for name in re.findall(r"!\[.*?\]\((.*?)\)", TEXT):
        assert (ROOT / "docs" / name).is_file()
