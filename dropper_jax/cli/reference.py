"""The reference of scenes as text and as Markdown, from the same declarations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from dropper_jax.base.read import Table

if TYPE_CHECKING:
    from dropper_jax.load.reference import Key, Section

TITLE = """# Every key of a scene

Made by `python -m dropper_jax.cli.reference` from the declarations that the reader of scenes checks against; a test
holds the page to them. `dropper scenes --reference KEY` prints a part of it, `dropper scenes --schema` the JSON Schema
for editors. `*` stands for the number or the name of an entry, paths are those of `--set`. Ranges are in the unit of
the key. `needed` keys must be given (unless a line type gives them); `none` means that nothing is there without. Words
and symbols are in the [glossary](glossary.md).
"""


def as_text(sections: Sequence[Section]) -> str:
    """Sections as text for a terminal."""
    parts = []
    for section in sections:
        parts.append("\n  ".join(filter(None, (section.head or "(top of the file)", section.about))))
        parts += list(map(_lines, section.keys))
        if section.source:
            parts.append(f"  source: {section.source}")
    return "\n".join(parts)


def _lines(key: Key) -> str:
    about = key.kind
    if key.unit != "-":
        about += f", [{key.unit}]"
    if key.allowed:
        about += f", allowed: {key.allowed}"
    return f"  {key.path}: {key.meaning}\n      {about}; default: {key.default}"


def as_values(sections: Sequence[Section]) -> list[Table]:
    """Sections as plain values."""
    found = list(map(asdict, sections))
    for section in found:
        for key in section["keys"]:
            del key["schema"]
    return found


def as_markdown(sections: Sequence[Section]) -> str:
    """The page."""
    parts = [TITLE]
    for section in sections:
        parts.append(f"## {section.head or 'Top of the file'}\n\n{_cell(section.about, False)}")
        if section.keys:
            rows = ["| key | meaning | value | unit | allowed | default |", "| --- | --- | --- | --- | --- | --- |"]
            rows += list(map(_row, section.keys))
            parts.append("\n".join(rows))
        if section.source:
            parts.append(f"Source: {_cell(section.source, False)}")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _row(key: Key) -> str:
    cells = [f"`{key.path}`", _cell(key.meaning), key.kind, key.unit, _cell(key.allowed), key.default]
    return f"| {' | '.join(cells)} |"


def _cell(text: str, table: bool = True) -> str:
    from dropper_jax.base.markdown import prose

    return prose(text, table)


if __name__ == "__main__":
    from dropper_jax.load.reference import sections as every

    print(as_markdown(every()), end="")
