"""Sweeps scored against a trace: the truth is SciPy's (`benchmarks/closed_chain.py`), scores those of sines."""

from dataclasses import replace

import numpy as np
import pytest
from closed_chain import Chain
from hard_scenes import single_line

import dropper_jax as dj
from dropper_jax import SceneError, as_toml
from fitting import Convention, Trace, write_trace
from fitting.sweep import sweep_against_trace
from fitting.sweep.against_trace import part_ends
from fitting.sweep.scores import Against, FittedScore

pytest.importorskip("zarr")

LENGTH, MASS, SPAN = np.array([0.1, 0.12, 0.1, 0.12]), [0.03, 0.04, 0.03, 0.04], 0.28
RATE, DURATION, NOISE = 60.0, 3.0, 0.005
PAIRS = {"b_l": [0.001, 0.002, 0.01, 0.002, 0.05], "b_q": [0.5, 0.1, 0.001, 0.01, 0.03]}


def chain(b_l, b_q):
    return Chain(LENGTH, np.array(MASS[:-1]), np.array([SPAN, 0.0]), b_l, b_q)


@pytest.fixture(scope="module")
def scene():
    still = chain(0.0, 0.0)
    polar = still.angles(still.pose(np.array([0.2, 1.4, 0.0, -1.0])))
    effects = {"weight": {}, "linear_damping": {"b_l": 0.001}, "quadratic_damping": {"b_q": 0.001}}
    start = {"kind": "angles", "zero": "horizontal", "polar": polar.tolist()}
    return dj.load_scene({"name": "short-chain"} | single_line(LENGTH, MASS, start, [SPAN, 0.0, 0.0], effects))


@pytest.fixture(scope="module")
def truth(scene):
    """`truth(case)`: a noisy trace whose truth is a pair of the list."""

    def make(case):
        one = chain(PAIRS["b_l"][case], PAIRS["b_q"][case])
        t = np.arange(round(DURATION * RATE) + 1) / RATE
        theta = one.angles(one.swing(np.asarray(scene.to_dict()["start"]["polar"]), t))
        theta = theta + NOISE * np.random.default_rng(case).standard_normal(theta.shape)
        return Trace(f"truth-{case}", t, theta, convention=Convention("horizontal", 1, "rad"))

    return make


@pytest.fixture(scope="module")
def scored(scene, truth, tmp_path_factory):
    """`scored(case)`: the list against a truth; all truths have one folder, so that the cases run once."""
    out = tmp_path_factory.mktemp("pairs") / "pairs.zarr"
    return lambda case: sweep_against_trace(scene, PAIRS, truth(case), out, listed=True, chunk=8, quantities=[])


@pytest.mark.check
@pytest.mark.parametrize("case", [0, 2, 3])
def test_the_true_pair_has_the_best_head_and_its_error_is_the_noise(scored, case):
    found = scored(case)
    assert found.best == found.best_of(0) == case
    samples = 4 * len(found.against.t[found.against.part(0)])
    assert found.angle[case, 0] == pytest.approx(NOISE, rel=4 / np.sqrt(2 * samples))
    assert found.sweep.plan.scene.run.dt == pytest.approx(1 / 120)  # divides the samples' interval, at most the scene's


@pytest.mark.check
def test_a_run_at_values_of_a_case_has_its_score(scored):
    found = scored(2)
    fit = FittedScore.of(found, "ok", np.array([0.01, 0.001]), np.array([1e-4, 1e-5]))
    np.testing.assert_allclose(fit.angle, found.angle[2], rtol=1e-9)
    np.testing.assert_allclose(fit.spectrum, found.spectrum[2], rtol=1e-9)
    assert fit.to_json()["values"] == {"effects.linear_damping.b_l": 0.01, "effects.quadratic_damping.b_q": 0.001}


def test_scores_are_those_of_sines():
    """Sines on a bin differ by |a - b|/sqrt(2); Hann's window has 1, 1/2 and 1/2 of their amplitudes: sqrt(3/4)."""
    t = (1 + np.arange(400)) / 40.0
    sine = np.sin(2 * np.pi * 2.0 * t)[:, None] * np.ones(2)
    trace = Trace("sines", t, 0.3 * sine)
    against = Against(trace, t, 0.3 * sine, 0.3 * sine, (2.5, 5.0, 10.0))
    for simulated, part in ((0.1 * sine, range(3)), (0.1 * sine + 2 * np.pi, range(3))):
        angle, spectrum = against.score(simulated)
        for i in part:
            assert angle[i] == pytest.approx(0.2 / np.sqrt(2), rel=1e-2)  # parts begin a sample off a bin
            assert spectrum[i] == pytest.approx(0.2 * np.sqrt(0.75), rel=1e-2)
    assert np.isnan(against.score(np.where(t[:, None] > 9.0, np.nan, sine))).all()
    assert part_ends(t, None) == pytest.approx((2.4, 5.0, 10.0))


