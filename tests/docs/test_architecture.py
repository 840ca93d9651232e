"""The architecture in CONTRIBUTING.md: every name in it exists, and every folder is in it."""

import importlib
import re
from functools import reduce
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`((?:dropper_jax|fitting)\.[\w.]+)`", TEXT)))


def thing(name):
    """The module, or the attribute of the longest prefix that is a module."""
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        try:
            module = importlib.import_module(".".join(parts[:n]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[n:], module)
    raise LookupError(name)


@pytest.mark.parametrize("name", NAMES)
def test_a_name_of_the_architecture_exists(name):
    assert thing(name) is not None


@pytest.mark.parametrize("package", ["dropper_jax", "fitting"])
def test_every_folder_is_in_it(package):
    folders = {f"{package}.{path.parent.name}" for path in (ROOT / package).glob("*/__init__.py")}
    assert folders <= set(NAMES)
