"""A new axial law, scheme, loss, load case or channel is three files: source, test, and the list of its kind."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: By patch: the list of the kind, and the source and the test of the new thing.
FILES = {
    "axial_law": ("axial/__init__.py", "axial/prestressed.py", "axial/test_prestressed.py"),
    "scheme": ("integrators/__init__.py", "integrators/heun3.py", "integrators/test_heun3.py"),
    "loss": ("estimate/loss.py", "estimate/cauchy.py", "estimate/test_cauchy.py"),
    "load_case": ("site/case_lists.py", "site/densities.py", "site/test_densities.py"),
    "channel": ("channels/reading.py", "channels/acoustic_range.py", "channels/test_acoustic_range.py"),
}
OF_FITS = ("loss", "load_case", "channel")


def paths(kind):
    *sources, test = FILES[kind]
    sub = "fitting/" if kind in OF_FITS else ""
    return [*((sub or "dropper_jax/") + source for source in sources), f"tests/{sub}{test}"]


def patch(kind):
    return Path(__file__).with_name(f"{kind}.patch")


@pytest.mark.parametrize("kind", FILES)
def test_a_new_thing_touches_three_files(kind):
    touched = [line[6:] for line in patch(kind).read_text().splitlines() if line.startswith("+++ b/")]
    assert sorted(touched) == sorted(paths(kind))
    if shutil.which("git") is not None:
        subprocess.run(["git", "apply", "--check", str(patch(kind))], cwd=ROOT, check=True, timeout=60)


@pytest.mark.check
def test_new_things_of_three_files_work(tmp_path):
    if shutil.which("git") is None:
        pytest.skip("git applies the patches")
    for package in ("dropper_jax", "fitting"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    for kind in FILES:
        subprocess.run(["git", "apply", str(patch(kind))], cwd=tmp_path, check=True, timeout=60)
    tests = [paths(kind)[-1] for kind in FILES]
    call = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir=.", *tests]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(call, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "8 passed" in done.stdout
