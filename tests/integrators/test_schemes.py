"""What single schemes keep, and closed forms they follow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.integrators.thesis_angles import angles_of_links

G = 9.81


@pytest.mark.check
def test_fourth_order_rattle_keeps_energy_bounded_and_lengths_to_rounding():
    """Symplectic and symmetric: half the step takes a sixteenth of the energy error, which does not grow with time."""
    swings = []
    for dt in (0.004, 0.002):
        solution = dj.simulate("dropper-release-a-undamped", integrator="rattle_4", dt=dt, duration=8.0)
        assert solution.status == "ok"
        assert solution.max_closure_error < 1e-10
        early, late = (np.ptp(half) for half in np.array_split(solution.energy, 2))
        assert late < 3 * early
        swings.append(np.ptp(solution.energy))
    assert swings[1] < swings[0] / 8


def test_thesis_scheme_in_angles_has_the_right_sign_of_the_coriolis_term(march, motion):
    """First order: halving the step halves the error in space; a wrong sign would leave it as it is."""
    model, s, exact = motion("double, spherical")
    stepper = dj.make_stepper(model, "thesis_angles", gamma=0.51, halvings=0, track_work=False)
    error = [np.max(np.abs(march(stepper, model, s, 1.0, steps)[0][-1] - exact[0])) for steps in (4000, 8000)]
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.check
def test_theta_midpoint_with_one_half_is_the_energy_momentum_scheme(march):
    model, s = dj.build("dropper-release-a")
    default = march(dj.make_stepper(model, halvings=0, track_work=False), model, s, 0.5, 128, 2)[0]
    half = dj.make_stepper(model, "theta_midpoint", gamma=0.5, halvings=0, track_work=False)
    weighted = march(half, model, s, 0.5, 128, 2)[0]
    np.testing.assert_array_equal(default, weighted)


def test_angles_of_a_line_in_the_plane_have_derivatives_where_a_link_is_vertical():
    """Of theta = atan2(down, x) by x: -1/L for a vertical link of length L that points down."""

    def angle(x: jax.Array) -> jax.Array:
        links = jnp.array([[0.0, 0.0, -2.0], [0.6, 0.0, -0.8]]).at[0, 0].set(x)
        return angles_of_links(links, jnp.zeros_like(links))[0][0]

    np.testing.assert_allclose(jax.grad(angle)(0.0), -0.5, rtol=1e-12)
