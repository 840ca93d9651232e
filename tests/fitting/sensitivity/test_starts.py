"""Derivatives by numbers of the scene through static starts, against differences of scenes that start again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rod_cases import pinned_arm

from dropper_jax import SceneError, build, load_scene, natural_modes
from fitting.sensitivity import local_derivatives, study
from fitting.sensitivity.study_steps import saved_times
from fitting.sensitivity.texts import local_text

TABLE = {
    "name": "moored",
    "run": {"dt": 0.02, "duration": 0.3},
    "line_type": [{"name": "rope", "mass": 5.0, "diameter": 0.05, "EA": 2e4, "damping_ratio": 0.1, "cdn": 1.2}],
    "point": [
        {"name": "a", "position": [0.0, 0.0, -10.0]},
        {"name": "b", "position": [16.0, 0.0, -10.0]},
        {"name": "float", "kind": "free", "position": [8.0, 0.0, -3.0], "mass": 20.0, "volume": 0.1},
    ],
    "line": [
        {"name": "first", "from": "a", "to": "float", "type": "rope", "length": 11.0, "links": 3},
        {"name": "second", "from": "b", "to": "float", "type": "rope", "length": 11.5, "links": 3},
    ],
    "sea": {
        "depth": 10.0,
        "current": {"kind": "uniform", "speed": 0.6, "direction": 0.5},
        "waves": {"kind": "regular", "height": 0.8, "period": 4.0},
    },
    "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
}
NUMBERS = ["line.first.length", "point.float.volume", "line_type.rope.EA", "line_type.rope.diameter"]
NUMBERS += ["sea.current.speed"]


def solved_again(path, share, start="static"):
    """The scene with one number changed by a share, its model and its start, sought from nothing."""
    scene = load_scene({**TABLE, "start": {"kind": start}})
    scene = scene.with_values({path: scene.value(path) * (1 + share)})
    model, state = build(scene)
    return scene, model, state


@pytest.fixture(scope="module")
def storm():
    return study(TABLE, "tension.1.max", NUMBERS)


def differences(of, path, value, start="static"):
    """Central differences of fourth order by the number."""
    h = 1e-3
    at = {k: of(*solved_again(path, k * h, start)) for k in (-2, -1, 1, 2)}
    return (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h * value)


def test_the_gravity_of_the_weight_is_that_of_the_sea_too():
    """Stiff legs without a current: all forces at rest are proportional to gravity."""
    scene = {**TABLE, "line_type": [{**TABLE["line_type"][0], "EA": 1e9}], "sea": {"depth": 10.0}}
    found = local_derivatives(study(scene, "tension.first.start", ["effects.weight.gravity"]))
    assert found.scaled[0] == pytest.approx(1.0, abs=1e-5)


def test_a_number_of_the_sea_has_a_short_path():
    """Weight and buoyancy of a float on one vertical rope: T = g (rho V - m) less the wet weight of the rope's half."""
    points = [TABLE["point"][0], {**TABLE["point"][2], "position": [0.0, 0.0, -5.0]}]
    rope = {**TABLE["line"][0], "length": 5.0, "links": 1}
    scene = {**TABLE, "point": points, "line": [rope], "sea": {"depth": 10.0}}
    found = local_derivatives(study(scene, "tension.first.start", ["sea.density"]))
    volume = 0.1 + 0.5 * 5.0 * np.pi / 4 * 0.05**2
    assert found.forward[0] == pytest.approx(9.81 * volume, rel=1e-3)


@pytest.mark.check
def test_a_run_from_the_static_pose_differentiates_through_it(storm):
    at = jnp.asarray(storm.values)
    plan = storm.plan
    steps = storm.steps
    times = saved_times(steps)
    exact = jax.jit(jax.jacfwd(lambda values: storm(values)))(at)
    reverse = jax.jit(jax.grad(lambda values: plan.evaluate(storm.model, storm.start, values, steps, True)))(at)
    assert np.asarray(reverse) == pytest.approx(np.asarray(exact), rel=1e-9)
    found = local_derivatives(storm)
    run = jax.jit(lambda model, s: plan.measure(model, s, plan.march(model, s, steps), times))
    for i, p in enumerate(storm.parameters):
        expected = differences(lambda scene, model, s: float(run(model, s)), p.name, p.value)
        assert exact[i] == pytest.approx(expected, rel=1e-6), p.name
        assert found.forward[i] == pytest.approx(expected, abs=max(2 * found.error[i], 1e-6 * abs(expected))), p.name


