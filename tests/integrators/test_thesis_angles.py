"""The thesis' scheme in angles: first order, in the plane and in space."""

import numpy as np
import pytest

import dropper_jax as dj


@pytest.mark.slow
def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("thesis_angles", (11, 12), gamma=0.51) == pytest.approx(1.0, abs=0.15)


def test_thesis_scheme_in_angles_has_the_right_sign_of_the_coriolis_term(march, motion):
    """First order: halving the step halves the error in space; a wrong sign would leave it as it is."""
    model, s, exact = motion("double, spherical")
    stepper = dj.make_stepper(model, "thesis_angles", gamma=0.51, halvings=0, track_work=False)
    error = [np.max(np.abs(march(stepper, model, s, 1.0, steps)[0][-1] - exact[0])) for steps in (4000, 8000)]
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(2.0, abs=0.1)
