"""`dropper demo` ends with a calibration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import rods

from dropper_jax import plots
from dropper_jax.cli import demo
from fitting.report import example
from fitting.report import report as fit_report

PENDULUM = rods([np.pi / 2], effects={"linear_damping": {"b_l": 0.0}, "quadratic_damping": {"b_q": 0.0}})


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(demo, "DURATION", 0.5)
    monkeypatch.setattr(demo, "SCENE", PENDULUM)
    monkeypatch.setattr(demo, "draw", lambda solution, folder: [])  # tested elsewhere, seconds each
    monkeypatch.setattr(fit_report, "PICTURES", {})
    monkeypatch.setattr(plots, "animate", lambda *args, **kwargs: None)
    few = replace(example.EXAMPLE, scenes=(PENDULUM,), b_l=0.1, b_q=0.05, duration=16.0)
    monkeypatch.setattr(example, "EXAMPLE", few)
    return few


@pytest.mark.check
@pytest.mark.slow
def test_the_demo_ends_with_a_calibration_marked_as_synthetic(short, tmp_path, printed):
    out, err = printed(["demo", "--out", str(tmp_path), "--json"])
    found = json.loads(out)["calibration"]
    assert found["status"] == "ok"
    assert found["synthetic"] is True
    assert found["warnings"][0].startswith("the traces are synthetic")
    for name, truth in short.truth.items():
        fitted = found["parameters"][name]
        assert found["start"][name] == pytest.approx(10 * truth)
        assert abs(fitted["value"] - truth) < 4 * fitted["std_error"] < 0.5 * truth
    text = (tmp_path / "report.md").read_text()
    assert "traces are synthetic" in text
    assert "calibration/report.md" in text
    assert (tmp_path / "calibration" / "report.md").exists()
    assert len(list((tmp_path / "calibration").glob("synthetic-*.csv"))) == 1
    assert "100 % ok" in err