@pytest.mark.check
@pytest.mark.parametrize(
    ("start", "of", "count", "quantity"),
    [
        ("static", "tension.1.start", 2, lambda model, s: s.tension[0]),
        ("points", "z.2.start", 1, lambda model, s: s.r[1, 2]),
        ("static", "period.1.start", 1, lambda model, s: natural_modes(model, s, 1).period[0]),
    ],
)
def test_a_quantity_of_the_start_is_statics_alone(start, of, count, quantity):
    at_rest = study({**TABLE, "start": {"kind": start}}, of, NUMBERS[:count])
    found = local_derivatives(at_rest)
    reverse = jax.jit(jax.grad(lambda values: at_rest(values)))(jnp.asarray(at_rest.values))
    for i, p in enumerate(at_rest.parameters):
        expected = differences(lambda scene, model, s: float(quantity(model, s)), p.name, p.value, start)
        assert found.forward[i] == pytest.approx(expected, rel=1e-6), p.name
        assert reverse[i] == pytest.approx(expected, rel=1e-6), p.name
    assert (found.duration, found.trusted) == (0.0, True)


@pytest.mark.parametrize(
    ("start", "of", "words"),
    [("static", "period.1.max", "allowed: period.1.start"), ("points", "period.1.start", "starts at 'points'")],
)
def test_a_natural_period_is_a_quantity_of_a_static_start(start, of, words):
    with pytest.raises(SceneError, match=words):
        study({**TABLE, "start": {"kind": start}}, of, NUMBERS[:1])


def test_a_slope_of_a_slack_weightless_rope_by_gravity_is_reported_as_not_resolved():
    rope = {"length": 4.0, "mass": 1.0, "diameter": 0.02, "links": 2, "axial": {"law": "rope", "EA": 1e4}}
    scene = {
        "run": {"dt": 0.01, "duration": 0.02},
        "point": [{"name": name, "position": [x, 0.0, -5.0]} for name, x in (("a", 0.0), ("b", 3.0), ("c", 6.0))],
        "line": [{"name": f"{i}{j}", "from": i, "to": j, **rope} for i, j in ("ab", "bc")],
        "effects": {"weight": {"gravity": 0.0}},
        "start": {"kind": "points"},
    }
    found = local_derivatives(study(scene, "z.1.final", ["effects.weight.gravity"]))
    assert found.unclear == ("effects.weight.gravity",)
    assert found.slope_status == ("not_resolved",)
    assert jnp.isnan(found.forward[0])
    assert any("the slope is not resolved" in text for text in found.warnings)
    assert "not resolved" in local_text(found)


@pytest.mark.check
def test_a_turning_body_differentiates_by_its_mass_spin_and_gravity():
    scene = pinned_arm().with_values({"run.duration": 0.2})
    names = ["mass.0", "spin.1", "gravity"]
    problem = study(scene, "energy.final", [f"effects.rigid_bodies.{name}" for name in names])
    at = jnp.asarray(problem.values)
    assert at.tolist() == [5.0, 0.3, 9.81]
    value_and_slope = jax.jit(lambda p, along: jax.jvp(problem, (p,), (along,)))
    for k in range(3):
        along = jnp.zeros(3).at[k].set(at[k])
        value, slope = value_and_slope(at, along)
        ends = {share: value_and_slope(at + share * along, along)[0] for share in (-2e-3, -1e-3, 1e-3, 2e-3)}
        expected = (8 * (ends[1e-3] - ends[-1e-3]) - (ends[2e-3] - ends[-2e-3])) / 12e-3
        assert jnp.isfinite(value)
        assert float(slope) == pytest.approx(float(expected), rel=1e-7, abs=1e-9 * float(abs(value)))
