"""Lines that break, against closed forms: free fall after a cut, the step of a load, the energy that is lost."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_weight

from dropper_jax import SceneError, build, build_model, integrate, load_scene, make_stepper, report_run, simulate, state
from dropper_jax.cli.run_text import text
from dropper_jax.model import as_parted
from dropper_jax.residual.breaking import break_links
from fitting.sensitivity import study, window_means
from fitting.sweep import open_sweep, sweep

G, MASS, LENGTH, EA = 9.81, 100.0, 10.0, 4e4
OMEGA = np.sqrt(EA / (LENGTH * MASS))
HEAVY = ("weight", "point_bodies")  # effects that know gravity


def hanging(links=2, *entries, **more):
    """A weight on a light line that stretches; `entries` are its failures."""
    kind = {"mass": 1e-3, "diameter": 0.03, "EA": EA}
    return hung_weight(MASS, kind, LENGTH, links, failure=[dict(entry) for entry in entries], **more)


@partial(jax.jit, static_argnums=0)
def run(stepper, model, s, dt, gravity):
    """400 steps: end, path, and slope of the weight's last velocity to gravity; one program for all runs."""

    def fall(gravity):
        heavy = tuple(replace(e, gravity=gravity) if e.name in HEAVY else e for e in model.effects)
        end, path = integrate(stepper, replace(model, effects=heavy), s, dt, 400)
        return end.v[-1, 2], (end, path)

    _, slope, (end, path) = jax.jvp(fall, (gravity,), (1.0,), has_aux=True)
    return end, path, slope


@pytest.fixture(scope="module")
def cut():
    """The weight at rest, cut off in the link above it at 0.5 s."""
    return simulate(hanging(2, {"line": "rope", "link": 2, "time": 0.5}))


def test_a_weight_that_is_cut_off_falls_freely_from_the_end_of_that_step(cut):
    assert cut.status == "ok", cut.failure
    weight = cut.point_path("weight")[:, 2]
    since = np.maximum(cut.t - 0.5, 0.0)
    np.testing.assert_allclose(weight, weight[0] - 0.5 * G * since**2, rtol=0, atol=1e-9)
    # momentum: weight times time, no impulse from the line
    np.testing.assert_allclose(cut.velocities[:, -1, 2], -G * since, rtol=0, atol=1e-9)
    np.testing.assert_allclose(cut.tension[cut.t > 0.505, 1], 0.0, atol=1e-9)


def test_energy_balance_closes_with_the_stretch_of_the_broken_link_as_lost(cut):
    lost = dict(zip(cut.work_names, cut.work[-1], strict=True))["breaking"]
    half = MASS + 0.25e-2  # the weight and half a link of 5 m
    assert lost == pytest.approx(-0.5 * (half * G) ** 2 * 5.0 / EA, rel=1e-6)
    assert cut.energy_drift < 1e-9 * cut.energy_scale


def test_what_broke_is_in_the_summary_the_warnings_and_the_report(cut):
    (row,) = cut.summary()["broken"]
    assert (row["line"], row["link"]) == ("rope", 2)
    assert row["time_s"] == pytest.approx(0.5)
    assert row["tension_n"] == pytest.approx(MASS * G, rel=1e-4)
    assert any("broke at its link 2 at t = 0.5 s" in line for line in cut.warnings)
    assert "broke at its link 2" in text(cut)
    found = report_run(cut)
    assert found["broken"] == [row]
    assert any("broke at its link 2" in note for note in found["notes"])


@pytest.fixture(scope="module")
def swinging():
    """Weight let go unstretched, which swings about its rest; model whose one entry takes any load and time."""
    model, s = build(hanging(2, {"line": "rope", "link": 2, "load": 1.0}, start={"kind": "points"}))
    return model, s, make_stepper(model).plain


def failing(model, load=jnp.inf, time=jnp.inf):
    """The model with another load and time of its entry."""
    whole = model.line.failures
    other = replace(whole, load=jnp.where(jnp.isfinite(whole.load), load, jnp.inf), time=jnp.full(1, time))
    return replace(model, lines=(replace(model.line, failures=other),))


