"""RATTLE composed to fourth order."""

import numpy as np
import pytest

import dropper_jax as dj


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("rattle_4", (7, 8, 9)) == pytest.approx(4.0, abs=0.3)


def test_damping_leaves_the_order_as_it_is(order):
    assert order("rattle_4", (7, 8, 9), damped=True) == pytest.approx(4.0, abs=0.3)


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
