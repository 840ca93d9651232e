"""The tables of `docs/` and the README, written from measurements in `results/` so that nobody copies numbers by hand.

    python benchmarks/tables.py [--measure]

With --measure the measurements are made again first: `dropper stability`, `dropper accuracy dropper-north-sea --quick`
and `benchmarks/north_sea.py`, about ten minutes. A table is in a document between the lines
`<!-- table: NAME -->` and `<!-- end -->`.
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
    "files_of_users",
    "fit_tables",
    "moordyn_hard_cases",
    "moordyn_tables",
    "edulis_anchors",
)
for part in (*PARTS, "measured_once", "source_tables"):
    import_module(part)  # enters its tables

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
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


def filled(text: str) -> str:
    """A document with the tables that it asks for."""
    for name in re.findall(r"<!-- table: (\w+) -->", text):
        results, make = TABLES[name]
        table = make(*(stored(result) for result in results))
        table = table if isinstance(table, str) else markdown(table)
        place = re.compile(rf"(<!-- table: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = place.sub(lambda found, table=table: f"{found[1]}\n{table}\n\n{found[2]}", text)
    return text


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
