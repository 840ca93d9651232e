"""Runs that say what they do not resolve: peaks of a step or two, alternating tensions, energy out of nowhere."""

import dataclasses

import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax.run.build_solution import without_push
from dropper_jax.run.quality_checks import with_quality_checks
from dropper_jax.run.tension_faults import MOST_WARNINGS, LineFault, limit_warnings


@pytest.fixture(scope="module")
def soft(falling):
    """20 steps in a period of the mass on its rope."""
    return dj.simulate(falling(0.2, 0.01))


def test_a_peak_of_many_steps_is_not_warned_of(soft):
    assert soft.status == "ok"
    assert soft.warnings == ()


def test_a_peak_within_a_step_is_named_with_its_size_and_time(falling):
    run = dj.simulate(falling(0.01, 0.01))
    assert run.status == "step_too_long"  # steps of the period of the rope take the energy of the bounce
    text = run.warnings[0]
    assert text.startswith(f"rope: the peak tension, {run.tension.max():.4g} N at ")
    assert "not resolved" in text


def changed(solution, **arrays):
    return with_quality_checks(dataclasses.replace(solution, warnings=(), **arrays))


def test_energy_that_is_not_accounted_for_is_a_failure(soft):
    """Both ways; of a scheme that takes energy by design what it loses warns, up to the whole scale."""

    def lost(share, **used):
        work = share * soft.energy_scale * np.linspace(0.0, 1.0, len(soft.t))[:, None] / soft.work.shape[1]
        return changed(soft, work=soft.work + work, settings={**soft.settings, **used})

    assert lost(0.05).warnings == ()
    for share in (0.2, -0.2, 1.5):
        failed = lost(share)
        assert failed.status == "energy_drift"
        assert "energy balance error" in failed.warnings[0]
        assert "energy balance error" in failed.failure
        assert "J (reference" in failed.failure
    euler = {"integrator": "theta", "gamma": 1.0}
    assert lost(0.9, **euler).status == "ok"
    assert "energy balance error" in lost(0.9, **euler).warnings[0]
    assert lost(-0.2, **euler).status == lost(1.5, **euler).status == "energy_drift"
    assert lost(0.9, integrator="theta", gamma=0.5).status == "energy_drift"


def test_a_symplectic_scheme_at_a_step_that_loses_energy_is_not_called_ok():
    """A double pendulum without any damping at 80 times its step."""
    run = dj.simulate("double-pendulum-chaotic", integrator="semi_implicit_euler", dt=0.08, duration=6.0)
    assert 0.1 * run.energy_scale < run.energy_drift < run.energy_scale
    assert run.status == "energy_drift"


def test_tensions_that_alternate_or_come_in_pulses_are_reported(soft):
    steps = np.arange(len(soft.t))
    smooth = 100.0 + 10.0 * np.sin(0.2 * steps)
    assert changed(soft, tension=smooth[:, None]).warnings == ()
    alternating = changed(soft, tension=(smooth * (1.0 + 0.2 * (-1.0) ** steps))[:, None])
    assert "tensions oscillate from step to step" in alternating.warnings[0]
    pulses = np.where(steps % 5 == 0, 100.0, 0.0) + np.where(steps < 8, 300.0, 0.0)
    assert any("pulses of one step" in w for w in changed(soft, tension=pulses[:, None]).warnings)


@pytest.mark.slow
def test_a_run_at_rest_misses_no_energy(falling):
    scene = falling(0.2, 0.01) | {"start": {"kind": "static"}}
    run = dj.simulate(scene)
    assert (run.status, run.warnings) == ("ok", ())


@pytest.mark.check
def test_a_scheme_that_gains_energy_where_a_line_snaps_is_not_called_ok():
    run = dj.simulate("paper-case-1", integrator="generalized_alpha", dt=0.02, duration=20.0)
    assert run.status == "energy_drift"
    assert run.energy_drift > run.energy_scale


def test_what_the_tolerance_leaves_of_a_slack_rope_pushes_nothing(soft):
    scene, EA = soft.scene, soft.scene.lines[0].EA[0]
    given = np.array([[-1e-13 * EA], [-0.1], [2.0]]) * np.ones((3, scene.lines[0].links))
    kept = without_push(scene, given.copy(), 1e-11)
    np.testing.assert_array_equal(kept[0], 0.0)
    np.testing.assert_array_equal(kept[1:], given[1:])
    assert np.all(soft.tension >= 0.0)


def test_a_farm_names_its_worst_lines_and_counts_the_others():
    rows = [LineFault("not resolved", float(size), f"line {size}") for size in range(50)]
    rows.append(LineFault("alternates", 1.0, "line x"))
    reported = limit_warnings(iter(rows))
    assert reported == ["line 47", "line 48", "line 49", "line x", "47 more lines: not resolved"]
    assert limit_warnings(iter(rows[:MOST_WARNINGS])) == [f"line {size}" for size in range(MOST_WARNINGS)]
    assert len(limit_warnings(iter([LineFault("not resolved", 1.0, "the same")] * 50))) == MOST_WARNINGS + 1


def hoisted(amplitude):
    """500 kg on 20 m of rope whose top heaves every 3 s."""
    motion = {"point": "top", "amplitude": [0.0, 0.0, amplitude], "period": 3.0, "ramp": 3.0}
    return scene_of(
        {"top": [0.0, 0.0, 0.0], "mass": free_at([0, 0, -20.0])},
        line_of("rope", "top", "mass", 1, 20.0, mass=500.0, axial={"law": "rope", "EA": 1e6}),
        run={"dt": 0.005, "duration": 9.0},
        effects={"weight": {}, "end_motion": motion},
    )


def test_a_line_that_snatches_is_reported_as_chaotic_and_one_that_stays_taut_is_not():
    run = dj.simulate(hoisted(3.0))
    assert run.tension.min() < 1.0
    assert run.tension.max() > 10.0 * 500.0 * 9.81
    (text,) = [w for w in run.warnings if "snatch loads" in w]
    assert text.startswith(f"rope: changes from slack to {run.tension.max():.4g} N")
    assert "--errors" in text
    assert not any("snatch" in w for w in dj.simulate(hoisted(0.3)).warnings)


def test_what_the_steps_resolve_is_reported(soft):
    facts = soft.summary()["step_facts"]
    # a link of 2 m and 100 kg whose mass is at its far node swings in 0.2 s, its two ends against each other in half
    assert facts["axial_period_s"] == pytest.approx(0.1)
    assert facts["steps_per_axial_period"] == pytest.approx(10.0)
    omega_h = 2.0 * np.pi / (facts["axial_period_s"] / facts["axial_step_s"])
    assert 2.0 / omega_h * np.arctan(omega_h / 2.0) == pytest.approx(1.0, abs=1.01e-3)  # of the midpoint rule
    assert facts["largest_turn_rad"] == 0.0
    taut = soft.tension[1:, 0] > 0
    assert facts["slack_to_taut_steps"] == sum(b and not a for a, b in zip(taut, taut[1:], strict=False)) > 0
    still = dj.simulate("double-pendulum-periodic", dt=0.005, duration=0.1).summary()["step_facts"]
    assert still["axial_period_s"] is None
    assert still["largest_turn_rad"] > 0.0


@pytest.mark.parametrize(("dt", "status", "is_warned"), [(0.001, "ok", False), (0.005, "step_too_long", True)])
def test_unresolved_vibrations_enter_the_verdict(falling, dt, status, is_warned):
    run = dj.simulate(falling(0.05, dt, duration=2.0))
    assert run.status == status
    assert any("axial vibrations that the steps do not resolve" in text for text in run.warnings) == is_warned
