"""The files of a farm's report: a Markdown page, a CSV file of its rows, and plain values as JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table


def write_report(
    folder: Path, name: str, found: Table, page: str, columns: Sequence[str], rows: Iterable[Table]
) -> dict[str, Path]:
    """Write NAME.md, NAME.csv and NAME.json into a folder; returns their paths by kind."""
    folder.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n", restval="", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    plain = json.dumps(jsonable(found), allow_nan=False, indent=1)
    return {
        "csv": atomic_write(folder / f"{name}.csv", text.getvalue()),
        "json": atomic_write(folder / f"{name}.json", plain + "\n"),
        "page": atomic_write(folder / f"{name}.md", page),
    }
