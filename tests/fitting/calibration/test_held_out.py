"""Scores of stretches that a fit has not used."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.calibration.held_out import score_held_out
from fitting.windows.spans import check_spans, fitted_spans

SPAN = (6.0, 8.4)
pytestmark = pytest.mark.usefixtures("optimised")


@pytest.mark.check
def test_a_run_that_ends_three_frames_into_a_held_out_span_does_not_lower_its_score(ready, two, motion):
    """Windows of three frames fit noise: the score of two such runs was 0.7 times the noise."""
    whole = two.seen(motion, 0)
    short = replace(two.seen(motion, 1), name="short").between(0.0, SPAN[0] + 2.5 / two.RATE)
    score = score_held_out(ready([whole, short], held_out=[SPAN]), two.TRUTH, SPAN)
    assert set(score.windows.run) == {0}
    assert score.rms == pytest.approx(two.NOISE, rel=0.15)


def test_a_held_out_span_in_which_no_angle_is_measured_is_refused_before_the_fit(refusal, two, motion):
    trace = two.seen(motion, 0)
    inside = (trace.t >= 6.0) & (trace.t < 8.4)
    blind = replace(trace, theta=np.where(inside[:, None], np.nan, trace.theta))
    assert check_spans([trace], [SPAN]) == (SPAN,)
    assert "held-out: 6:8.4 has fewer than 3 measured frames" in refusal(check_spans, [blind], [SPAN])
    assert "held-out: (6.0, 8.4) has no spans" in refusal(check_spans, [trace], SPAN)
    assert "until: nan is not a time" in refusal(fitted_spans, [trace], np.nan, [], None)
