"""Writhe of lines: closed forms."""

import warnings

import numpy as np
import pytest

from dropper_jax.analysis import writhe


@pytest.mark.parametrize("turns", [1, 3])
def test_a_helix_untwists_by_its_turns_times_one_minus_the_cosine_of_its_angle(turns):
    phase = np.linspace(0.0, 2.0 * np.pi * turns, 400 * turns + 1)
    helix = np.stack([np.cos(phase), np.sin(phase), phase], axis=-1)  # 45 degrees to its axis
    assert writhe(helix[None], [0.0, 0.0, 1.0])[0] == pytest.approx(turns * (1.0 - np.sqrt(0.5)), rel=1e-2)


def test_a_line_whose_ends_meet_has_a_writhe_without_warnings():
    phase = np.linspace(0.0, 2.0 * np.pi, 41)
    ring = np.stack([np.cos(phase), np.sin(phase), 0.1 * np.sin(2.0 * phase)], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = writhe(ring[None], np.zeros(3))
    np.testing.assert_array_equal(found, 0.0)
