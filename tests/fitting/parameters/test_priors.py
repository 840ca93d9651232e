"""Priors of a rig: on single numbers, on the part common to several, and the scale of mass, which angles leave open."""

import numpy as np
import pytest
from hard_scenes import single_line

import dropper_jax as dj
from dropper_jax import Scene, SceneError, build_model
from fitting.estimate.normal_equations import prior_of
from fitting.parameters.names import default_free
from fitting.parameters.parameter import adjust_parameters
from fitting.parameters.paths import resolve
from fitting.parameters.rig_priors import power_of_mass, rig_priors
from fitting.parameters.scene_parameters import find_parameters

NAME = "measured-double-pendulum"


def found(priors, free, start=None):
    table = dj.load_scene(NAME).to_dict()
    scene = Scene.from_dict({**table, "fit": {"prior": priors}})
    model = build_model(dj.load_scene(scene))
    return rig_priors(scene, model, adjust_parameters(resolve(model, free), start))


@pytest.mark.parametrize("start", [None, {"line.0.length": 0.3}], ids=["", "started elsewhere"])
def test_a_prior_holds_every_free_number_of_its_path_at_the_value_of_the_scene(start):
    prior = {"of": "line.0.length", "sigma": 0.5, "unit": "mm"}
    parameters, known = found([prior], ["line.0.length", "line.0.mass.0"], start)
    assert [p.prior for p in parameters] == [(0.172719, pytest.approx(5e-4)), (0.2, pytest.approx(5e-4)), None]
    assert known.common == ()
    assert known.carried == 0


def test_a_common_prior_holds_the_mean_share_and_leaves_the_ratios():
    prior = {"of": "line.0.mass", "sigma": 0.3, "unit": "%", "common": True}
    parameters, known = found([prior], ["line.0.mass", "line.0.inertia"])
    values = np.array([p.value for p in parameters])
    moved = found([prior], ["line.0.mass", "line.0.inertia"], {"line.0.mass": 0.3})[1]
    np.testing.assert_array_equal(moved.common[0].share, known.common[0].share)
    prior = prior_of(parameters, values * np.array([1.006, 1.006, 1, 1]), known.common)
    assert prior.cost == pytest.approx(0.5 * (0.006 / 0.003) ** 2)
    assert known.carried == 0
    turned = values * np.array([1.01, 0.99, 1, 1])  # the ratio, not the scale
    assert prior_of(parameters, turned, known.common).cost == pytest.approx(0, abs=1e-12)
    cost = lambda v: prior_of(parameters, v, known.common).cost  # noqa: E731
    slope = [(cost(values + h) - cost(values - h)) / 2e-6 for h in 1e-6 * np.eye(4)]
    np.testing.assert_allclose(prior_of(parameters, values, known.common).gradient, slope, atol=1e-6)


def test_masses_that_are_held_carry_their_scale_into_the_errors_of_what_grows_with_it():
    names = ["line.0.inertia.0", "effects.joint_friction.dry.0", "line.0.centre_of_mass.0", "camera.offset"]
    _, known = found([{"of": "line.0.mass", "sigma": 0.3, "unit": "%", "common": True}], names)
    values = np.array([4e-4, 3e-4, 0.1, 0.01])
    error = np.sqrt(np.diag(known.carried_covariance(values)))
    np.testing.assert_allclose(error / values, [0.003, 0.003, 0, 0])
    correlation = known.carried_covariance(values)[0, 1] / (error[0] * error[1])
    assert correlation == pytest.approx(1)


@pytest.mark.check
def test_angles_do_not_change_when_everything_heavy_grows_alike():
    """The reason for what is carried: masses, inertias and friction, all 7 % larger, swing alike."""
    scene = dj.load_scene(NAME)
    line, friction = scene.to_dict()["line"][0], scene.to_dict()["effects"]["joint_friction"]
    heavier = {f"line.0.{key}": (1.07 * np.array(line[key])).tolist() for key in ("mass", "inertia")}
    heavier |= {f"effects.joint_friction.{k}": (1.07 * np.array(friction[k])).tolist() for k in ("viscous", "dry")}
    runs = [dj.simulate(s, dt=0.005, duration=1.0).positions for s in (scene, scene.with_values(heavier))]
    np.testing.assert_allclose(*runs, atol=1e-9)


@pytest.mark.parametrize(
    ("units", "power"), [(["kg", "kg/s", "N m s/rad", "N m", "kg m^2"], 1), (["m", "rad", "m/s^2", "-", "kg/kg"], 0)]
)
def test_units_with_a_mass_are_recognised(units, power):
    assert [power_of_mass(unit) for unit in units] == [power] * 5


@pytest.mark.parametrize(
    ("prior", "words"),
    [
        ({"of": "line.0.length", "sigma": 1, "unit": "g"}, "'g' is not a unit of 'line.0.length.0'; allowed: m, %"),
        ({"of": "line.0.lenght", "sigma": 1, "unit": "%"}, "did you mean 'line.0.length'"),
        ({"of": "point.0.position.0", "sigma": 1, "unit": "%"}, "is 0, which has no relative error"),
    ],
)
def test_a_prior_of_nothing_is_named(prior, words):
    with pytest.raises(SceneError, match="fit.prior.0") as error:
        found([prior], ["line.0.length", "point.0.position.0"])
    assert words in str(error.value)


def test_what_the_rig_leaves_open_is_free_by_default():
    scene = dj.load_scene("measured-single-pendulum")
    assert default_free(scene)[0] == "line.0.inertia"
    assert "effects.quadratic_damping.b_q" in default_free(scene)
    assert default_free(dj.load_scene("dropper-release-a")) == [
        "effects.linear_damping.b_l", "effects.quadratic_damping.b_q",
    ]  # fmt: skip


def test_a_prior_of_the_sea_holds_what_is_free_of_the_sea():
    """2 % of 0.4 m/s are 0.008 m/s."""
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.2}}
    table = single_line([0.5, 0.5], 5.0, {"kind": "static"}, None, effects, diameter=0.05)
    table["sea"] = {"depth": 10.0, "current": {"kind": "uniform", "speed": 0.4, "direction": 0.0}}
    table["fit"] = {"prior": [{"of": "sea.current.speed", "sigma": 2.0, "unit": "%"}]}
    scene = dj.load_scene(table)
    model = build_model(scene)
    found, _ = rig_priors(scene, model, find_parameters(scene, model, ["sea.current.speed"], "free"))
    assert found[0].prior == pytest.approx((0.4, 0.008))
    assert found[0].unit == "m/s"


def test_a_prior_without_a_mean_is_refused_by_its_mean():
    parameters = resolve(build_model(dj.load_scene(NAME)), ["line.0.length.0"])
    with pytest.raises(SceneError, match="has mean nan"):
        adjust_parameters(parameters, priors={"line.0.length.0": (np.nan, 0.1)})
