"""The rules of the house: folders import downwards only, and the style of the text."""

import subprocess
import sys
from pathlib import Path

import pytest

from dropper_jax import INTEGRATORS
from dropper_jax.effects import EFFECTS

ROOT = Path(__file__).parents[1]
IMPORTS = "from importlinter.cli import lint_imports_command; lint_imports_command()"


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(["-c", IMPORTS, "--no-cache"], id="imports point downwards"),
        pytest.param(["-m", "ruff", "check", "--no-cache", "."], id="ruff check"),
        pytest.param(["-m", "ruff", "format", "--no-cache", "--check", "."], id="ruff format"),
    ],
)
def test_the_house_is_in_order(arguments):
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(("folder", "names"), [("effects", EFFECTS), ("integrators", INTEGRATORS)])
def test_each_effect_and_each_scheme_has_a_test_file_of_its_own(folder, names):
    found = {path.stem.removeprefix("test_") for path in (ROOT / "tests" / folder).glob("test_*.py")}
    own = {name for name, cls in names.items() if cls.__module__.startswith("dropper_jax.")}
    assert own <= found