def test_a_part_that_ends_before_the_trace_is_refused():
    with pytest.raises(SceneError, match="parts: -1,2: allowed: two increasing times"):
        part_ends(np.linspace(0.1, 3.0, 60), (-1.0, 2.0))


@pytest.mark.parametrize(("part", "first", "last"), [("head", 0.0, 0.73), ("middle", 0.72, 1.51), ("tail", 1.5, 3.1)])
def test_a_part_without_a_sample_is_refused_before_any_run(scene, truth, tmp_path, part, first, last):
    whole = truth(0)
    missing = (whole.t >= first) & (whole.t < last)
    trace = replace(whole, theta=np.where(missing[:, None], np.nan, whole.theta))
    with pytest.raises(SceneError, match=f"every sample of the {part} is missing"):
        sweep_against_trace(scene, PAIRS, trace, tmp_path / "pairs.zarr", listed=True)
    assert not (tmp_path / "pairs.zarr").exists()


@pytest.mark.check
def test_the_command_prints_scores_and_draws_them(scene, truth, scored, tmp_path, json_of):
    found, file = scored(3), write_trace(tmp_path / "truth.csv", truth(3))
    (tmp_path / "scene.toml").write_text(as_toml(scene.as_written()))
    vary = [f"--vary={name}={','.join(map(str, values))}" for name, values in PAIRS.items()]
    call = ["sweep", str(tmp_path / "scene.toml"), "--paired", *vary, f"--trace={file}", f"--out={found.sweep.path}"]
    trace = json_of([*call, f"--plot={tmp_path / 'p'}", "--json", "--quiet"])["trace"]
    assert trace["best"]["head"]["angle"] == 3
    assert trace["cases"][3]["head"]["angle_rms_rad"] == pytest.approx(found.angle[3, 0], rel=1e-6)
    assert {path.stem for path in (tmp_path / "p").iterdir()} == {"scores", "curves", "spectra"}


#: A trace with other names of columns, and one more.
RENAMED = "when,a,b,c,d,more\n" + "".join(
    f"{i / 60:.6f},{np.sin(i / 9):.6f},{np.sin(i / 8):.6f},{np.cos(i / 7):.6f},{np.cos(i / 6):.6f},x\n"
    for i in range(181)
)


NAMED = "--columns=time=when,theta_1=a,theta_2=b,theta_3=c,theta_4=d"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("t,theta_1,theta_2\n0,1,1\n", [], "other.csv: has 2 columns theta_1..n, but the scene has 4 links"),
        ("t,angle\n0,1\n", [], "rename to t, theta_1 ... theta_4, or --columns theta_1=angle,..."),
        (RENAMED, [NAMED, "--parts=2,1"], "parts: 2,1: allowed: two increasing times within the trace's 3 s"),
        (RENAMED, ["--columns=time=when,theta_1=z"], "columns: 'z' is not in other.csv; known: a, b, c, d, more, when"),
        (None, ["--parts=1"], "parts: 1: allowed: two increasing times"),
        (None, ["--vary=start.polar.0=0.1", "--fit"], "--fit: 'start.polar.0' cannot be fitted; allowed: parameters"),
        (None, ["--parts=a,b"], "--parts: 'a,b' is not T1,T2; allowed: two times in s"),
        (None, ["--vary=point.1.position.0=0.2,0.3"], "vary: 'point.1.position.0' moves an end. With a trace, use"),
    ],
)
def test_wrong_traces_lists_and_parts_are_one_line(scene, truth, text, options, message, tmp_path, printed):
    (tmp_path / "scene.toml").write_text(as_toml(scene.as_written()))
    file = write_trace(tmp_path / "other.csv", truth(0))
    if text:
        file.write_text(text)
    call = ["sweep", str(tmp_path / "scene.toml"), f"--out={tmp_path / 'o.zarr'}", f"--trace={file}", "--quiet"]
    vary = [] if any("--vary" in option for option in options) else ["--vary=b_l=0.1,0.2"]
    (line,) = (line for line in printed([*call, *vary, *options], 2).err.splitlines() if line.startswith("error: "))
    assert message in line


def test_options_of_a_trace_need_one(scene, tmp_path, printed):
    (tmp_path / "scene.toml").write_text(as_toml(scene.as_written()))
    call = ["sweep", str(tmp_path / "scene.toml"), f"--out={tmp_path / 'o.zarr'}", "--vary=b_l=0.1", "--fit"]
    assert "--fit: requires --trace FILE.csv" in printed(call, 2).err
