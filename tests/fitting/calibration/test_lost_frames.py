"""Faults of single frames: a jump of known frames, and samples that deviate alone in smooth misfits."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.windows.lost_frames import best_jump
from fitting.windows.outliers import count_outliers


def swinging(count):
    t = np.arange(count) / 60
    return np.stack([0.8 * np.sin(7.1 * t), 0.5 * np.sin(9.3 * t + 1) + 0.2 * np.sin(21 * t)], axis=1)


@pytest.mark.parametrize(("frames", "at"), [(12, 90), (1, 100), (-3, 75), (30, 95)])
def test_a_jump_along_the_flow_is_found_where_it_is(frames, at):
    angle = swinging(180)
    rng = np.random.default_rng(at)
    index = np.arange(140) + np.where(np.arange(140) >= at, frames, 0)
    measured = angle[index] + 0.004 * rng.standard_normal((140, 2))
    measured[20, 0] += 0.3
    gain, first, lag = best_jump(angle[:140], measured, np.full((140, 2), 250.0), 60)
    assert (first, lag) == (at, frames)
    assert gain > 100
    whole = angle[:140] + 0.004 * rng.standard_normal((140, 2))
    assert best_jump(angle[:140], whole, np.full((140, 2), 250.0), 60)[0] < 5


def test_samples_that_stand_out_alone_are_counted_and_smooth_misfits_are_not():
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((6, 80, 2)) + 20 * np.sin(np.arange(80) / 12)[None, :, None]
    windows = SimpleNamespace(weight=np.ones_like(errors), known=np.ones(errors.shape, bool), jitter=None)
    solution = SimpleNamespace(errors=errors, windows=windows)
    assert count_outliers(solution) == 0
    for k, s, j in ((0, 10, 0), (3, 50, 1), (5, 40, 0), (5, 60, 1)):
        errors[k, s, j] += 25
    assert count_outliers(solution) == 4
