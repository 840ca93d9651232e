"""The films of `films.py`, whose motion no part of the simulator has made."""

import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def films():
    spec = importlib.util.spec_from_file_location("films", Path(__file__).with_name("films.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
