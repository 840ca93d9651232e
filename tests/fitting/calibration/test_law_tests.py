"""Score tests of the law, on traces of another simulator (`conftest`): right laws pass, wrong ones are named."""

from dataclasses import replace

import numpy as np
import pytest
import wrong_laws as study

from fitting.laws.law_fits import with_law
from fitting.parameters.missing_forces import FORCE_UNITS

#: Dry friction [N m] of 0.3 % of a rod's weight times its length.
DRY = 1e-3


@pytest.fixture(scope="module")
def rubbed(two, ready, fitted):
    """The fit of a trace with dry friction, without it in the scene."""
    return fitted(ready(two.seen(two.swing([1.2, 0.6], dry=DRY), 3)), "shooting")


@pytest.mark.check
def test_missing_forces_have_the_derivatives_of_the_effects_and_change_nothing_at_zero(prepared):
    """The scene has viscous joints and quadratic drag; its drag is averaged over a step, an error of second order."""
    names = [p.name for p in prepared.simulator.compiled]
    every = [next(p for p in prepared.simulator.compiled if p.name == f"missing.{kind}") for kind in FORCE_UNITS]
    view = prepared.simulator.view_of([*prepared.parameters, *every])
    found = view(np.append(prepared.values, np.zeros(len(every))), prepared.starts, prepared.windows)
    alone = prepared.simulator(prepared.values, prepared.starts, prepared.windows)
    np.testing.assert_array_equal(found.residual, alone.residual)
    own, missing = np.split(found.jacobian[..., prepared.simulator.freedoms :], [2], axis=-1)
    for i, (kind, tolerance) in enumerate((("viscous", 1e-9), ("quadratic", 1e-3))):
        column = missing[..., list(FORCE_UNITS).index(kind)]
        np.testing.assert_allclose(column, own[..., i], rtol=0, atol=tolerance * np.abs(column).max())
    assert len(set(names)) == len(names)


@pytest.mark.check
def test_right_laws_end_ok(ten):
    """Ten noises of one right rig: at the level of 1 % over the family one of ten may be flagged, with bad luck."""
    assert sum(result.status == "model_error" for result in ten) <= 1
    assert all(len(result.laws.tests) >= 6 for result in ten)
    assert np.median([min(test.p for test in result.laws.tests) for result in ten]) > 0.1


def test_a_bound_that_excludes_the_truth_is_a_misfit(two, ready, fitted, motion):
    result = fitted(ready(two.seen(motion, 0), bounds={two.FREE[0]: (2 * two.TRUTH[0], 1.0)}))
    assert result.uncertainty.at_bound[0]
    assert result.status == "misfit"
    assert f"{two.FREE[0]} is held at its bound {2 * two.TRUTH[0]:g}" in result.message


def test_a_bound_of_zero_that_excludes_the_truth_is_no_ok(two, ready, fitted):
    """Joints that drive the links: a positive viscosity, the only one allowed, cannot be right."""
    result = fitted(ready(two.seen(two.swing([1.2, 0.6], viscous=-two.TRUTH[0] / 2), 0)))
    assert result.status in ("misfit", "model_error")
    assert f"{two.FREE[0]} is held at its bound 0, " in result.message
    assert "It cannot be negative" in result.message


def test_dry_friction_that_the_scene_lacks_is_a_model_error_that_names_it_and_nothing_else(rubbed):
    """Without dry friction, the trace alone also shows viscous friction and drag that changes with time."""
    assert rubbed.status == "model_error"
    assert rubbed.laws.wrong.name == "dry friction in the joints"
    assert rubbed.laws.wrong.change == pytest.approx(DRY, rel=0.3)
    assert "--free viscous,b_q,effects.joint_friction.dry" in rubbed.message
    assert rubbed.to_json()["laws"][0]["matters"]
    assert [test.name for test in rubbed.laws.significant] == ["dry friction in the joints"]
    assert rubbed.laws.wrong.p < 1e-6


def test_a_law_that_is_freed_starts_from_the_end_of_the_fit_without_it(rubbed):
    """The trace shows friction of its own in the joints."""
    wider = with_law(rubbed.prepared, rubbed.laws.wrong.free, rubbed.solution)
    names = [p.name for p in rubbed.prepared.parameters]
    assert [p.name for p in wider.parameters] == [*names, "effects.joint_friction.dry"]
    np.testing.assert_array_equal(wider.values[:2], rubbed.values)


def test_quadratic_drag_that_is_left_out_is_a_model_error_that_names_it(two, ready, fitted, motion):
    """Quadratic drag kept at zero: it is named."""
    prepared = ready(two.seen(motion, 1), start={two.FREE[1]: 0.0})
    result = fitted(prepared, "shooting", frozen=np.array([False, True]))
    assert result.status == "model_error"
    assert "quadratic drag" in (result.laws.wrong.name, *result.laws.wrong.alike)


@pytest.fixture(scope="module")
def quadratic():
    """`quadratic(seed)`: the fit of linear drag alone to a chain of `wrong_laws` that has quadratic drag alone."""

    def fitted(seed):
        draw = study.draw(seed)
        return study.judge(draw, study.seen(draw, draw.rig, 1), [0])[1]

    return fitted


@pytest.mark.check
def test_joins_that_a_wrong_law_loosens_do_not_hide_it(quadratic):
    """At the gap weight of the fit quadratic drag is 2.7 standard errors from zero, tightly joined it is 7."""
    result = quadratic(33)
    assert result.status == "model_error"
    assert result.laws.wrong.name == "quadratic drag"
    assert result.laws.wrong.t > 5


@pytest.mark.check
def test_a_force_that_a_trace_neither_shows_nor_excludes_is_in_a_warning(quadratic):
    """The amplitude of this chain decays by 7 %: its speeds do not distinguish both kinds of drag."""
    result = quadratic(5)
    assert result.status == "ok"
    assert "effects.linear_damping.b_l may include quadratic drag" in " ".join(result.warnings)


@pytest.mark.check
def test_noise_with_a_memory_does_not_explain_windows_that_do_not_join():
    """A loose hook looks like correlated noise in every window; b_q would be ten times the true one, 7 errors off."""
    draw = replace(study.draw(105), fault="loose_hook")
    rig, _ = study.with_fault(draw, None)
    result = study.judge(draw, study.seen(draw, rig, 5), [0, 1])[1]
    assert result.noise_table()["kind"] == "correlated"
    assert result.status == "misfit"
    assert "the windows of the fit do not join to one motion" in result.message


@pytest.mark.check
def test_loose_joins_that_no_force_explains_are_a_misfit():
    """Springs look like correlated noise in every window, and no candidate is shown; b_l would be 4.6 errors off."""
    draw = study.draw(394)
    springs = replace(draw.rig, springs=7.278e-5)
    result = study.judge(draw, study.seen(draw, springs, 1), [0, 1])[1]
    assert not result.laws.significant
    assert result.status == "misfit"
    assert "the windows of the fit do not join to one motion" in result.message
