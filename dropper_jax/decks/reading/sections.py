"""A MoorDyn input file as sections of rows, each with its line number. Plain text only; nothing is interpreted here.

Sections are recognised by their header, words between dashes. Text before the first header is free text, which MoorDyn
ignores. Lines of the form `! KEY = VALUE` there are values of the scene without a counterpart in MoorDyn's tables
(names, run settings).
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import read_lines
from dropper_jax.base.read import MAX_COUNT

#: Headers of both versions, and the section that they start.
HEADERS = {
    "LINE TYPES": "line types",
    "LINE DICTIONARY": "line types",
    "ROD TYPES": "rod types",
    "ROD DICTIONARY": "rod types",
    "BODIES": "bodies",
    "BODY LIST": "bodies",
    "BODY PROPERTIES": "bodies",
    "RODS": "rods",
    "ROD LIST": "rods",
    "ROD PROPERTIES": "rods",
    "POINTS": "points",
    "POINT LIST": "points",
    "POINT PROPERTIES": "points",
    "CONNECTION PROPERTIES": "points",
    "NODE PROPERTIES": "points",
    "LINES": "lines",
    "LINE LIST": "lines",
    "LINE PROPERTIES": "lines",
    "FAILURE": "failure",
    "CONTROL": "control",
    "EXTERNAL LOADS": "external loads",
    "SYROPE IC": "syrope ic",
    "OPTIONS": "options",
    "SOLVER OPTIONS": "options",
    "OUTPUTS": "outputs",
    "OUTPUT": "outputs",
}
#: Sections whose first two lines are column names and units.
TABLES = {*HEADERS.values()} - {"options", "outputs"}
#: Headers that end the file.
LAST = ("NEED THIS LINE", "END")
_HEADER = re.compile(r"^\s*-{3,}\s*(.*?)\s*-*\s*$")
_COUNT = re.compile(r"^\s*\d+\s+N[A-Z]\w*\b")  # `3  NLines - number of line objects`
_NOTE = re.compile(r"^\s*!\s*([A-Za-z_][\w.]*)\s*=\s*(.+?)\s*$")


@dataclass
class Deck:
    """A file in sections.

    Attributes:
        path: path of the file.
        rows: rows of each section.
        first: line of the header of each section that the file has.
        heads: words of the lines of column names and of units of each table.
        given: values of the free text, by key.
        noted: their lines.
        notes: what the scene lacks or has otherwise, one line each.
    """

    path: Path
    rows: dict[str, list[Row]] = field(default_factory=lambda: defaultdict(list))
    first: dict[str, int] = field(default_factory=dict)
    heads: dict[str, list[tuple[str, ...]]] = field(default_factory=lambda: defaultdict(list))
    given: dict[str, str] = field(default_factory=dict)
    noted: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def refuse(self, number: int, text: str) -> NoReturn:
        """Raise an error for a line of this file."""
        raise SceneError(f"{self.path}:{number}: {text}")

    def require(self, section: str) -> list[Row]:
        """Rows of a required section."""
        if section not in self.first:
            self.refuse(1, f"section {section.upper()!r} is missing")
        if not self.rows[section]:
            self.refuse(self.first[section], f"section {section.upper()!r} is empty")
        return self.rows[section]

    def columns(self, section: str) -> list[str]:
        """Column names of a table, in small letters."""
        heads = self.heads[section]
        if not heads:
            return []
        return [word.lower() for word in heads[0]]


@dataclass(frozen=True, eq=False)
class Row:
    """One line of a table: its number in the file, its words, and the comment that follows them.

    Its numbers are read by their position among the words; every error has the file and the line.
    """

    deck: Deck
    number: int
    words: tuple[str, ...]
    comment: str = ""

    @property
    def given_name(self) -> str:
        """The name given by a comment `name: NAME`, or an empty text; MoorDyn itself only numbers its objects."""
        label, _, name = self.comment.partition(":")
        if label.strip() == "name":
            return name.strip()
        return ""

    def name(self, kind: str) -> str:
        """The given name, by default `KIND-ID`."""
        return self.given_name or f"{kind}-{self.words[0]}"

    def note(self, text: str) -> None:
        """Add a note on this line."""
        self.deck.notes.append(f"line {self.number}: {text}")

    def refuse(self, text: str) -> NoReturn:
        """Raise an error for this line."""
        self.deck.refuse(self.number, text)

    def need(self, count: int, what: str) -> None:
        """Reject a row with too few words."""
        if len(self.words) < count:
            self.refuse(f"{what}: has {len(self.words)} values; allowed: {count}")

    def read(self, text: str, what: str, low: float = -math.inf, above: float = -math.inf) -> float:
        """The finite number of a text, at least `low` and greater than `above`."""
        if not is_number(text) or not math.isfinite(float(text)):
            self.refuse(f"{what}: {text!r} is not a number")
        value = float(text)
        if value < low:
            self.refuse(f"{what}: {text} is out of range; allowed: >= {low:g}")
        if value <= above:
            self.refuse(f"{what}: {text} is out of range; allowed: > {above:g}")
        return value

    def value(self, at: int, what: str, low: float = -math.inf, above: float = -math.inf) -> float:
        """The number of a word."""
        return self.read(self.words[at], what, low, above)

    def values(self, first: int, end: int, what: str, low: float = -math.inf) -> list[float]:
        """The numbers of several words."""
        return [self.read(word, what, low) for word in self.words[first:end]]

    def parts(self, at: int, what: str, counts: tuple[int, ...]) -> list[float]:
        """The numbers of a word, which bars separate; `counts` are the allowed numbers of them."""
        parts = self.words[at].split("|")
        if len(parts) not in counts:
            self.refuse(
                f"{what}: {self.words[at]!r} has {len(parts)} numbers; allowed: {' or '.join(map(str, counts))}"
            )
        return [self.read(part, what) for part in parts]

    def integer(self, at: int, what: str, low: int = 1) -> int:
        """The whole number of a word, at least `low`."""
        value = self.value(at, what, low)
        if value > MAX_COUNT:
            self.refuse(f"{what}: {self.words[at]!r} is out of range; allowed: at most {MAX_COUNT}")
        if value != int(value):
            self.refuse(f"{what}: {self.words[at]!r} is not a whole number")
        return int(value)


def header(line: str) -> str | None:
    """Words of a header line in capitals; None if the line is not a header."""
    found = _HEADER.match(line)
    if found is None:
        return None
    return " ".join(found[1].strip("- ").upper().split())


def _name(words: str) -> str | None:
    """The section that a header starts; some files add words to headers, and MoorDyn only searches for its own
    words."""
    words = " ".join(re.split(r"[(:,]", words)[0].split())
    matching = [known for known in HEADERS if f"{words} ".startswith(f"{known} ")]
    if matching:
        return HEADERS[max(matching, key=len)]
    return None


def read_input(path: Path) -> str:
    """The text of an input file, without a byte order mark."""
    return "\n".join(read_lines(path)).removeprefix("\ufeff")


def looks_like_moordyn(text: str) -> bool:
    """Whether a text has the header of MoorDyn's line types."""
    return any(_name(words) == "line types" for line in text.splitlines() if (words := header(line)) is not None)


