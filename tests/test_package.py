"""Source distribution and wheel: built, their metadata and contents looked at, the tests inside the source."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: What the copy that is built leaves out.
IGNORED = shutil.ignore_patterns(".git", ".venv*", "*.egg-info", "build", "dist", "__pycache__", ".*_cache", "demo")

pytestmark = pytest.mark.check


def call(*words, cwd):
    done = subprocess.run([sys.executable, *words], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The copy, its wheel (made from the source distribution) and the source distribution."""
    for module in ("build", "twine", "check_wheel_contents"):
        pytest.importorskip(module)
    copy = tmp_path_factory.mktemp("package") / "source"
    shutil.copytree(ROOT, copy, ignore=IGNORED, symlinks=True)
    call("-m", "build", cwd=copy)
    (wheel,), (source,) = ((copy / "dist").glob(pattern) for pattern in ("*.whl", "*.tar.gz"))
    return copy, wheel, source


def test_checkers_have_nothing_to_say(built):
    copy, wheel, source = built
    call("-m", "twine", "check", "--strict", str(wheel), str(source), cwd=copy)
    call("-m", "check_wheel_contents", str(wheel), cwd=copy)


def test_the_wheel_has_every_file_of_the_packages(built):
    _, wheel, _ = built
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
    wanted = {
        str(path.relative_to(ROOT))
        for package in ("dropper_jax", "fitting")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {"dropper_jax/py.typed", "fitting/py.typed", "dropper_jax/__init__.pyi"} <= wanted <= names
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"dropper_jax", "fitting"}


def test_the_source_distribution_can_run_its_tests(built, tmp_path):
    _, _, source = built
    with tarfile.open(source) as file:
        file.extractall(tmp_path, filter="data")
    (root,) = tmp_path.iterdir()
    there = {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}
    for folder in ("tests", "docs", "notebooks", "benchmarks"):
        wanted = {str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob("*") if path.is_file()}
        lacking = {name for name in wanted - there if "__pycache__" not in name and ".ipynb_checkpoints" not in name}
        assert not lacking, sorted(lacking)[:5]
    call(
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/run/test_io.py",
        "tests/docs/test_architecture.py",
        cwd=root,
    )
