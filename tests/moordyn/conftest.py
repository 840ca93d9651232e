"""Decks as files beside what they refer to."""

import shutil
from pathlib import Path

import pytest

from dropper_jax import read_moordyn

FOLDER = Path(__file__).parent


@pytest.fixture
def deck(tmp_path):
    """`deck(text)`: a file of that text, or of the input of that name, with a current file beside it."""

    def make(text: str) -> Path:
        shutil.copy(FOLDER / "current_profile.txt", tmp_path)
        path = tmp_path / "mooring.txt"
        path.write_text(text if "\n" in text else (FOLDER / f"{text}.txt").read_text())
        return path

    return make


@pytest.fixture
def read(deck):
    """`read(text)`: the plain values of a deck of that text."""
    return lambda text, depth=None: read_moordyn(deck(text), depth)
