"""The page that compares the sources' tables with the packaged scenes says what these have."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.check
def test_numbers_next_to_the_sources_tables_are_those_of_the_scenes():
    import sources

    stored = json.loads((ROOT / "benchmarks" / "results" / "sources.json").read_text())
    assert [list(row) for row in sources.paper()] == stored["paper"][:-1]  # the last one takes four tides
    assert [list(row) for row in sources.figures()] == stored["figures"]
    known = {row[0]: row for row in stored["thesis"]}
    rows = [*sources.lab_dropper(), *sources.release_angles(), *sources.north_sea()]
    assert [list(row) for row in rows] == [known[row[0]] for row in rows]
    page = (ROOT / "docs" / "checked-against.md").read_text()
    tables = ["2.1", "3.1", "3.2", "8.1", "8.2", "8.3", "8.5", "D.1", "E.1", "G waves"]
    assert all(f"| {table}" in page for table in (*tables, *map(str, range(1, 8)), "A1"))
