"""Lines of a text file of any program."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from dropper_jax.base.errors import SceneError, unreadable

#: Largest file that is read [bytes]: an hour at 1 kHz with ten columns is 300 MB.
LARGEST_FILE = 500_000_000
#: Bytes in which a zero byte shows that a file is not text.
HEAD_BYTES = 65536


def read_lines(path: Path) -> list[str]:
    """Lines of a text file that are not empty.

    Raises:
        SceneError: a file that cannot be read, is not text or is too large.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise SceneError(
                f"{path.name}: has {size / 1e9:.3g} GB; allowed: {LARGEST_FILE / 1e9:g} GB. Keep the columns of time "
                "and angle, or every tenth row"
            )
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path.name, error) from None
    if not data.strip():
        raise SceneError(f"{path.name}: is empty. Give a text file with a row per sample")
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if b"\0" in data[:HEAD_BYTES] and not wide:
        raise SceneError(f"{path.name}: is not text. Export it as CSV: a row per sample")
    encoding = "utf-16" if wide else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # headers with umlauts or degree signs of older programs
    return [line for line in text.splitlines() if line.strip() and not re.fullmatch(r"sep=.", line.strip())]
