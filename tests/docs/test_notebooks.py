"""The notebooks run, in a fast mode; what is kept of them belongs to their scripts and holds nothing it should not."""

import base64
import importlib.util
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jupytext
import nbformat
import numpy as np
import pytest
from PIL import Image

FOLDER = Path(__file__).parents[2] / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9]*-*.py"), key=lambda script: int(script.name.partition("-")[0]))
#: Largest kept notebook [bytes], pictures included.
LARGEST = 400_000


def test_there_is_a_notebook_for_every_story():
    assert [int(script.name.partition("-")[0]) for script in SCRIPTS] == list(range(1, len(SCRIPTS) + 1))
    assert len(SCRIPTS) >= 9


@pytest.mark.check
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_notebook_runs_in_fast_mode(script, tmp_path):
    # a process of its own: kernels bring warnings and event loops that are no business of these tests
    call = [sys.executable, str(FOLDER / "make.py"), script.stem, "--fast", "--out", str(tmp_path)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=600, env={**os.environ, "JAX_PLATFORMS": "cpu"})
    assert done.returncode == 0, done.stderr[-2000:]
    made = nbformat.read(tmp_path / f"{script.stem}.ipynb", 4)
    assert sum("image/png" in out.get("data", {}) for cell in made.cells for out in cell.get("outputs", [])) >= 2


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_kept_notebook_is_that_of_its_script(script):
    kept, fresh = nbformat.read(script.with_suffix(".ipynb"), 4), jupytext.read(script)
    assert [(c.cell_type, c.source) for c in kept.cells] == [(c.cell_type, c.source) for c in fresh.cells], (
        f"python notebooks/make.py {script.stem}"
    )


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_kept_notebook_has_outputs_is_small_and_names_no_machine(script):
    path = script.with_suffix(".ipynb")
    kept = nbformat.read(path, 4)
    outputs = [out for cell in kept.cells for out in cell.get("outputs", [])]
    assert all(out.output_type != "error" for out in outputs)
    assert sum("image/png" in out.get("data", {}) for out in outputs) >= 2
    assert path.stat().st_size < LARGEST
    printed = " ".join(str(out.get("text", "")) + str(out.get("data", {}).get("text/plain", "")) for out in outputs)
    assert not re.search(r"/(home|root|tmp|Users|work)\b|site-packages", printed)


def test_scripts_hold_no_switches_and_can_all_be_cut_short(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from short import SHORT, shortened

    assert sorted(SHORT) == [script.stem for script in SCRIPTS]
    for script in SCRIPTS:
        code = [cell.source for cell in jupytext.read(script).cells if cell.cell_type == "code"]
        assert "FAST" not in "".join(code)
        cut = shortened(script.stem, code)
        assert sum(new != old for new, old in zip(cut, code, strict=True)) >= 2
        for text in cut:
            compile(text or "", script.stem, "exec")
    with pytest.raises(ValueError, match="exactly once"):
        shortened(SCRIPTS[0].stem, ["pass"])


def test_pictures_are_kept_small_and_readable():
    spec = importlib.util.spec_from_file_location("make", FOLDER / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    data = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (300, 2000, 4), np.uint8)).save(data, "PNG")
    small = make.smaller(base64.b64encode(data.getvalue()).decode())
    with Image.open(io.BytesIO(base64.b64decode(small))) as image:
        assert image.width == make.WIDEST
        assert len(image.getcolors()) <= make.COLOURS


def printed(stem):
    """What a kept notebook prints."""
    kept = nbformat.read(next(FOLDER.glob(f"{stem}*.ipynb")), 4)
    return "\n".join(str(out.get("text", "")) for cell in kept.cells for out in cell.get("outputs", []))


@pytest.mark.parametrize("rig", ["single", "double"])
def test_printed_friction_is_that_of_the_stored_results(rig):
    text = printed("4-").split(f"{rig} pendulum (fit ended")[1].split("pendulum (fit ended")[0]
    found = json.loads((FOLDER.parent / "benchmarks" / "results" / f"measured_{rig}_pendulum.json").read_text())
    shown = {m[1]: (float(m[2]), float(m[3])) for m in re.finditer(r"(effects\.\S+) +(\S+) \+- (\S+)", text)}
    kept = {path: row for path, row in found["fit"]["parameters"].items() if "effects" in path}
    assert shown.keys() == kept.keys()
    for path, row in kept.items():
        assert shown[path] == (float(f"{row['value']:.3g}"), float(f"{row['std_error']:.1g}"))


def test_printed_estimates_hold_the_truth():
    rows = re.findall(r"(b_[lq]): (\S+) \+- (\S+), truth (\S+),", printed("9-"))
    assert [row[0] for row in rows] == ["b_l", "b_q"] * 2  # the first fit with a wrong length, then with what it frees
    for _, value, error, truth in rows[2:]:
        assert abs(float(value) - float(truth)) < 4 * float(error)
    ways = re.findall(r"^(?:Gauss-Newton|L-BFGS|Adam) .*s   (\S+) \+- (\S+)   (\S+) \+- (\S+)$", printed("4-"), re.M)
    assert len(ways) == 3
    for row in ways:
        numbers = np.array(row, float).reshape(2, 2)
        assert np.all(np.abs(numbers[:, 0] - [0.002, 0.001]) < 4 * numbers[:, 1])
