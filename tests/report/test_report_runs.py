"""The report over several runs, of runs that went bad, and as files: Markdown, JSON, pictures, ParaView."""

import base64
import json
import struct
from xml.etree import ElementTree

import numpy as np
import pytest

from dropper_jax import SceneError, report_run, report_runs, write_vtk
from dropper_jax.cli import main
from dropper_jax.evaluation.extremes import Gumbel, fit_gumbel, storm_extreme
from dropper_jax.report.text import report_markdown

pytest.importorskip("rainflow")

# --- extremes -------------------------------------------------------------------------------------------------------


def test_gumbel_fit_of_three_values_by_hand():
    # b0 = 7/3, b1 = (0.5 * 2 + 1 * 4)/3 = 5/3, so 2 b1 - b0 = 1
    found = fit_gumbel(np.array([4.0, 1.0, 2.0]))
    assert found.scale == pytest.approx(1 / np.log(2))
    assert found.mode == pytest.approx(7 / 3 - 0.5772156649 / np.log(2))


def test_gumbel_fit_recovers_the_distribution_and_the_largest_of_many():
    truth = Gumbel(100.0, 7.0)
    p = (np.arange(4000) + 0.5) / 4000
    found = fit_gumbel(truth.mode - truth.scale * np.log(-np.log(p)))
    assert (found.mode, found.scale) == pytest.approx((100.0, 7.0), rel=1e-3)
    # P(largest of six <= x) = P(x)^6
    x = truth.over(6).quantile(0.9)
    assert np.exp(-np.exp(-(x - 100.0) / 7.0)) ** 6 == pytest.approx(0.9)
    assert truth.mean == pytest.approx(100.0 + 0.5772156649 * 7.0)


def test_interval_of_the_extreme_holds_its_level_with_few_runs():
    truth, rng, inside = Gumbel(50.0, 3.0), np.random.default_rng(7), 0
    for _ in range(300):
        maxima = truth.mode - truth.scale * np.log(-np.log(rng.random(5)))
        low, high = storm_extreme(maxima, 3600.0, 10800.0, 0.9)["percentile_90_interval"]
        inside += low <= truth.over(3).quantile(0.9) <= high
    assert 0.85 < inside / 300 < 0.95  # 0.9 with three standard errors of 300 draws


def test_extremes_need_three_runs_that_differ_in_their_seed_alone(longline):
    runs = {f"{i}.npz": longline(tension=1000.0 + 10 * i) for i in range(3)}
    two = report_runs(dict(list(runs.items())[:2]))["extremes"]
    assert "2 run(s); needed: at least 3" in two["skipped"]
    whole = report_runs(runs)
    assert whole["extremes"]["tension of sock"]["runs"] == 3
    largest = [run.tension[1:, 11:].max() for run in runs.values()]
    assert whole["spread"]["values"]["tension of sock"]["by_run"] == largest
    same = report_runs(dict.fromkeys(runs, runs["0.npz"]))["extremes"]
    assert "same maximum" in same["skipped"]
    runs["0.npz"].settings["dt"] = 0.05
    assert "run.dt" in report_runs(runs)["extremes"]["skipped"]


def test_steps_that_follow_an_accuracy_are_not_reported_as_the_interval_of_samples(longline):
    equal = longline()
    equal.settings["dt"] = 0.02
    accurate = longline()
    accurate.settings.update(dt=0.1, accuracy=0.02)  # `dt` of such a run is the interval between saved states
    found = report_runs({"equal.npz": equal, "accurate.npz": accurate})
    assert found["spread"]["dt_s"] == [0.02, None]
    assert found["spread"]["accuracy"] == [None, 0.02]
    overview = [line.split(" | ")[-1] for line in report_markdown(found, [{}, {}]).splitlines() if "npz | ok" in line]
    assert overview == ["0.02 |", "by accuracy 0.02 |"]


# --- what is bad, and what reaches the disk -------------------------------------------------------------------------


def test_a_run_that_failed_is_reported_up_to_its_last_good_step(longline):
    solution = longline(status="non_finite", first_bad=None)
    solution.positions[40:] = np.nan
    solution.step_status[40:] = 2
    found = report_runs({"bad.npz": solution})
    (run,) = found["runs"]
    assert found["status"] == "non_finite"
    assert run["to_s"] == pytest.approx(3.9)
    assert any("invalid from t = 4" in note for note in run["notes"])
    assert np.isfinite(run["tension"][0]["max_n"]).all()


def decode(array):
    raw = base64.b64decode(array.text)
    (size,) = struct.unpack("<I", raw[:4])
    assert size == len(raw) - 4
    values = np.frombuffer(raw[4:], {"Float64": "<f8", "Int32": "<i4"}[array.get("type")])
    width = int(array.get("NumberOfComponents", 1))
    return values.reshape(-1, width) if width > 1 else values


