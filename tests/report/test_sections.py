"""Tables of a report on many lines: the largest ones and how many there are, and lines alike as one part."""

import numpy as np

from dropper_jax import report_runs
from dropper_jax.report import sections
from dropper_jax.report.parts import parts
from dropper_jax.report.tables import SECTION_ROWS
from dropper_jax.report.text import report_markdown


def point(i):
    radii = {"radius_max_m": float(i), "radius_95_m": 0.9 * i, "radius_from_static_max_m": None}
    return {"point": f"p{i}", "buoy": None, "range_m": [1.0, 1.0, 1.0], **radii}


def test_of_many_points_the_ones_that_move_most_are_shown():
    text = sections.watch([point(i) for i in range(1400)])
    assert "| p1399 |" in text
    assert "| p1369 |" not in text
    assert text.count("\n| p") == SECTION_ROWS
    assert text.endswith(f"The largest {SECTION_ROWS} of 1400 points; report.json has all.")
    assert "report.json" not in sections.watch([point(i) for i in range(SECTION_ROWS)])


def test_lines_that_cross_are_the_nearest_of_many():
    where = {"nearest": "other", "at_m": 1.0, "nearest_at_m": 1.0, "t_s": 0.0, "diameters_m": None}
    rows = [{"line": f"l{i}", "least_distance_m": float(i), **where} for i in range(SECTION_ROWS + 1)]
    text = sections.distance(rows)
    assert ("| l0 |" in text, f"| l{SECTION_ROWS} |" in text) == (True, False)


def loaded(name, largest, mean, used, events, yearly):
    """Rows of a line in the sections of tension, snaps and fatigue."""
    share = None if used is None else {"largest": used, "with_factor": 1.67 * used, "at_m": 2.0}
    top = {"n": largest, "at_m": 3.0, "t_s": 10.0 + largest / 1000.0}
    tension = {"line": name, "largest": top, "mean_n": [mean - 1.0, mean + 1.0], "utilisation": share}
    tired = {"line": name} if yearly is None else {"line": name, "damage_per_year": yearly}
    return tension, {"line": name, "most_events": events}, tired


#: Of the twelve loops the fourth has the largest tension, the eighth the largest utilisation, the second snaps most
#: and the eleventh wears most; the legs have no breaking load.
FARM = [
    loaded("west-leg", 9000.0, 4000.0, None, 0, None),
    loaded("east-leg", 9500.0, 4100.0, None, 0, None),
    *(loaded(f"loop-{i}", 10.0 * i, 5.0 * i, 0.1, 1, 0.01 * i) for i in range(1, 13)),
]
for at, worse in {
    2: ("loop-2", 20.0, 10.0, 0.1, 6, 0.02),
    4: ("loop-4", 900.0, 20.0, 0.1, 1, 0.04),
    8: ("loop-8", 80.0, 40.0, 0.7, 1, 0.08),
    12: ("loop-12", 120.0, 60.0, None, 0, None),
}.items():
    FARM[1 + at] = loaded(*worse)


def test_loops_are_one_part_with_the_worst_of_them_by_name():
    found = parts(*map(list, zip(*FARM, strict=True)))
    assert [(part["part"], part["lines"]) for part in found] == [("west-leg", 1), ("east-leg", 1), ("loop-*", 12)]
    loops = found[-1]
    assert loops["largest"] == {"line": "loop-4", "n": 900.0, "at_m": 3.0, "t_s": 10.9}
    assert loops["mean_n"] == 5.0 * 6.5  # of 1 to 12
    assert (loops["utilisation"]["line"], loops["utilisation"]["largest"]) == ("loop-8", 0.7)
    assert loops["snap"] == {"line": "loop-2", "most_events": 6}
    assert loops["fatigue"] == {"line": "loop-11", "damage_per_year": 0.11}
    assert found[0]["utilisation"] is None
    assert found[0]["fatigue"] is None
    text = sections.parts(found)
    row = next(row for row in text.splitlines() if "loop-" in row)
    for words in ("loop-4: 900 at 3.0 m, 10.90 s", "loop-8: 70.0 %", "loop-2: 6", "loop-11: 0.11"):
        assert words in row
    tension, snap, _ = map(list, zip(*FARM, strict=True))
    assert parts(tension, snap, {"skipped": "no package"})[-1]["fatigue"] is None


def test_a_number_that_all_lines_of_a_part_share_stays_in_its_name():
    names = [f"row-{row}-loop-{i}" for row in (1, 2) for i in (1, 2, 3)] + [f"12mm-leg-{i}" for i in range(5)]
    rows = [loaded(name, 1.0, 1.0, None, 0, None) for name in names]
    found = parts(*map(list, zip(*rows, strict=True)))
    assert [(part["part"], part["lines"]) for part in found] == [("row-*-loop-*", 6), ("12mm-leg-*", 5)]


def test_ten_lines_and_lines_unlike_each_other_have_no_parts():
    ten = map(list, zip(*FARM[-10:], strict=True))
    assert parts(*ten) == {"skipped": "ten lines or fewer"}
    unlike = [loaded(name, 1.0, 1.0, None, 0, None) for name in "abcdefghijk"]
    found = parts(*map(list, zip(*unlike, strict=True)))
    assert found == {"skipped": "no lines whose names differ only in their numbers"}


def test_parts_stand_before_tensions_where_there_are_many_lines(made):
    def hung(count):
        points = [{"name": "top", "position": [0.0, 0.0, 0.0]}]
        points += [{"name": f"end-{i}", "kind": "free", "position": [float(i), 0.0, -10.0]} for i in range(count)]
        axial = {"law": "rope", "EA": 1e6}
        line = {"from": "top", "links": 1, "length": 10.0, "mass": 1.0, "nodes": "shared", "axial": axial}
        lines = [{"name": f"drop-{i}", "to": f"end-{i}"} | line for i in range(count)]
        table = {"run": {"dt": 0.1, "duration": 1.0}, "point": points, "line": lines, "effects": {"weight": {}}}
        nodes = np.array([[[0.0, 0.0, 0.0], [float(i), 0.0, -10.0]] for i in range(count)]).reshape(-1, 3)
        return made(table, np.tile(nodes, (6, 1, 1)), 100.0 + np.arange(count) * np.ones((6, 1)))

    found = report_runs({"run": hung(11)})
    (part,) = found["runs"][0]["parts"]
    assert (part["part"], part["largest"]["line"], part["largest"]["n"]) == ("drop-*", "drop-10", 110.0)
    text = report_markdown(found, [{}])
    assert 0 < text.index("## Parts") < text.index("## Tension")
    assert "## Bodies" not in text
    assert "## Parts" not in report_markdown(report_runs({"run": hung(10)}), [{}])
