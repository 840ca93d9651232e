"""The tables of `docs/` and the README, written from measurements in `results/` so that nobody copies numbers by hand.

    python benchmarks/tables.py [--measure]

With --measure the measurements are made again first: `dropper stability`, `dropper accuracy dropper-north-sea --quick`
and `benchmarks/north_sea.py`, about ten minutes. A table is in a document between the lines
`<!-- table: NAME -->` and `<!-- end -->`; `<!-- table: NAME; columns 1 3; rows 2 5 -->` shows a part of it, by numbers
from 1.
"""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from study import RESULTS, TABLES, command, markdown, stored

PARTS = (
    "accuracy_tables",
    "coarse_lines",
    "equal_error",
    "files_of_users",
    "fit_tables",
    "gpu",
    "moordyn_hard_cases",
    "moordyn_tables",
    "edulis_anchors",
    "paper_peaks",
)
for part in (*PARTS, "measured_once", "source_tables"):
    import_module(part)  # enters its tables

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
#: A table in a document: the line before it, its name, its columns and rows where only some are shown, the line after.
PLACE = re.compile(r"(<!-- table: (\w+)(?:; columns ([\d ]+))?(?:; rows ([\d ]+))? -->\n).*?(<!-- end -->)", re.DOTALL)
COMMANDS = {
    "stability": ["stability", "--json", "--quiet"],
    "accuracy_north_sea": ["accuracy", "dropper-north-sea", "--quick", "--json", "--quiet"],
}


def measure() -> None:
    """Make the measurements again."""
    for name, arguments in COMMANDS.items():
        call = "import sys; from dropper_jax.cli import main; sys.exit(main(sys.argv[1:]))"
        done = subprocess.run([sys.executable, "-c", call, *arguments], stdout=subprocess.PIPE, text=True, check=False)
        (RESULTS / f"{name}.json").write_text(done.stdout)  # a case beyond its limit is a row like the others
    subprocess.run([sys.executable, HERE / "north_sea.py"], check=True)


def part_of(table: str, columns: str | None, rows: str | None) -> str:
    """The columns and rows of a table with these numbers, with its head and the text below it; None: all of them."""
    lines = [line for line in table.splitlines() if line.startswith("|")]
    below = table[table.index(lines[-1]) + len(lines[-1]) :]
    if rows is not None:
        lines = lines[:2] + [lines[int(row) + 1] for row in rows.split()]
    if columns is not None:
        shown = [int(column) - 1 for column in columns.split()]
        lines = ["| " + " | ".join(cells[i] for i in shown) + " |" for cells in map(cells_of, lines)]
    return "\n".join(lines) + below


def cells_of(line: str) -> list[str]:
    """The cells of a line of a table."""
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def filled(text: str) -> str:
    """A document with the tables that it asks for."""

    def with_table(place: re.Match[str]) -> str:
        before, name, columns, rows, after = place.groups()
        results, make = TABLES[name]
        table = make(*(stored(result) for result in results))
        if not isinstance(table, str):
            table = markdown(table)
        return f"{before}\n{part_of(table, columns, rows)}\n\n{after}"

    return PLACE.sub(with_table, text)


def documents() -> list[Path]:
    """The README and the pages of `docs/`."""
    return [HERE.parent / "README.md", *sorted(DOCS.glob("*.md"))]


def write() -> None:
    """Put the tables into the documents that ask for them."""
    for document in documents():
        document.write_text(filled(document.read_text()))


@command(measure=False)
def main(args) -> None:
    if args.measure:
        measure()
    write()
