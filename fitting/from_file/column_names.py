"""Columns by their names: words of several languages, and units."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

import numpy as np


def word_set(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


#: Words of names, without accents: English, German, French, Spanish, Italian, Portuguese, Dutch, Nordic, Polish, Czech,
#: Finnish, Chinese, Japanese.
TIME_WORDS = word_set(
    """
    t time timestamp elapsed clock seconds millis zeit uhrzeit temps heure tiempo hora tempo tijd tid czas cas aika
    sekunden sec msec 时间 時間 時刻
    """
)
FRAME_WORDS = word_set("frame frames bild bildnummer image cuadro fotogramma quadro beeld klatka snimek index idx")
ANGLE_WORDS = word_set(
    """
    theta angle angles winkel angulo angolo hoek vinkel kat uhel kulma phi alpha encoder counts count ticks
    deflection auslenkung inclination θ φ α 角度 deg rad
    """
)
RATE_WORDS = word_set(
    """
    omega velocity vel v vx vy speed rate acc acceleration a ax ay geschwindigkeit vitesse velocidad velocita w ω se
    sigma error gyro gyroscope
    """
)
#: A unit per time: `(rad/s)`, `[m s^-2]`.
PER_TIME = re.compile(r"/\s*s(?:ec)?(?:\b|\d|²)|(?:rad|deg|°|m)[\s·*.]+s\s*\^?\s*[-−⁻]\s*[12¹²]")
AXIS_WORDS = {"x": "x", "u": "x", "y": "y", "z": "y", "v": "y"}
#: Units by their words: what is measured, and the unit.
TIME_UNITS = {
    **dict.fromkeys(word_set("s sec secs second seconds sekunden secondes segundos"), "s"),
    **dict.fromkeys(word_set("ms msec millis milliseconds millisekunden"), "ms"),
    **dict.fromkeys(word_set("us µs μs usec micros microseconds"), "us"),
    **dict.fromkeys(word_set("ns nsec nanos nanoseconds"), "ns"),
}
ANGLE_UNITS = {
    **dict.fromkeys(word_set("deg degs degree degrees grad ° º grados gradi degres"), "deg"),
    **dict.fromkeys(word_set("rad rads radian radians radianti radianes"), "rad"),
    "mrad": "mrad",
    **dict.fromkeys(word_set("counts count ticks pulses steps inkremente"), "counts"),
}
LENGTH_UNITS = {"m": "m", "cm": "cm", "mm": "mm", **dict.fromkeys(word_set("px pixel pixels pix"), "px")}
UNITS = {**TIME_UNITS, **ANGLE_UNITS, **LENGTH_UNITS}


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file.

    Attributes:
        name: as written.
        words: of the name, without accents and units.
        unit: by the name, or None.
        values: (k,).
        is_clock: whether it contained times of day.
    """

    name: str
    words: tuple[str, ...]
    unit: str | None
    values: np.ndarray
    is_clock: bool

    def has(self, words: frozenset[str]) -> bool:
        """Whether one of these words is in the name."""
        return not words.isdisjoint(self.words)

    @property
    def ordinal(self) -> int | None:
        """The number in the name."""
        return next((int(word) for word in self.words if word.isdecimal()), None)

    @property
    def is_rate(self) -> bool:
        """Whether the name or its unit is that of a rate, or the name that of an error; single letters count alone
        only."""
        if PER_TIME.search(self.name):
            return True
        return any(len(word) > 1 or len(self.words) == 1 for word in RATE_WORDS.intersection(self.words))

    @property
    def moves(self) -> bool:
        """Whether the column takes several values."""
        known = self.values[np.isfinite(self.values)]
        return len(known) > 5 and np.ptp(known) > 1e-9 * np.max(np.abs(known), initial=1.0)


def parse_name(name: str) -> tuple[tuple[str, ...], str | None]:
    """Words of a name without accents and units, and the unit: `Winkel 1 [°]` is ("winkel", "1") in degrees."""
    text = "".join(c for c in unicodedata.normalize("NFKD", name.lower()) if not unicodedata.combining(c))
    inside = re.findall(r"[\[(/]\s*([^\])]*?)\s*[\])]?\s*$", text)
    unit = next((UNITS[part] for part in inside if part in UNITS), None)
    if unit is not None:
        text = re.sub(r"[\[(/][^\])]*[\])]?\s*$", "", text)
    words = re.findall(r"[^\W\d_]+|\d+|°", text)
    if unit is None and words and words[-1] in UNITS and not PER_TIME.search(text):
        if len(words) > 1:
            unit = UNITS[words.pop()]
        elif words[0] not in ("m", "s"):
            unit = UNITS[words[0]]
    return tuple(words), unit
