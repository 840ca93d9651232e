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
#: Data of the package that notebooks read.
DATA = FOLDER.parent / "dropper_jax" / "data"


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

    assert set(SHORT) == {script.stem for script in SCRIPTS}
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


def numbers(pattern, text):
    """The numbers of the first match."""
    found = re.search(pattern, text)
    assert found, pattern
    return [float(number) for number in found.groups()]


def test_printed_pose_is_that_of_the_measured_angles():
    text, data = printed("1-"), np.genfromtxt(DATA / "release_angles_rad.csv", delimiter=",", dtype=str)
    runs = np.array([row[2:].astype(float) for row in data if row[0] == "A" and row[1] != "model"])
    rows = {
        name: np.array(re.search(rf"^{name} +(.*)$", text, re.M)[1].split(), float) for name in ("measured", "computed")
    }
    np.testing.assert_allclose(rows["measured"], runs.mean(axis=0), atol=6e-4)
    (rms,) = numbers(r"RMS difference (\S+) rad", text)
    assert rms == pytest.approx(np.sqrt(np.mean((rows["computed"] - runs.mean(axis=0)) ** 2)), abs=2e-4)
    assert rms < 0.0139  # what the static poses leave, see docs/checked-against.md
    drift, scale = numbers(r"drifts by (\S+) J of (\S+) J", text)
    assert drift < 1e-12 * scale


def test_printed_orders_are_those_of_the_schemes():
    formal = {"energy_momentum": 2, "rattle": 2, "theta 0.51": 1, "theta_midpoint 0.51": 1, "energy_momentum_4": 4}
    found = dict(re.findall(r"^  (\S+(?: \S+)?) +(\d\.\d+)$", printed("2-"), re.M))
    assert found.keys() == formal.keys()
    assert all(abs(float(found[name]) - order) < 0.15 for name, order in formal.items())


def test_printed_hard_cases_agree_with_the_text():
    text = printed("3-")
    rows = re.findall(r"^ +\S+ +(energy_momentum|thesis_angles) +(\S+) +\S+ +(\S+)$", text, re.M)
    lost = {name: [float(row[2]) for row in rows if row[0] == name] for name in ("energy_momentum", "thesis_angles")}
    assert max(lost["energy_momentum"]) < 1e-10 < 1e-3 < min(lost["thesis_angles"])
    stands, limit = numbers(r"stands at (\S+) rad and creeps by 0e\+00", text) + numbers(r"within (\S+) rad", text)
    assert limit == pytest.approx(0.05 / (1.0 * 9.81 * 0.5), abs=1e-4)
    assert abs(stands) < limit
    steps = re.findall(r"^ +0\.0\d+ +(\S+) +(\d+) +(\d+) ", text, re.M)
    assert [row[0] for row in steps] == ["ok"] * 6
    assert int(steps[-1][1]) > int(steps[0][1]) == 0


def test_printed_derivatives_agree_with_differences():
    rows = re.findall(r"exact (\S+) +difference quotient (\S+)$", printed("5-"), re.M)
    assert len(rows) == 3
    np.testing.assert_allclose(*np.array(rows, float).T, rtol=1e-5)


def test_printed_sweeps_are_complete():
    assert re.search(r"480 runs of 10 s, 2000 steps each: 480 ok", printed("6-"))
    assert re.search(r"160 runs: 160 ok", printed("6-"))


def test_printed_sea_is_that_of_the_printed_components():
    text = printed("7-")
    components = np.genfromtxt(DATA / "seas" / "north_sea_25_year_components.csv", delimiter=",", skip_header=1)
    count, hs = numbers(r"(\d+) components, Hs = (\S+) m", text)
    assert count == len(components)
    assert hs == pytest.approx(4 * np.sqrt(np.sum(components[:, 1] ** 2) / 2), abs=0.01)
    assert len(re.findall(r"^ok: 0 failed steps", text, re.M)) == 2


def test_printed_longline_is_symmetric_and_its_chain_agrees_with_moordyn():
    text = printed("8-")
    loads = {m[1]: (float(m[2]), float(m[3])) for m in re.finditer(r"^(\S+) +(\d+) +(\d+) +\d+%$", text, re.M)}
    assert len(loads) == 15
    # waves and current come across the line
    np.testing.assert_allclose(loads["west-leg"], loads["east-leg"], rtol=2e-3)
    assert max(load[1] for load in loads.values()) == loads["backbone"][1] > loads["east-leg"][1]
    ours, theirs = numbers(r"anchor (\S+) N, buoy", text) + numbers(r"MoorDyn v2 at rest: (\S+) N", text)
    assert ours == pytest.approx(theirs, rel=0.002)
    for drift, scale in re.findall(r"balance drifts by (\S+) J of (\S+) J", text):
        assert float(drift) < 1e-6 * float(scale)
