"""Fits to channels of motions that SciPy integrated."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import rods
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax import as_toml
from fitting import fit_channels
from fitting.channels.fit import growth, warnings_of
from fitting.channels.make_problem import make_problem
from fitting.channels.observe import differentiate_channels, observe_channels, shift_setup
from fitting.channels.result import ChannelFit
from fitting.channels.sensors import projection
from fitting.channels.setup import setup_with_directions
from fitting.estimate.bootstrap import bootstrap
from fitting.estimate.profiles import profiles

MASS, LENGTH, DAMPING, DELAY, START = 0.2, 0.5, 0.04, 0.021, 0.8
T = np.arange(0.0, 4.0, 0.04)
CAMERA = {"name": "side", "position": [0.1, -3.0, -0.4], "look_at": [0.0, 0.0, -0.4], "focal": 900.0, "centre": [0, 0]}
NOISE = {"angle": 2e-3, "pull": 0.01, "dot": 0.5, "deep": 2e-3}
FREE = ["b_l", "channel.pull.gain", "camera.side.delay", "start.polar.0", "line.0.length"]
CHANNELS = [
    {"name": "angle", "kind": "angle", "column": "angle", "unit": "rad", "link": 1, "zero": "down"},
    {"name": "pull", "kind": "tension", "column": "pull", "unit": "N", "point": "pivot"},
    {"name": "dot", "kind": "pixel", "columns": ["u", "v"], "unit": "px", "end": "to", "camera": "side"},
    {"name": "deep", "kind": "depth", "column": "deep", "unit": "m", "at": LENGTH},
]


def swing(t, damping=DAMPING):
    """Angle and rate (2, k) of `theta'' = -g/L sin theta - b/m theta'`, let go at START."""
    rate = lambda _, y: [y[1], -9.81 / LENGTH * np.sin(y[0]) - damping / MASS * y[1]]  # noqa: E731
    return solve_ivp(rate, (0, 5), [START, 0], "DOP853", rtol=1e-11, atol=1e-12, dense_output=True).sol(t)


def scene(b_l=0.02, polar=0.75):
    return rods([polar], LENGTH, MASS, {"linear_damping": {"b_l": b_l}}) | {
        "run": {"dt": 0.01, "duration": 4.0, "integrator": "rattle_4"}
    }


def seen(rng, t=T, damping=DAMPING):
    """Columns of all channels, with noise; the load cell reads 3 % too much, the camera is started late."""
    theta, rate = swing(t, damping)
    late = np.maximum(t - DELAY, 0.0)
    bob = LENGTH * np.stack([np.sin(swing(late)[0]), 0 * late, -np.cos(swing(late)[0])], axis=1)
    matrix = projection(np.array(CAMERA["position"]), np.array(CAMERA["look_at"]), CAMERA["focal"], np.zeros(2))
    u, v, depth = (bob @ matrix[:, :3].T + matrix[:, 3]).T
    pull = 1.03 * MASS * (9.81 * np.cos(theta) + LENGTH * rate**2)
    clean = {"angle": theta, "pull": pull, "u": u / depth, "v": v / depth, "deep": LENGTH * np.cos(theta)}
    size = {**NOISE, "u": NOISE["dot"], "v": NOISE["dot"]}
    return {"t": t, **{name: y + size[name] * rng.normal(size=len(t)) for name, y in clean.items()}}


def table(columns):
    return {"run": [{"file": columns}], "channel": CHANNELS, "camera": [CAMERA]}


@pytest.fixture(scope="module")
def found():
    return fit_channels(table(seen(np.random.default_rng(0))), scene(), FREE, start={"line.0.length": 0.48})


@pytest.mark.slow
def test_four_kinds_of_channels_determine_damping_gain_delay_start_and_length(found):
    truth = {"b_l": DAMPING, "gain": 1.03, "delay": DELAY, "polar": START, "length": LENGTH}
    assert found.status == "ok"
    assert np.abs((found.values - list(truth.values())) / found.errors.std_error).max() < 3.5
    assert (found.errors.std_error / list(truth.values()) < [0.02, 0.01, 0.05, 0.002, 0.002]).all()
    assert found.errors.blocks == 0
    for row in found.channels():
        assert row["noise"] == pytest.approx(NOISE[row["name"]], rel=0.25)
    assert np.abs(found.step_bias).max() < 0.3
    fitted = found.fitted_scene()
    assert fitted.value("start.polar.0") == pytest.approx(found["start.polar.0"])
    assert dj.simulate(fitted).status == "ok"


@pytest.mark.check
def test_derivatives_are_those_of_differences_and_of_reverse_mode(found):
    problem, values = found.solution.problem, found.values
    at = setup_with_directions(problem.scenes[0], problem.data, problem.plain, values)
    times = tuple(jnp.asarray(t) for t in problem.data.runs[0].t)
    run = problem.near[0], jnp.asarray(problem.dt), times
    plan = problem.plan(0)
    _, slopes, _, _ = differentiate_channels(plan, at.setup, at.tangents, *run)
    plan = replace(plan, stepper=plan.stepper.plain)
    weights = [np.cos(np.arange(len(t)))[:, None] for t in times]

    @jax.jit
    def total(e):
        shown = observe_channels(plan, shift_setup(at.setup, at.tangents, e), *run)[0]
        return jnp.stack([jnp.sum(y * weight) for y, weight in zip(shown, weights, strict=True)])

    forward = np.array([np.einsum("ki,kjp->p", w, s) for w, s in zip(weights, slopes, strict=True)])
    reverse = np.asarray(jax.jit(jax.jacrev(total))(jnp.zeros(len(values))))
    assert np.allclose(forward, reverse, rtol=1e-8, atol=1e-8 * np.abs(forward).max())
    for i, step in enumerate(3e-4 * np.array([p.scale for p in problem.parameters])):
        along = step * np.eye(len(values))[i]
        near_by, far = (np.asarray(total(h * along) - total(-h * along)) / (2 * h * step) for h in (1.0, 2.0))
        difference = (4 * near_by - far) / 3
        assert np.allclose(forward[:, i], difference, rtol=1e-6, atol=1e-6 * np.abs(forward[:, i]).max())


@pytest.mark.check
def test_profile_and_bootstrap_agree_with_the_errors(found):
    """Ways to the same interval where the problem is nearly linear."""
    name = "effects.linear_damping.b_l"
    again = replace(found, profiles=profiles(found, ["b_l"]), bootstrap=bootstrap(found, 400).draws)
    i, (by_profile,) = [p.name for p in again.parameters].index(name), again.profiles
    low, high = again.errors.low[i], again.errors.high[i]
    width = high - low
    assert by_profile.converged
    assert (by_profile.low, by_profile.high) == pytest.approx((low, high), abs=0.05 * width)
    row = again.to_json()["bootstrap"][name]
    assert row["high"] - row["low"] == pytest.approx(width, rel=0.35)


@pytest.mark.slow
def test_the_command_line_writes_the_report_and_the_scene(tmp_path, json_of):
    columns = seen(np.random.default_rng(1))
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (tmp_path / "scene.toml").write_text(as_toml(scene()))
    given = {**table(columns), "run": [{"file": "run.csv"}]}
    (tmp_path / "data.toml").write_text(as_toml(given))
    asked = ["fit", str(tmp_path / "data.toml"), "--scene", str(tmp_path / "scene.toml"), "--json", "--quiet"]
    asked += ["--free", ",".join(FREE), "--start", "b_l=0.02", "--report", str(tmp_path / "report")]
    result = json_of(asked)
    assert result["method"] == "channels"
    one = result["parameters"]["effects.linear_damping.b_l"]
    assert abs(one["value"] - DAMPING) < 3.5 * one["std_error"]
    fitted = dj.load_scene(tmp_path / "report" / "fitted.toml")
    assert fitted.value("effects.linear_damping.b_l") == pytest.approx(one["value"], rel=1e-12)
    assert (tmp_path / "report" / "channels_1.png").stat().st_size > 10_000
    assert "## Sensitivity" in (tmp_path / "report" / "report.md").read_text()


@pytest.mark.check
def test_runs_with_a_damping_of_their_own_share_the_rest():
    rng = np.random.default_rng(2)
    true = [0.036, 0.044, 0.04]
    runs = [{"file": seen(rng, damping=b), "name": f"r{i}"} for i, b in enumerate(true)]
    only = [c for c in CHANNELS if c["name"] in ("angle", "deep")]
    data = {"run": runs, "channel": only}
    found = fit_channels(data, scene(polar=START), ["line.0.length"], own=["b_l"], check_step=False)
    assert found.status == "ok"
    names = [p.name for p in found.parameters]
    assert names == ["line.0.length.0", *(f"effects.linear_damping.b_l@r{i}" for i in range(3))]
    assert np.abs((found.values[1:] - true) / found.errors.std_error[1:]).max() < 3.5
    (over,) = found.between
    assert over.mean == pytest.approx(np.mean(found.values[1:]), rel=0.01)
    assert over.spread == pytest.approx(0.004, rel=0.5)
    assert found.fitted_scene(1).value("effects.linear_damping.b_l") == pytest.approx(found.values[2])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"free": ["channel.pul.gain"]}, "free: 'channel.pul.gain': 'pul' is not a channel; did you mean 'pull'"),
        ({"free": ["channel.pull.scale"]}, "does not exist; allowed: channel.pull and offset, gain, delay"),
        ({"free": ["channel.dot.offset.2"]}, "has no such column; allowed: 0 to 1"),
        ({"free": ["camera.front.delay"]}, "'front' is not a camera"),
        ({"free": ["camera.offset"]}, "camera"),
        ({"free": ["marker.offset"]}, "is for traces of angles"),
        ({"free": ["start.azimut.0"]}, "is not given in the scene's start"),
        ({"free": ["start.polar.1"]}, "has no such entry; allowed: below 1"),
        ({"free": ["b_l", "b_l"]}, "is given twice"),
        ({"free": []}, "free: nothing is free"),
        ({"priors": {"b_l": (0.02, 0.0)}}, "linear_damping.b_l' has standard deviation 0; allowed: > 0"),
        ({"priors": {"mass": (0.02, 1.0)}}, "prior: 'line.0.mass' is not a free parameter"),
        ({"bounds": {"b_l": (0.3, 0.2)}}, "empty interval 0.3 to 0.2"),
        ({"start": {"b_l": -1.0}}, "start: effects.linear_damping.b_l = -1 is out of bounds"),
        ({"own": ["b_l"], "free": ["line.0.length"]}, "own: 'b_l': there is only one run"),
    ],
)
def test_mistakes_are_named(more, message, refusal):
    given = {"free": ["b_l"], "own": [], "start": {}, "bounds": {}, "priors": {}, **more}
    assert message in refusal(make_problem, table(seen(np.random.default_rng(0))), dj.load_scene(scene()), **given)


def test_a_run_lasts_until_the_last_sample_whose_camera_and_channel_are_both_early():
    given = table(seen(np.random.default_rng(0)))
    given["camera"] = [{**CAMERA, "delay": -0.5}]
    given["channel"] = [{**channel, "delay": -0.4} for channel in CHANNELS]
    problem = make_problem(given, dj.load_scene(scene()), ["b_l"], [], {}, {}, {})
    assert problem.plan(0).saves * problem.dt >= T[-1] + 0.9


def test_a_point_behind_its_camera_is_named(refusal):
    """The camera looks away from the pendulum."""
    data = table(seen(np.random.default_rng(0)))
    data["camera"] = [{**CAMERA, "look_at": [0.1, -6.0, -0.4]}]
    line = refusal(fit_channels, data, scene(), ["b_l"])
    assert "fails, run_0: channel 'dot' at 0 s: its point is behind its camera (move the camera" in line


def test_growth_of_derivatives_is_seen(found):
    """Derivatives that grow as exp(20 t/T): from the last of the middle fifth to the last sample in 40 of 99 steps."""
    slopes = np.exp(20 * np.linspace(0, 1, 100))[:, None, None]
    e = found.solution.evaluation
    assert growth(e) < 10
    assert growth(e._replace(slopes=((slopes,),))) == pytest.approx(np.exp(20 * 40 / 99), rel=1e-9)
    assert growth(e._replace(slopes=((slopes * np.nan,),))) == np.inf


@pytest.mark.parametrize(
    ("ratio", "kept", "words"),
    [
        (1.0, 0.9, ""),
        (1.7, 0.1, ""),  # a sensor that is worse than claimed
        (1.7, 0.7, "keep 70% from sample to sample: the model misses part of the motion"),
        (3.0, 0.0, "residuals are 3 times the noise of its sensor"),
    ],
)
def test_smooth_residuals_above_the_noise_of_the_sensor_are_warned_of(found, monkeypatch, ratio, kept, words):
    row = {"name": "dot", "noise": ratio * NOISE["dot"], "noise_claimed": NOISE["dot"], "kept": kept}
    monkeypatch.setattr(ChannelFit, "channels", lambda _: [row])
    texts = [text for text in warnings_of(found) if text.startswith("channel dot")]
    assert len(texts) == bool(words)
    assert all(words in text for text in texts)
