"""Numbers of table rows; every error contains the line number in the file."""

from __future__ import annotations

import math

from dropper_jax.base.read import MOST
from dropper_jax.moordyn.reading.sections import Deck, Row


def number(deck: Deck, row: Row, text: str, what: str, low: float | None = None, open_low: bool = False) -> float:
    """A finite number, at least (or above) `low`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        deck.refuse(row.number, f"{what}: {text!r} is not a number")
    if low is not None and (value < low or (open_low and value == low)):
        deck.refuse(row.number, f"{what}: {text} is out of range; allowed: {'>' if open_low else '>='} {low:g}")
    return value


def integer(deck: Deck, row: Row, text: str, what: str, low: int = 1) -> int:
    """A whole number, at least `low`."""
    value = number(deck, row, text, what, low)
    if value > MOST:
        deck.refuse(row.number, f"{what}: {text!r} is out of range; allowed: at most {MOST}")
    if value != int(value):
        deck.refuse(row.number, f"{what}: {text!r} is not a whole number")
    return int(value)


def sizes(deck: Deck, row: Row, text: str, what: str) -> list[float]:
    """Numbers separated by bars."""
    return [number(deck, row, part, what) for part in text.split("|")]


def columns(deck: Deck, row: Row, least: int, what: str) -> None:
    """Reject a row with too few values."""
    if len(row.words) < least:
        deck.refuse(row.number, f"{what}: has {len(row.words)} values; allowed: {least}")