def test_a_line_breaks_at_the_end_of_the_first_step_that_reaches_its_load(swinging):
    # T = m g (1 - cos w t), v = -(g/w) sin w t
    model, s, stepper = swinging
    load, dt = 1.5 * MASS * G, 0.001
    end, path, _ = run(stepper, failing(model, load=load), s, dt, G)
    _, unbroken, _ = run(stepper, failing(model), s, dt, G)
    step = int(np.argmax(unbroken.tension[:, 1] >= load))
    assert float(end.parted.t[0]) == pytest.approx((step + 1) * dt, rel=1e-12)
    np.testing.assert_array_equal(path.r[: step + 1], unbroken.r[: step + 1])
    expected = np.arccos(1 - 1.5) / OMEGA
    assert float(end.parted.t[0]) == pytest.approx(expected, abs=2 * dt)
    fall = G / OMEGA * np.sin(OMEGA * expected) + G * (400 * dt - expected)
    assert float(path.v[-1, -1, 2]) == pytest.approx(-fall, rel=1e-2)  # swings are damped a little


def test_gradient_through_a_cut_at_a_given_time_is_that_of_swing_and_fall(swinging):
    model, s, stepper = swinging
    cut = failing(model, time=0.1)
    slope = float(run(stepper, cut, s, 0.001, G)[2])
    # v = -(g/w) sin w t until the cut, -g t from there on
    assert slope == pytest.approx(-np.sin(OMEGA * 0.1) / OMEGA - 0.3, rel=5e-3)  # the scheme's own error
    ahead, behind = (run(stepper, cut, s, 0.001, G + d)[0].v[-1, 2] for d in (1e-4, -1e-4))
    assert slope == pytest.approx(float(ahead - behind) / 2e-4, rel=1e-6)


def test_the_link_nearest_to_its_load_breaks_and_only_that_one():
    model = build_model(load_scene(hanging(4, {"line": "rope", "load": 500.0})))
    s = replace(state(model, np.zeros((4, 3))), work=jnp.zeros(0))

    parted = []
    for tension in ([400.0, 499.9, 300.0, 0.0], [510.0, 501.0, 530.0, 500.0], [900.0, 900.0, 0.0, 900.0]):
        before = as_parted(model, s.parted)
        s = break_links(model, before, s, replace(s, tension=jnp.asarray(tension), t=s.t + 0.5))
        parted.append((int(s.parted.link[0]), float(s.parted.t[0]), float(s.parted.tension[0])))
    assert parted == [(-1, 0.0, 0.0), (2, 1.0, 530.0), (2, 1.0, 530.0)]
    np.testing.assert_array_equal(before.line.axial.intact, [1.0, 1.0, 0.0, 1.0])  # as the third step sees it


def test_a_link_that_parts_bends_nothing_and_its_bending_is_lost():
    stiff = {"weight": {"gravity": G}, "bending": {"EI": 300.0}}
    model = build_model(load_scene(hanging(4, {"line": "rope", "link": 2, "time": 0.5}, effects=stiff)))
    angles = np.array([0.1, 0.4, 0.9, 1.2])
    links = 2.6 * np.stack([np.sin(angles), np.zeros(4), -np.cos(angles)], axis=1)
    s = state(model, np.cumsum(links, axis=0))
    after = break_links(model, as_parted(model, s.parted), s, replace(s, t=s.t + 1.0))
    # links of 2.5 m, stretched by 0.1 m: EA e^2/(2 L); EI/(2 l) |q2 - q1|^2 = (EI/l) (1 - cos) at both its joints
    bent = 300.0 / 2.5 * (2.0 - np.cos(0.3) - np.cos(0.5))
    assert float(after.work[-1]) == pytest.approx(-(EA * 0.1**2 / (2 * 2.5) + bent), rel=1e-9)
    parted = as_parted(model, after.parted)
    bending = parted.effect("bending").force(parted.kinematics(s.r, s.v, s.t))
    # what is left bends the joint of links 3 and 4 only: nodes 2, 3 and 4, a force and its opposite turn
    assert np.abs(bending[0]).max() == 0.0
    np.testing.assert_allclose(np.sum(bending, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(bending[3]), 300.0 / 2.5 * np.sin(0.3) / 2.6, rtol=1e-9)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"line": "rop", "load": 1.0}, "failure.0.line: 'rop' is not a line; did you mean 'rope'?"),
        ({"line": "rope"}, "failure.0.load: missing"),
        ({"line": "rope", "load": 0.0}, "failure.0.load: 0.0 is out of range"),
        ({"line": "rope", "time": 3.0}, "failure.0.link: missing"),
        ({"line": "rope", "time": -3.0, "link": 1}, "failure.0.time: -3.0 is out of range"),
        ({"line": "rope", "link": 3, "load": 5.0}, "failure.0.link: 3 is not a link of 'rope'; allowed: 1 to 2"),
        ({"line": "rope", "force": 3.0}, "failure.0.force: unknown"),
    ],
)
def test_a_failure_that_cannot_be_is_named(entry, words, refusal):
    assert words in refusal(load_scene, hanging(2, entry))