def split_file(path: str | Path, text: str) -> Deck:
    """The sections of a file.

    Raises:
        SceneError: an unknown header after the first section, or a section given twice, with its line.
    """
    deck = Deck(Path(path))
    section = None
    for number, line in enumerate(text.splitlines(), start=1):
        words = header(line)
        if words is not None:
            if section is not None and any(last in words for last in LAST):
                break
            name = _name(words)
            if name is None and section is not None and words:  # not a rule without words
                deck.refuse(number, f"section {words!r} is unknown; {nearest(words, HEADERS)}")
            if name in deck.first:
                deck.refuse(number, f"section {words!r} is given twice, first in line {deck.first[name]}")
            if name is not None:
                section = name
                deck.first[name] = number
            continue
        if section is None:
            if note := _NOTE.match(line):
                deck.given[note[1]] = note[2]
                deck.noted[note[1]] = number
            continue
        row = _row(deck, number, line)
        heads = deck.heads[section]
        if section in TABLES and len(heads) < 2:
            if heads or not _COUNT.match(line):  # older files give the number of rows
                heads.append(row.words)
        elif section == "outputs" and row.words[:1] == ("END",):
            break
        elif row.words:
            deck.rows[section].append(row)
    return deck


def _row(deck: Deck, number: int, line: str) -> Row:
    """Words up to a comment, which starts with `!`, `#` or `%` (a `#` inside a word is part of it)."""
    words, *comment = re.split(r"(?:^|\s)[!#%]", line, maxsplit=1)
    return Row(deck, number, tuple(words.split()), "".join(comment))


def is_number(text: str) -> bool:
    """Whether a word is a number, not the name of a file."""
    try:
        float(text)
    except ValueError:
        return False
    return True
