"""Generalised-alpha: what it leaves of vibrations, its start and derivatives, the damper of slack lines, refusals."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError, build_model, integrate, load_scene, make_stepper

G = 9.81
LENGTH, MASS = 0.5, 0.4


def ringing(ring, turn, steps, **weights):
    """Swings of the tension in steps that turn the vibration by `turn` [rad]."""
    dt = 1e-2
    return np.abs(ring("generalized_alpha", LENGTH * MASS * (turn / dt) ** 2, dt, steps, **weights))


@pytest.mark.parametrize(("rho", "begin", "end"), [(0.5, 10, 20), (0.9, 60, 120)])
def test_unresolved_ringing_shrinks_to_rho_at_every_step(ring, rho, begin, end):
    # the double root -rho of Chung and Hulbert leaves (a + b k) rho^k
    swing = ringing(ring, 100.0, end, rho_infinity=rho)
    first, last = np.max(swing[begin - 4 : begin]), np.max(swing[end - 4 : end])
    assert (last / first) ** (1 / (end - begin)) == pytest.approx(rho, rel=0.08)


def test_with_rho_0_unresolved_ringing_is_gone_after_six_steps(ring):
    swing = ringing(ring, 100.0, 10, rho_infinity=0.0)
    assert swing[1] > 0.1
    assert np.max(swing[6:]) < 1e-6


def test_resolved_ringing_is_kept(ring):
    swing = ringing(ring, 0.2, 157)  # 5 periods of 31 steps each
    assert np.max(swing[-32:]) / np.max(swing[:32]) == pytest.approx(1.0, abs=0.01)


def hanging(one_line, law="rope", **more):
    """A line of six links between points 1 m below its length apart, its top driven gently."""
    kind = {"mass": 2.0, "diameter": 0.03, "EA": 4e4, "damping_ratio": 0.1, "law": law, "cdn": 1.2, "cdt": 0.1}
    scene = one_line(12.0, 6, [0.0, 0.0, -9.0], [8.0, 0.0, -1.0], kind, {"weight": {}, **more})
    scene["sea"] = {"depth": 12.0}
    return scene


def test_a_static_pose_stays(one_line):
    run = dj.simulate(hanging(one_line), integrator="generalized_alpha", dt=0.05, duration=5.0)
    assert run.status == "ok"
    assert np.max(np.abs(run.positions - run.positions[0])) < 1e-9
    assert np.max(np.abs(run.tension - run.tension[0])) < 1e-5


@pytest.mark.check
@pytest.mark.slow
def test_gradients_of_a_driven_line_agree_with_differences_forward_and_reverse(chain, slopes_of):
    effects = {"weight": {}, "end_motion": {"point": "right", "amplitude": [0.02, 0.0, 0.03], "period": 1.0}}
    nodes = [[0.0, 0.0, 0.0], [0.25, 0.0, -0.2], [0.5, 0.0, -0.2], [0.7, 0.0, 0.0]]
    axial = {"law": "rope", "EA": 60.0, "damping": 0.3}
    start = {"kind": "positions", "positions": nodes}
    model, s = dj.build(chain([0.3, 0.2, 0.25], [0.2, 0.1, 0.3], start, nodes[-1], effects, axial=axial))
    stepper = make_stepper(model, "generalized_alpha", track_work=False, halvings=0)

    def mean_square(factor):
        axial = replace(model.line.axial, EA=model.line.axial.EA * factor)
        changed = replace(model, lines=(replace(model.line, axial=axial),))
        return jnp.mean(integrate(stepper, changed, s, 0.01, 60)[1].tension[:, -1] ** 2)

    slopes_of(mean_square, 1.0, 5e-4, rel=1e-5)


def test_the_damper_of_a_slack_line_brakes_in_one_law_and_not_in_the_other(chain):
    # a slack link along z without weight: m v' = -BA/L v for the damped rope, free flight for the other
    BA, v0 = 0.8, 0.3
    nodes = [[0.0, 0.0, 0.0], [0.0, 0.0, -0.6 * LENGTH]]
    start = {"kind": "positions", "positions": nodes, "velocities": [[0.0, 0.0, 0.0], [0.0, 0.0, v0]]}
    decay = np.exp(-BA / LENGTH / MASS * 0.2)
    for law, integrator, expected, close in (
        ("rope", "generalized_alpha", v0, 1e-12),
        ("damped_rope", "generalized_alpha", v0 * decay, 1e-5),
        ("damped_rope", "energy_momentum", v0 * decay, 5e-3),
        ("damped_rope", "rk4", v0 * decay, 1e-9),
    ):
        axial = {"law": law, "EA": 100.0, "damping": BA}
        model, s = dj.build(chain([LENGTH], [MASS], start, effects={}, axial=axial))
        stepper = make_stepper(model, integrator, halvings=0, track_work=False)
        _, path = jax.jit(lambda m, s, stepper=stepper: integrate(stepper, m, s, 1e-3, 200))(model, s)
        assert float(path.v[-1, -1, 2]) == pytest.approx(expected, rel=close), (law, integrator)


@pytest.mark.check
@pytest.mark.parametrize("law", ["rope", "damped_rope"])
def test_both_rope_laws_are_those_of_the_explicit_scheme(one_line, law):
    driven = hanging(one_line, law, end_motion={"point": "b", "amplitude": [0.3, 0.0, 0.2], "period": 3.0})
    runs = [dj.simulate(driven, integrator=name, dt=2e-3, duration=1.5) for name in ("generalized_alpha", "rk4")]
    assert [run.status for run in runs] == ["ok", "ok"]
    a, b = (np.interp(np.arange(0.1, 1.4, 0.1), run.t_tension, run.tension[:, -1]) for run in runs)
    assert np.max(np.abs(a - b)) < 5e-3 * np.max(b)


@pytest.mark.parametrize(
    ("integrator", "weight", "value", "words"),
    [
        ("generalized_alpha", "rho_infinity", 1.2, "1.2 is out of range; allowed: a number 0 to 1"),
        ("rk4", "rho_infinity", 0.5, "no such weight"),
        ("generalized_alpha", "gamma", 0.5, "no such weight"),
    ],
)
def test_weights_that_make_no_sense_are_named(one_line, integrator, weight, value, words):
    values = {"run.integrator": integrator, f"run.{weight}": value}
    with pytest.raises(SceneError, match=f"run.{weight}.*{words}"):
        dj.simulate(load_scene(hanging(one_line)).with_values(values), duration=0.1)


def test_rigid_lines_and_friction_in_joints_are_refused_with_what_to_take():
    with pytest.raises(SceneError, match=r"generalized_alpha.*axial\.law"):
        make_stepper(build_model(load_scene("conical-pendulum")), "generalized_alpha")
    line = {"name": "l", "from": "top", "to": "low", "links": 2, "length": 0.5, "mass": 1.0}
    top, low = [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]
    joints = {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [{"name": "top", "position": top}, {"name": "low", "position": low}],
        "line": [line | {"axial": {"law": "elastic", "EA": 1e4}}],
        "effects": {"weight": {}, "joint_friction": {"dry": 0.5, "axis": [0.0, 1.0, 0.0]}},
    }
    with pytest.raises(SceneError, match=r"joint_friction.*couples neighbouring nodes; use energy_momentum"):
        make_stepper(build_model(load_scene(joints)), "generalized_alpha")