def test_a_failure_survives_the_way_through_plain_values_and_takes_changes():
    scene = load_scene(hanging(2, {"line": "rope", "link": 2, "time": 0.5, "load": 3e3}))
    assert load_scene(scene.to_dict()) == scene
    changed = scene.with_values({"failure.0.time": 0.7})
    assert (changed.failures[0].time, changed.failures[0].load) == (0.7, 3e3)
    with pytest.raises(SceneError, match="are rigid"):
        load_scene("dropper-release-a").with_values({}).from_dict(
            {**load_scene("dropper-release-a").to_dict(), "failure": [{"line": "dropper", "load": 1.0}]}
        )


def test_schemes_without_parting_links_refuse():
    model = build_model(load_scene(hanging(2, {"line": "rope", "load": 5e3})))
    with pytest.raises(SceneError, match="rattle"):
        make_stepper(model, "rattle")


@pytest.mark.check
def test_a_sweep_and_a_study_count_the_energy_of_broken_links_as_single_runs_do(tmp_path):
    pytest.importorskip("zarr")
    scene = hanging(2, {"line": "rope", "link": 2, "time": 0.5}, run={"dt": 0.01, "duration": 0.7})
    times = [0.3, 0.5]
    found = open_sweep(sweep(scene, {"failure.0.time": times}, tmp_path / "cut.zarr", halvings=0).path)
    for time in times:
        single = simulate(load_scene(scene).with_values({"failure.0.time": time}), halvings=0)
        case = found.sel({"failure.0.time": time})
        # the stretch that the parted link would have: much more than the tolerance
        assert 0.5 * EA / 5.0 * (0.5 * G * (0.7 - time) ** 2) ** 2 > 1e-3 * abs(single.energy[-1])
        assert float(case.energy_final) == pytest.approx(single.energy[-1], rel=1e-9)
        assert float(case.tension_max) == pytest.approx(single.tension[1:].max(), rel=1e-9)
    problem = study(scene, "energy.final", ["effects.weight.gravity"])
    assert float(jax.jit(problem)(problem.values)) == pytest.approx(single.energy[-1], rel=1e-9)


@pytest.mark.check
def test_windows_of_a_study_continue_with_links_that_have_parted():
    scene = hanging(2, {"line": "rope", "link": 2, "load": 500.0}, run={"dt": 0.01, "duration": 1.0})
    problem = study(scene, "tension.2.max", ["effects.point_bodies.gravity"])
    run = problem.plan.march(problem.model, problem.start, problem.steps)
    mean, error, length = window_means(problem, 0.2, run)
    # its first step parts the link: of the five windows the first alone has a derivative d, so that the mean is d/5
    # and its standard error d/5 as well
    assert length == pytest.approx(0.2)
    assert mean[0] != 0.0
    assert error[0] == pytest.approx(abs(mean[0]), rel=1e-9)
