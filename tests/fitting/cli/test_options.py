"""Options of the commands that work with traces, before anything is fitted."""

from argparse import Namespace

import numpy as np
import pytest

from dropper_jax import SceneError, load_scene
from fitting import Convention, Trace, write_trace
from fitting.cli import sweep
from fitting.cli.fit import check_intervals
from fitting.cli.fit_file import column_names, traces_for

SCENE = "dropper-release-a"


@pytest.mark.parametrize("text", ["=angle", "", "time=", "time", "time=t,=angle"])
def test_a_column_without_a_name_or_a_name_without_a_column_is_refused(refusal, text):
    assert "is not NAME=COLUMN; allowed: time=COLUMN" in refusal(column_names, text)


def test_columns_are_named_with_or_without_spaces():
    assert column_names("time=timestamp, theta_1 = angle") == {"time": "timestamp", "theta_1": "angle"}


def test_the_delay_of_a_recording_has_a_profile_although_only_its_file_names_it():
    args = Namespace(bootstrap=None, profile=["recording.B.delay"], free=None, own=[], fixed=False, same_motion=True)
    check_intervals(args, load_scene(SCENE))
    args.same_motion = False
    with pytest.raises(SceneError, match=r"profile: 'recording\.B\.delay' is not a free parameter"):
        check_intervals(args, load_scene(SCENE))


def test_a_unit_is_refused_for_a_trace_together_with_a_file_of_another_program(tmp_path, refusal):
    """The other file is in radians once it is read, so that the unit would count for neither."""
    scene = load_scene("measured-single-pendulum")
    t = np.arange(0.0, 12.0, 0.02)
    swing = 20.0 * np.exp(-0.02 * t) * np.cos(4.4 * t)
    trace = Trace("mine", t, swing[:, None], convention=Convention("down", 1, "deg"))
    write_trace(tmp_path / "mine.csv", trace)
    rows = "\n".join(f"{time:.3f},{angle:.4f}" for time, angle in zip(t, swing, strict=True))
    (tmp_path / "other.csv").write_text(f"Time (s),Angle (deg)\n{rows}\n")
    names = [str(tmp_path / name) for name in ("mine.csv", "other.csv")]
    args = Namespace(
        traces=names, rate=None, counts=None, columns=None, mass=None, lengths=None, unit=None, since=None,
        same_motion=False,
    )  # fmt: skip
    traces, notes = traces_for(args, scene)
    assert traces[0] == names[0]
    assert notes
    args.unit = "deg"
    assert "mine.csv' and files of other programs. State it there: # unit=rad or deg" in refusal(
        traces_for, args, scene
    )


def test_a_sweep_against_a_trace_in_which_every_case_failed_is_printed():
    missing = {"angle_rms_rad": None, "spectrum_rad": None}
    trace = {
        "parts_s": {"head": (0.0, 1.0)},
        "cases": [{"values": {"effects.linear_damping.b_l": 1.0}, "head": missing}],
    }
    found = {
        "counts": {"ok": 0, "failed": 1}, "scene": SCENE, "cases": 1, "steps_per_case": 10, "resumed": 0,
        "compile_s": 1.0, "run_s": 1.0, "steps_per_s": 10.0, "status": "failed", "out": "x.zarr", "trace": trace,
    }  # fmt: skip
    assert "1 failed" in sweep.text(found)
