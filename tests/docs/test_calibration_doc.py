"""The pages on calibration agree with the committed results, and their examples name things that exist."""

import re
from pathlib import Path

import pytest

import dropper_jax as dj
from fitting import read_trace
from fitting.parameters.names import full_names

ROOT = Path(__file__).parents[2]
PAGES = ("fits.md", "first-fit.md")
TEXT = "\n".join((ROOT / "docs" / page).read_text() for page in PAGES)
#: The part on angles, whose commands name packaged scenes; those of whole runs name files of the user's.
ANGLES = re.sub(r"^## Fit any channel$.*?(?=^# )", "", TEXT, flags=re.M | re.S)


def test_the_example_trace_is_read_as_described(tmp_path):
    block = re.search(r"```\n(# zero=down.*?)```", TEXT, re.DOTALL).group(1)
    rows = block + "".join(f"{0.004 * i:.3f},{0.01 * i:.3f},0.4\n" for i in range(2, 20))
    (tmp_path / "run.csv").write_text(rows)
    trace = read_trace(tmp_path / "run.csv", 2)
    assert trace.convention.zero == "down"
    assert trace.theta[0, 0] == -0.526
    assert trace.theta[1, 1] != trace.theta[1, 1]


COMMANDS = re.findall(r"^dropper fit .*?(?<!\\)$", ANGLES, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("command", [command for command in COMMANDS if "--scene" in command])
def test_commands_name_scenes_and_parameters_that_exist(command):
    scene = dj.load_scene(re.search(r"--scene (\S+)", command).group(1))
    free = re.search(r"--free (\S+)", command)
    names = free.group(1).split(",") if free else []
    assert len(full_names(scene, names)) == len(names)
