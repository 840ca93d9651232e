"""The films of `benchmarks/films.py`, whose motion no part of the simulator has made."""

import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def films():
    path = Path(__file__).parents[3] / "benchmarks" / "films.py"
    spec = importlib.util.spec_from_file_location("benchmark_films", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
