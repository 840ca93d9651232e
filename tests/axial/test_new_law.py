"""A new axial law is three files: its source, its test and the list of laws."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATCH = Path(__file__).with_name("new_law.patch")


def test_a_law_of_three_files_works_by_the_link_and_by_the_metre(tmp_path):
    touched = [line[6:] for line in PATCH.read_text().splitlines() if line.startswith("+++ b/")]
    new = ["dropper_jax/axial/prestressed.py", "tests/axial/test_prestressed.py"]
    assert touched == ["dropper_jax/axial/__init__.py", *new]
    if shutil.which("git") is None:
        pytest.skip("git applies the patch")
    shutil.copytree(ROOT / "dropper_jax", tmp_path / "dropper_jax", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(["git", "apply", str(PATCH)], cwd=tmp_path, check=True, timeout=60)
    call = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir=.", new[1]]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(call, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "3 passed" in done.stdout
