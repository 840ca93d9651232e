"""Measured free swings (Kaheman et al., arXiv 2205.06231): calibrated on the first part, judged on what comes after.

The traces are no part of the project: DROPPER_MEASURED_DATA names their folder, without it these tests are skipped.
"""

import json
import os
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import integrate, make_stepper
from fitting import FitSettings, fit, fit_and_free, read_trace
from fitting.traces import planar

FOLDER = os.environ.get("DROPPER_MEASURED_DATA", "")
FILE, DOUBLE = (Path(FOLDER) / f"{rig}_pendulum.csv" for rig in ("single", "double"))
pytestmark = pytest.mark.skipif(
    not (FOLDER and FILE.is_file() and DOUBLE.is_file()),
    reason="DROPPER_MEASURED_DATA names no folder with single_pendulum.csv and double_pendulum.csv",
)
RESULTS = Path(__file__).parents[3] / "benchmarks" / "results"

DOWN = FitSettings(zero="down", sign=1, unit="rad")
#: Errors of the published parameters on the two held-out windows [rad], initial state free.
PUBLISHED = (0.0067, 0.0129)
UNTIL, HELD_OUT = 36.668, [(36.668, 45.834), (45.834, 55.0)]
DOUBLE_SPANS = [(69.342 + 2.6645 * k, 69.342 + 2.6645 * (k + 1)) for k in range(4)]
DOUBLE_PUBLISHED = (0.0023, 0.0024, 0.0022, 0.0021)


@pytest.mark.check
def test_the_measured_single_pendulum_is_predicted_better_than_by_its_published_parameters():
    """At most 0.6 of the published parameters' error, every damping coefficient held non-negative."""
    trace = read_trace(FILE)
    trace = replace(trace, t=trace.t[::4], theta=trace.theta[::4])  # 125 Hz: a quarter of the work
    free = ["line.0.inertia", "viscous", "dry", "b_q", "camera.offset"]
    settings = replace(DOWN, window=9.16, dt=0.008)
    spans = {"until": UNTIL, "held_out": HELD_OUT}
    result = fit(trace, "measured-single-pendulum", free, method="windows", settings=settings, **spans)
    assert result.status == "ok"
    assert result.windows.times().max() < UNTIL
    assert np.mean([held.rms for held in result.held_out]) < 0.6 * np.mean(PUBLISHED)
    assert all(result[p.name] >= 0 for p in result.parameters if p.name.startswith("effects."))
    assert result["effects.joint_friction.dry"] > 3 * result.uncertainty.std_error[2]
    assert result["line.0.inertia.0"] == pytest.approx(1.09119e-4, rel=0.1)  # as published


#: File, scene, end of the fitted part [s], held-out spans [s] and the published parameters' errors on them [rad].
SINGLE_RIG = (FILE, "measured-single-pendulum", UNTIL, HELD_OUT, PUBLISHED)
DOUBLE_RIG = (DOUBLE, "measured-double-pendulum", 69.342, DOUBLE_SPANS, DOUBLE_PUBLISHED)


@pytest.mark.check
@pytest.mark.parametrize(
    ("file", "scene", "until", "spans", "published", "part"), [(*SINGLE_RIG, 0.6), (*DOUBLE_RIG, 0.5)]
)
def test_a_rig_that_declares_its_unknowns_needs_no_list(file, scene, until, spans, published, part):
    """As the command without `--free` does: parts of the published parameters' held-out error."""
    result = fit(file, scene, until=until, held_out=spans)
    assert result.status == "ok"
    assert result.windows.times().max() < until
    assert np.mean([held.rms for held in result.held_out]) < part * np.mean(published)
    inertia = next(i for i, p in enumerate(result.parameters) if p.name.startswith("line.0.inertia"))
    assert result.uncertainty.std_error[inertia] > 0.003 * result.values[inertia]  # angles determine no scale of mass


@pytest.mark.check
def test_a_rig_without_fit_gets_the_drag_that_its_scene_lacks():
    """The packaged scene has the friction of a bearing alone; its default parameters miss the trace without drag."""
    table = dj.load_scene("measured-single-pendulum").to_dict()
    del table["fit"]
    trace = read_trace(FILE)
    trace = replace(trace, t=trace.t[::2], theta=trace.theta[::2])
    result = fit(trace, table, until=UNTIL, held_out=HELD_OUT, settings=DOWN)
    assert result.status == "ok"
    assert [test.name for test in result.freed] == ["quadratic drag"]
    assert np.mean([held.rms for held in result.held_out]) < 0.6 * np.mean(PUBLISHED)