def test_paraview_series_holds_the_links_of_every_line_and_no_link_between_lines(longline, tmp_path):
    solution = longline()
    series = ElementTree.parse(write_vtk(solution, tmp_path / "vtk", every=20)).getroot()
    sets = series.findall("./Collection/DataSet")
    assert sorted({float(s.get("timestep")) for s in sets}) == pytest.approx([0.0, 2.0, 4.0, 6.0])
    assert {s.get("part") for s in sets} == {"0", "1"}
    file = tmp_path / "vtk" / [s.get("file") for s in sets if s.get("part") == "0"][1]
    root = ElementTree.parse(file).getroot()
    assert (root.get("type"), root.get("byte_order")) == ("PolyData", "LittleEndian")
    arrays = {a.get("Name"): decode(a) for a in root.iter("DataArray")}
    np.testing.assert_array_equal(arrays["Points"], solution.positions[20])
    np.testing.assert_array_equal(arrays["tension"], solution.tension[20])
    np.testing.assert_array_equal(arrays["offsets"], 2 * np.arange(1, 18))
    ends = arrays["connectivity"].reshape(-1, 2)
    assert not {(4, 5), (8, 9), (13, 14)} & set(map(tuple, ends.tolist()))
    piece = root.find("./PolyData/Piece")
    assert (piece.get("NumberOfPoints"), piece.get("NumberOfLines")) == ("21", "17")
    buoys = ElementTree.parse(tmp_path / "vtk" / "buoys_000001.vtp").getroot()
    axis = decode(buoys.find(".//Points/DataArray"))
    np.testing.assert_allclose(axis[1] - axis[0], [0, 0, 3.0])


def test_command_writes_report_json_and_pictures(longline, tmp_path, capsys):
    file = longline().save(tmp_path / "run.npz")
    assert main(["report", str(file), "--report", str(tmp_path / "out"), "--json", "--slack", "5"]) == 0
    printed = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert (printed["schema"], printed["status"]) == (1, "ok")
    assert printed["settings"]["slack"]["value"] == 5.0
    assert json.loads((tmp_path / "out" / "report.json").read_text(), parse_constant=pytest.fail) == printed
    text = (tmp_path / "out" / "report.md").read_text()
    pictures = {p.name for p in (tmp_path / "out").glob("*.png")}
    assert pictures == {"tension_range.png", "anchors.png", "fatigue.png", "watch_circle.png", "along.png"}
    assert all(f"({name})" in text for name in pictures)
    assert "nan" not in text.lower().split()
    assert "anchor-a" in text


def test_report_of_a_failed_run_exits_with_3_and_the_reason(longline, tmp_path, printed):
    solution = longline(status="not_converged")
    file = solution.save(tmp_path / "run.npz")
    out = printed(["report", str(file), "--json"], 3)
    found = json.loads(out.out)
    assert found["status"] == "not_converged"
    assert "not_converged" in found["error"]
    assert found["error"] in out.err


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["missing.npz"], "missing.npz: cannot be read"),
        (["text.npz"], "text.npz: not a saved run"),
        (["run.npz", "run.npz"], "given twice"),
        (["run.npz", "other.npz"], "its lines differ from those of"),
        (["run.npz", "--curve-k", "0"], "--curve-k: 0 is out of range"),
        (["run.npz", "--skip", "-1"], "--skip: -1 is out of range"),
        (["run.npz", "--skip", "100"], "needed: at least 3"),
        (["run.npz", "--snap", "1", "--slack", "2"], "--snap: 1 is not above --slack"),
        (["run.npz", "--confidence", "1"], "--confidence: 1 is out of range"),
        (["run.npz", "--every", "0"], "--every: 0"),
        (["run.npz", "--report", "text.npz"], "--report: 'text.npz' is a file"),
    ],
)
def test_bad_input_is_refused_in_one_line(longline, made, tmp_path, refused, monkeypatch, more, words):
    monkeypatch.chdir(tmp_path)
    longline(samples=11).save(tmp_path / "run.npz")
    made("double-pendulum-periodic", np.zeros((11, 3, 3)), np.ones((11, 2))).save(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("no run")
    assert words in refused(["report", *more])


def test_no_runs_are_refused(refusal):
    assert refusal(report_runs, {}) == "solutions: are empty; needed: one run or more"


def test_a_load_that_some_runs_do_not_know_is_not_extrapolated():
    assert storm_extreme(np.array([0.0, 63.0, 0.0, 41.0]), 600.0, 10800.0, 0.9) == {
        "skipped": "no load at all in 2 of 4 runs"
    }
    assert "percentile_90" in storm_extreme(np.array([12.0, 63.0, 30.0, 41.0]), 600.0, 10800.0, 0.9)


@pytest.mark.parametrize(("samples", "counted"), [(3, 2), (2, 1), (1, 0)])
def test_the_message_of_too_few_samples_counts_those_that_are_evaluated(longline, samples, counted):
    solution = longline(samples=11)
    solution.positions[samples:] = np.nan
    with pytest.raises(SceneError, match=f": {counted} good samples after 0 s, without that of the start"):
        report_run(solution)
