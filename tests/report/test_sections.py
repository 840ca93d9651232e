"""Tables of a report on many parts: the largest ones, and how many there are."""

from dropper_jax.report.sections import MOST_ROWS, watch


def point(i):
    return {
        "point": f"p{i}",
        "buoy": None,
        "radius_max_m": float(i),
        "radius_95_m": 0.9 * i,
        "radius_from_static_max_m": None,
        "range_m": [1.0, 1.0, 1.0],
    }


def test_of_many_points_the_ones_that_move_most_are_shown():
    text = watch([point(i) for i in range(1400)])
    assert "| p1399 |" in text
    assert "| p1369 |" not in text
    assert text.count("\n| p") == MOST_ROWS
    assert text.endswith(f"The largest {MOST_ROWS} of 1400 points; report.json has all.")
    assert "report.json" not in watch([point(i) for i in range(MOST_ROWS)])