@pytest.mark.check
@pytest.mark.parametrize(
    ("file", "name", "until", "spans", "published", "part"), [(*SINGLE_RIG, 0.66), (*DOUBLE_RIG, 0.29)]
)
def test_a_rig_of_which_nothing_is_stated_is_freed_in_groups(file, name, until, spans, published, part):
    """Without `[fit]`: no list of what is open, no priors, no sensors."""
    table = dj.load_scene(name).to_dict()
    del table["fit"]
    result = fit_and_free(file, table, until=until, held_out=spans, settings=DOWN)
    assert result.status in ("ok", "misfit")
    assert all(held.windows.count == 1 for held in result.held_out)
    assert not any("outliers" in candidate.name for candidate in result.freed)
    assert np.mean([held.rms for held in result.held_out]) <= part * np.mean(published)


@pytest.mark.check
def test_thirds_of_the_double_pendulum_differ_as_their_errors_say():
    trace = read_trace(DOUBLE)
    edges = np.linspace(trace.t[0], trace.t[-1] + trace.interval, 4)
    parts = [trace.between(low, high) for low, high in zip(edges, edges[1:], strict=False)]
    fits = [fit(part, "measured-double-pendulum", settings=DOWN) for part in parts]
    off = [
        np.abs(a.values - b.values) / np.maximum(np.hypot(a.uncertainty.std_error, b.uncertainty.std_error), 1e-300)
        for a, b in combinations(fits, 2)
    ]
    assert np.mean(np.concatenate(off) < 2) >= 0.85
    assert np.mean(np.concatenate(off) < 3) >= 0.95


@pytest.mark.check
def test_the_calibrated_double_pendulum_predicts_what_its_fit_has_not_seen():
    """The committed coefficients, simulated forwards only, the start of each held-out window found by differences.

    At most 0.65 of the published parameters' error. (The fit itself takes a minute to compile: benchmarks.)
    """
    found = json.loads((RESULTS / "measured_double_pendulum.json").read_text())
    trace = read_trace(DOUBLE)
    dt, every = trace.interval, 5
    run = jax.jit(jax.vmap(lambda y: swing(calibrated(found), y, dt, every, WINDOW_SAMPLES)))
    errors = []
    for low, _ in found["held_out_s"]:
        first = int(np.searchsorted(trace.t, low - 1e-9))
        measured = np.pi / 2 - trace.theta[first : first + every * WINDOW_SAMPLES : every]
        start = np.concatenate([measured[0], (measured[1] - measured[0]) / (every * dt)])
        for _ in range(6):
            rest = np.asarray(planar.wrap(run(start + 1e-6 * np.eye(5, 4, -1)) - measured)).reshape(5, -1)
            start = start - np.linalg.lstsq((rest[1:] - rest[0]).T / 1e-6, rest[0], rcond=None)[0]
        errors.append(float(np.sqrt(np.mean(rest[0] ** 2))))
    assert found["fitted_before_s"] <= found["held_out_s"][0][0]
    assert np.mean(errors) < 0.65 * np.mean(DOUBLE_PUBLISHED)
    assert np.mean(errors) == pytest.approx(np.mean(found["held_out_rad"]), rel=0.1)


#: Samples of a held-out window of 2.66 s at 50 Hz.
WINDOW_SAMPLES = 133


def calibrated(found):
    """The packaged scene's model with the fitted numbers."""
    scene = dj.load_scene("measured-double-pendulum")
    line = scene.to_dict()["line"][0]
    fitted = {name: p["value"] for name, p in found["fit"]["parameters"].items()}
    friction = {key: [fitted[f"effects.joint_friction.{key}.{i}"] for i in (0, 1)] for key in ("viscous", "dry")}
    values = {f"effects.joint_friction.{key}": [*pair, 0.0] for key, pair in friction.items()}
    values["effects.quadratic_damping.b_q"] = fitted["effects.quadratic_damping.b_q"]
    values["line.0.inertia"] = [fitted["line.0.inertia.0"], fitted["line.0.inertia.1"]]
    values["line.0.centre_of_mass"] = [line["centre_of_mass"][0], fitted["line.0.centre_of_mass.1"]]
    return dj.build(scene.with_values(values))[0]


def swing(model, start, dt, every, samples):
    """Angles (samples, 2) from angles and rates (4,), one every `every` steps."""
    stepper = make_stepper(model, "energy_momentum", track_work=False)
    _, run = integrate(stepper, model, planar.to_state(model, start[:2], start[2:]), dt, every * (samples - 1), every)
    angles, _ = jax.vmap(lambda r, v: planar.from_nodes(model, r, v))(run.r, run.v)
    return jnp.concatenate([start[None, :2], angles])
