"""Linear interpolation of rows."""

import numpy as np
import pytest

from dropper_jax.base.interpolation import interpolate_rows

TIMES = np.array([0.0, 1.0, 3.0])


def test_rows_are_linear_between_known_ones_and_constant_outside():
    rows = np.stack([TIMES, 10.0 - 2.0 * TIMES], axis=1)
    at = np.array([-1.0, 0.25, 2.5, 9.0])
    inside = np.clip(at, 0.0, 3.0)
    np.testing.assert_allclose(interpolate_rows(TIMES, rows, at), np.stack([inside, 10.0 - 2.0 * inside], axis=1))


@pytest.mark.parametrize("bad", [0, 1, 2])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_known_rows_are_exact_next_to_one_that_is_not_finite(bad, value):
    rows = np.ones((3, 2, 3))
    rows[bad] = value
    np.testing.assert_array_equal(interpolate_rows(TIMES, rows, TIMES), rows)


def test_one_known_row_is_the_same_everywhere():
    np.testing.assert_array_equal(interpolate_rows(np.array([5.0]), np.array([7.0]), TIMES), np.full(3, 7.0))
