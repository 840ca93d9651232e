"""Lines whose names differ only in their numbers, as one part: the worst of them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.report.tables import Rows


def parts(tension: list[Table], snap: list[Table], fatigue: Rows) -> Rows:
    """Per part of a system of more than ten lines: the worst of its lines, from the sections of each line.

    `loop-1` to `loop-60` are the part `loop-*`. A number that all of them have is kept; a line unlike all others is a
    separate part. The values of a part are the mean tension over its lines and their links [N] and the following
    maxima, each with its line. These are the maximum tension [N] with its arc length [m] and time [s], the maximum
    utilisation (None without a breaking load), the maximum number of snaps of a link and the maximum damage per year
    (None if no line has one).

    Args:
        tension, snap, fatigue: the sections, line by line in one order.
    """
    # maximum number of lines without parts
    if len(tension) <= 10:
        return {"skipped": "ten lines or fewer"}
    damaged = fatigue if isinstance(fatigue, list) else [{} for _ in tension]
    groups: dict[tuple[str, ...], list[tuple[Table, Table, Table]]] = {}
    for rows in zip(tension, snap, damaged, strict=True):
        groups.setdefault(tuple(re.split(r"\d+", rows[0]["line"])), []).append(rows)
    if len(groups) == len(tension):
        return {"skipped": "no lines whose names differ only in their numbers"}
    found = []
    for group in groups.values():
        lines, snaps, tired = zip(*group, strict=True)
        found.append(
            {
                "part": _name(column(lines, "line")),
                "lines": len(lines),
                **_tension(lines),
                "snap": _worst(snaps, "most_events"),
                "fatigue": _worst(tired, "damage_per_year"),
            }
        )
    return found


def _name(names: list[str]) -> str:
    """The common part of the names, with `*` for a number that differs."""
    common = ""
    for first, *others in zip(*(re.split(r"(\d+)", name) for name in names), strict=True):
        if any(other != first for other in others):
            first = "*"
        common += first
    return common


def _tension(lines: Sequence[Table]) -> Table:
    """The tensions of a part: the mean, and the lines with the maximum tension and utilisation."""
    most = max(lines, key=lambda line: line["largest"]["n"])
    loaded = [line for line in lines if line["utilisation"] is not None]
    used = max(loaded, key=lambda line: line["utilisation"]["largest"], default=None)
    utilisation = None
    if used is not None:
        kept = {key: used["utilisation"][key] for key in ("largest", "with_factor", "at_m")}
        utilisation = {"line": used["line"], **kept}
    return {
        "largest": {"line": most["line"], **most["largest"]},
        "mean_n": float(np.mean([np.mean(line["mean_n"]) for line in lines])),
        "utilisation": utilisation,
    }


def _worst(lines: Sequence[Table], key: str) -> Table | None:
    """The line with the maximum value; None if no line has a value."""
    some = [{"line": line["line"], key: line[key]} for line in lines if line.get(key) is not None]
    return max(some, key=lambda line: line[key], default=None)
