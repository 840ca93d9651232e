"""Damage to files: bytes flipped, cut and repeated, words and numbers replaced, arrays and provenance edited."""

import io
import json
import random
import re
import zipfile
from collections.abc import Callable

import numpy as np

Rng = random.Random
NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")
#: What stands where a number stood.
NASTY = [b"nan", b"inf", b"-inf", b"-1", b"0", b"1e308", b"-1e308", b"1e-320", b"1e9", b"1000000000", b"", b"''"]
NASTY += [b'"text"', b"true", b"[]", b"[1, 2]", b"{}", b"1e999", b"0x10", b"1_0", b"1979-05-27", b"9" * 5000]
#: Values put into provenance.
VALUES = [None, "text", -1, 0, 1e308, float("nan"), float("inf"), [], {}, True, [[]], {"a": 1}, "x" * 5000, 10**30]


def flipped(data: bytes, rng: Rng) -> bytes:
    found = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def spliced(data: bytes, rng: Rng) -> bytes:
    """Cut off, without a part, with a part twice, or with noise in it."""
    first = rng.randrange(len(data))
    size = rng.choice([1, 7, 64, 300, 1000])
    rest, part = data[first:], data[first : first + size]
    return data[:first] + rng.choice([b"", rest[size:], part + rest, rng.randbytes(min(size, 100)) + rest])


def with_another_number(data: bytes, rng: Rng) -> bytes:
    places = list(NUMBER.finditer(data))
    if not places:
        return flipped(data, rng)
    place = rng.choice(places)
    return data[: place.start()] + rng.choice(NASTY) + data[place.end() :]


def with_lines_moved(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    before, line, after = lines[:i], lines[i], lines[i + 1 :]
    moved = [[], [lines[j], line], [line + lines[j]], [b"", line]]
    return b"\n".join(rng.choice([lines[::-1], *([*before, *part, *after] for part in moved)]))


def with_another_word(data: bytes, rng: Rng) -> bytes:
    places = list(re.finditer(rb"[A-Za-z_]{2,}", data))
    if not places:
        return flipped(data, rng)
    place, other = rng.choice(places), rng.choice(places)
    word = rng.choice([other.group(), b"x" * 200_000, b"\xff\xfe", b"\x00"])
    return data[: place.start()] + word + data[place.end() :]


def odd_text(data: bytes, rng: Rng) -> bytes:
    deep = rng.choice([40, 5000])
    more = [b"x = " + b"[" * deep + b"]" * deep, b".".join([b"a"] * deep) + b" = 1", b"y" * 300_000 + b",1"]
    longer = [data + b"\n" + line + b"\n" for line in more]
    encoded = [b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data.decode(errors="replace").encode("utf-16")]
    return rng.choice([b"", data * 3, *encoded, *longer])


BYTES = [flipped, *[spliced] * 4]
TEXT = [*BYTES, *[with_another_number] * 5, with_lines_moved, with_another_word, odd_text]


def edited_archive(data: bytes, rng: Rng) -> bytes:
    """An .npz with an array or its provenance changed, its sums right again."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    name = rng.choice([*arrays, "meta", "meta", "meta"])
    if name == "meta":
        meta = json.loads(str(arrays["meta"]))
        _edit(meta, rng)
        arrays["meta"] = np.array(json.dumps(meta))
    else:
        arrays[name] = rng.choice(_DAMAGE)(np.array(arrays[name]), rng)
        if rng.random() < 0.15:
            del arrays[name]
    found = io.BytesIO()
    np.savez_compressed(found, **arrays)
    return found.getvalue()


def _edit(value: dict | list, rng: Rng) -> None:
    """Change one value somewhere inside."""
    while True:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        if not keys:
            return
        key = rng.choice(keys)
        if isinstance(value[key], dict | list) and value[key] and rng.random() < 0.8:
            value = value[key]
            continue
        if rng.random() < 0.3:
            del value[key]
        else:
            value[key] = rng.choice(VALUES)
        return


def _with_nan(a: np.ndarray, rng: Rng) -> np.ndarray:
    if a.dtype.kind == "f" and a.size:
        a.flat[rng.randrange(a.size)] = rng.choice([np.nan, np.inf, 1e308])
    return a


_DAMAGE: list[Callable[[np.ndarray, Rng], np.ndarray]] = [
    _with_nan,
    _with_nan,
    lambda a, rng: a[:-1] if a.ndim else a,
    lambda a, rng: a[..., None],
    lambda a, rng: a.astype(complex) if a.dtype.kind == "f" else a,
    lambda a, rng: np.array(["text"] * max(len(a) if a.ndim else 1, 1)),
    lambda a, rng: a.ravel(),
    lambda a, rng: a[::-1] if a.ndim else a,
    lambda a, rng: np.zeros(0),
    lambda a, rng: a.astype("f4"),
    lambda a, rng: np.zeros_like(a),
]


def oversized_archive(data: bytes, rng: Rng) -> bytes:
    """An .npz whose array says that it is far larger than its bytes."""
    shape = rng.choice([(10**12,), (10**6, 10**6), (2**62,), (1, 1, 10**15)])
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    found = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(found, "w", zipfile.ZIP_DEFLATED) as new:
        chosen = rng.choice([n for n in old.namelist() if n != "meta.npy"])
        for name in old.namelist():
            new.writestr(name, head.getvalue() + bytes(64) if name == chosen else old.read(name))
    return found.getvalue()


ARCHIVE = [*BYTES, *[edited_archive] * 6, oversized_archive]
