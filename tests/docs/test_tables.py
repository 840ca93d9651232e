"""Tables of the documentation are those of the committed results."""

from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def tables():
    import tables

    return tables


def test_tables_in_the_documents_are_those_of_the_results(tables):
    for document in tables.documents():
        assert tables.filled(document.read_text()) == document.read_text(), document.name


def test_every_table_is_in_a_document(tables):
    shown = {place[2] for document in tables.documents() for place in tables.PLACE.finditer(document.read_text())}
    made = {name for name, (results, _) in tables.TABLES.items() if results != ("measured_once",)}
    assert made - shown == set()


def test_a_document_shows_some_columns_and_rows_of_a_table(tables):
    table = "| a | b \\| c | d |\n| --- | --- | --- |\n| 1 | 2 | 3 |\n| 4 | 5 | 6 |\n\nBelow."
    assert tables.part_of(table, None, None) == table
    assert tables.part_of(table, "3 2", "2") == "| d | b \\| c |\n| --- | --- |\n| 6 | 5 |\n\nBelow."


def test_a_speed_that_is_not_reached_is_marked(tables):
    errors = {"mean": 1e-3, "std": 2e-2}
    ours = [{"dt_s": 0.02, "cpu_per_s": 1e-3, "errors": errors}]
    ours += [{"dt_s": 0.05, "cpu_per_s": 4e-4, "errors": errors}]
    row = {"name": "chain", "wanted": 3.0, "moordyn": {"cpu_per_s": 2e-3, "errors": errors}, "our_runs": ours}
    row = {**row, "law": "rope", "integrator": "rk4"}
    rows = tables.TABLES["moordyn_speed"][1](
        {
            "speed": [
                {**row, "all_steps": None, "below_5_hz": {"ratio": 1.357, "ours_dt_s": 0.02}},
                {**row, "all_steps": None, "below_5_hz": None},
                {**row, "all_steps": {"ratio": 3.43, "ours_dt_s": 0.05}, "below_5_hz": None},
                {**row, "all_steps": {"ratio": 0.68, "ours_dt_s": 0.05}, "below_5_hz": None},
            ]
        }
    )
    assert [cells[-1] for cells in rows[1:]] == [
        "**at no step tried**; 1.4 times faster for means over 0.1 s (at 0.02 s)",
        "**at no step tried**",
        "3.4 times faster (at 0.05 s)",
        "**0.68 times as fast (at 0.05 s)**",
    ]
    assert rows[1][1:7] == ("rope, rk4", "2", "1.0e-03, 2.0e-02", "0.02", "1", "1.0e-03, 2.0e-02")
    assert rows[3][4:6] == ("0.05", "0.4")
