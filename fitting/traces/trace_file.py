"""Files of angle traces: the format that tracking writes and fitting reads.

A file is a CSV with columns `t, theta_1..n[, omega_1..n][, se_1..n]` and comment lines such as
`# zero=down, sign=1, unit=rad, model_error=1e-4`; a missing sample is empty. Rates omega are not used. Comments
`# warning: ...` become warnings, others are for people.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import atomic_write
from dropper_jax.base.markdown import first_names
from fitting.traces.csv_table import MOST_NAMES, read_csv
from fitting.traces.trace import Trace, check_trace, convention

#: Names of columns.
COLUMN_NAME = re.compile(r"t|(theta|omega|se)_\d+")
#: Keys of a comment.
KEYS = ("zero", "sign", "unit", "model_error")
#: The same, also misspelled, before `=`, or before a colon where a part of a comment starts.
KEY_PATTERN = r"zeros?|signs?|units?|model_?errors?"
KEY = re.compile(rf"\b({KEY_PATTERN})\s*=", re.IGNORECASE)
KEY_COLON = re.compile(rf"(^|[,;])\s*({KEY_PATTERN})\s*:", re.IGNORECASE)
#: Where a value ends: at a comma, a semicolon or the next key.
VALUE_END = re.compile(r"[,;]|\s\w+\s*=")
#: Prefix of comments that are warnings.
WARNING_PREFIX = "warning: "
#: Maximum error of a written time, over the shortest step, for which 9 digits are enough.
TIME_ERROR = 1e-3


def as_trace(
    given: Trace | str | Path, links: int, columns: Mapping[str, str] | None = None, partial: bool = False
) -> Trace:
    """A trace, read if its file is given, with `columns` and `partial` as for `read_trace`.

    Raises:
        SceneError: it has angles of another number of links, or something that cannot be fitted (`check_trace`).
    """
    if isinstance(given, Trace):
        trace = _with_arrays(given)
        stated = trace.convention
        convention(stated.zero, stated.sign, stated.unit, trace.name)
        _read_model_error(trace.name, trace.model_error)
        check_trace(trace, partial)
    else:
        trace = read_trace(given, links, columns, partial)
    if trace.links != links:
        raise SceneError(f"{trace.name}: has {trace.links} angles, but the scene has {links} links; allowed: {links}")
    return trace


def _with_arrays(trace: Trace) -> Trace:
    """The trace with arrays of numbers, also if it was built from lists; infinite samples are missing.

    Raises:
        SceneError: something else than numbers, rows of different lengths.
    """
    given = {"t": trace.t, "theta": trace.theta}
    if trace.se is not None:
        given["se"] = trace.se
    try:
        if any(map(np.iscomplexobj, given.values())):
            raise TypeError
        arrays = {key: np.asarray(values, float) for key, values in given.items()}
    except (TypeError, ValueError):
        raise SceneError(
            f"{trace.name}: t, theta and se are not arrays of numbers; allowed: t (k,), theta and se (k, links)"
        ) from None
    arrays["theta"] = np.where(np.isinf(arrays["theta"]), np.nan, arrays["theta"])
    return replace(trace, **arrays)


def read_trace(
    path: str | Path, links: int | None = None, columns: Mapping[str, str] | None = None, partial: bool = False
) -> Trace:
    """A trace from a CSV file.

    Args:
        links: number of them in the scene, if known.
        columns: the file's columns if they have other names, such as `{"time": "timestamp", "theta_1": "angle"}`;
            columns that are neither listed nor have names of a trace are then left out.
        partial: whether some of the `links` may have no column, or an empty one.

    Raises:
        SceneError: one line with the file, the error and the allowed values.
    """
    path = Path(path)
    renamed = dict(columns or {})
    if "time" in renamed:
        renamed["t"] = renamed.pop("time")
    for name in renamed:
        if not COLUMN_NAME.fullmatch(name):
            raise SceneError(f"columns: {name!r} is unknown; allowed: time, theta_1..n, omega_1..n, se_1..n")
    table = read_csv(path, "t, theta_1..n", renamed, lambda names: _how_to_rename(names, links))
    if renamed:
        table = table._replace(names=[name if COLUMN_NAME.fullmatch(name) else "" for name in table.names])
    values = table.columns()
    if partial and any(name.startswith("theta_") for name in values):
        for name in column_names("theta", links or 0):
            values.setdefault(name, np.full(len(table.rows), np.nan))
    count = _check_columns(path.name, list(values), links)
    stated = _header_values(path.name, table.comments)
    se = _stack_columns(values, "se", count) if "se_1" in values else None
    trace = Trace(
        name=path.stem,
        t=values["t"],
        theta=_stack_columns(values, "theta", count),
        se=se,
        convention=convention(stated.get("zero"), stated.get("sign"), stated.get("unit"), path.name),
        warnings=tuple(c.removeprefix(WARNING_PREFIX) for c in table.comments if c.startswith(WARNING_PREFIX)),
        model_error=_read_model_error(path.name, stated.get("model_error", "0")),
    )
    check_trace(trace, partial)
    return trace


def column_names(kind: str, links: int) -> list[str]:
    """The columns of a file that have `theta`, `omega` or `se` of its links."""
    return [f"{kind}_{j + 1}" for j in range(links)]


def _stack_columns(values: Mapping[str, np.ndarray], kind: str, links: int) -> np.ndarray:
    """The columns of one kind, side by side (k, links)."""
    return np.column_stack([values[name] for name in column_names(kind, links)])


def _how_to_rename(names: Sequence[str], links: int | None) -> str:
    """What to do with a file whose columns have other names."""
    time = "t"
    renamed = []
    if "t" not in names:
        time = next((name for name in names if name.lower().startswith("t")), names[0])
        renamed.append(f"time={time}")
    if "theta_1" not in names:
        angle = next((name for name in names if name != time), "...")
        renamed.append(f"theta_1={angle}")
    columns = shlex.quote(",".join(renamed))
    if links == 1:
        return f"rename to t, theta_1, or --columns {columns}"
    return f"rename to t, theta_1 ... theta_{links or 'n'}, or --columns {columns},..."


def _check_columns(file: str, names: list[str], links: int | None) -> int:
    """Number of links of a file with these columns; rejects columns that are unknown or incomplete."""
    count = sum(re.fullmatch(r"theta_\d+", name) is not None for name in names)
    found = first_names(names, MOST_NAMES)
    if count == 0:
        raise SceneError(f"{file}: has no column 'theta_1'; found: {found}; {_how_to_rename(names, links)}")
    if links is not None and count != links:
        raise SceneError(f"{file}: has {count} columns theta_1..n, but the scene has {links} links; allowed: {links}")
    kinds = ("theta", "omega", "se")
    known = ["t", *chain.from_iterable(column_names(kind, count) for kind in kinds)]
    for name in names:
        if name not in known:
            raise SceneError(f"{file}: unknown column {name!r}; {nearest(name, known)}")
    for kind in kinds:
        have = [name for name in names if name.startswith(f"{kind}_")]
        if len(have) not in (0, count):
            raise SceneError(f"{file}: columns {kind}_1..{count} are not complete; found: {found}")
    return count


def _header_values(file: str, comments: Sequence[str]) -> dict[str, str]:
    """The values `key=value` or `key: value` of `KEYS` in comments that are not warnings; others are for people.

    Raises:
        SceneError: a misspelled key, or one with two values.
    """
    found: dict[str, str] = {}
    for comment in comments:
        if comment.startswith(WARNING_PREFIX):
            continue
        _, *parts = KEY.split(KEY_COLON.sub(r"\1 \2=", comment))
        for key, text in zip(parts[::2], parts[1::2], strict=True):
            if key not in KEYS:
                raise SceneError(f"{file}: unknown key {key!r} in a comment; {nearest(key.lower(), KEYS)}")
            value = VALUE_END.split(text, 1)[0].strip()
            if key != "model_error":
                value = value.partition(" ")[0]
            if found.setdefault(key, value) != value:
                raise SceneError(f"{file}: {key} = {found[key]!r} and {key} = {value!r}; allowed: one value")
    return found


def _read_model_error(file: str, text: str | float) -> float:
    """The model error that a comment or a trace in memory states.

    Raises:
        SceneError: not a number, below 0 or not finite.
    """
    try:
        error = float(text)
    except ValueError:
        error = -1.0
    if not 0.0 <= error < np.inf:
        raise SceneError(
            f"{file}: model_error = {text!r}: not an angle; allowed: a number of at least 0, in the unit of the angles"
        )
    return error


def write_trace(path: str | Path, trace: Trace, notes: Sequence[str] = ()) -> Path:
    """Write a trace in the format that `read_trace` reads; `notes` are for people, each one comment that states nothing
    of the trace: without `=` and line breaks."""
    names = ["t", *column_names("theta", trace.links)]
    columns = trace.theta
    if trace.se is not None:
        names += column_names("se", trace.links)
        columns = np.concatenate([trace.theta, trace.se], axis=1)
    c = trace.convention
    head = f"# zero={c.zero or 'horizontal'}, sign={c.sign or 1}, unit={c.unit or 'rad'}"
    if trace.model_error:
        head += f", model_error={trace.model_error:.9g}"
    lines = [head, *(f"# {_plain_note(note)}" for note in notes)]
    lines += [f"# {WARNING_PREFIX}{_one_line(warning)}" for warning in trace.warnings]
    lines.append(",".join(names))
    for time, row in zip(_time_cells(trace.t), columns, strict=True):
        lines.append(",".join([time, *map(_cell, row)]))
    return atomic_write(path, "\n".join(lines) + "\n")


def _one_line(text: str) -> str:
    """The text without line breaks."""
    return " ".join(text.splitlines())


def _plain_note(note: str) -> str:
    """The note as a comment from which no value is read."""
    return KEY_COLON.sub(r"\1 \2", _one_line(note).replace("=", " "))


def _time_cells(t: np.ndarray) -> list[str]:
    """Times of a trace file with 9 digits, or with all if 9 are too few for the steps, as of seconds since 1970."""
    cells = [f"{time:.9g}" for time in t]
    error = np.max(np.abs(np.array(cells, float) - t), initial=0.0)
    if error < TIME_ERROR * np.min(np.diff(t), initial=np.inf):
        return cells
    return [str(time) for time in t.tolist()]


def _cell(number: float) -> str:
    """A number of a trace file; a missing sample is empty."""
    if np.isnan(number):
        return ""
    return f"{number:.9g}"
