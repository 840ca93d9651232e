"""Hand-written pages stay readable: short paragraphs and sentences, tables and code left out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [page for page in PAGES if not page.name.startswith("reference")]
#: What is not running text: code, tables, headings, comments, pictures.
ASIDE = re.compile(r"^```.*?^```|^\|.*$|^#.*$|<!--.*?-->|^!\[.*$", re.M | re.S)
#: Most words of a paragraph or list item, and of a sentence.
PARAGRAPH, SENTENCE = 100, 40


def paragraphs(page: Path) -> list[str]:
    """Paragraphs and list items."""
    parts = re.split(r"\n\s*\n|\n\s*(?=[-*] |\d+\. )", re.sub(ASIDE, "", page.read_text()))
    return [re.sub(r"\]\([^)]*\)", "]", " ".join(part.split())) for part in parts if part.strip()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paragraphs_and_sentences_are_short(page):
    for text in paragraphs(page):
        assert len(text.split()) <= PARAGRAPH, text[:80]
        for sentence in re.split(r"(?<=[.!?:]) +(?=[A-Z`*])", text):
            assert len(sentence.split()) <= SENTENCE, sentence
