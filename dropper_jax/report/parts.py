"""Lines whose names differ only in their numbers, as one part: the worst of them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from dropper_jax.report.sections import largest, newton, table, with_rest

#: Maximum number of lines without parts.
FEW = 10


def parts(
    tension: list[dict[str, Any]], snap: list[dict[str, Any]], fatigue: list[dict[str, Any]] | dict[str, str]
) -> list[dict[str, Any]] | dict[str, str]:
    """Per part of a system of more than ten lines: the worst of its lines, from the sections of each line.

    `loop-1` to `loop-60` are the part `loop-*`. A number that all of them have is kept; a line unlike all others is a
    separate part. The values of a part are the mean tension over its lines and their links [N] and the following
    maxima, each with its line. These are the maximum tension [N] with its arc length [m] and time [s], the maximum
    utilisation (None without a breaking load), the maximum number of snaps of a link and the maximum damage per year
    (None if no line has one).

    Args:
        tension, snap, fatigue: the sections, line by line in one order.
    """
    names = [line["line"] for line in tension]
    if len(names) <= FEW:
        return {"skipped": "ten lines or fewer"}
    members = _alike(names)
    if len(members) == len(names):
        return {"skipped": "no lines whose names differ only in their numbers"}
    damaged = fatigue if isinstance(fatigue, list) else []
    return [
        {
            "part": _name([names[i] for i in own]),
            "lines": len(own),
            **_tension([tension[i] for i in own]),
            "snap": _worst([snap[i] for i in own], "most_events"),
            "fatigue": _worst([damaged[i] for i in own] if damaged else [], "damage_per_year"),
        }
        for own in members
    ]


def _alike(names: list[str]) -> list[list[int]]:
    """Indices of names that differ only in their numbers, group by group."""
    found: dict[tuple[str, ...], list[int]] = {}
    for i, name in enumerate(names):
        found.setdefault(tuple(re.split(r"\d+", name)), []).append(i)
    return list(found.values())


def _name(names: list[str]) -> str:
    """The common part of the names, with `*` for a number that differs."""
    pieces = zip(*(re.split(r"(\d+)", name) for name in names), strict=True)
    return "".join(piece[0] if len(set(piece)) == 1 else "*" for piece in pieces)


def _tension(lines: list[dict[str, Any]]) -> dict[str, Any]:
    most = max(lines, key=lambda line: line["largest"]["n"])
    loaded = [line for line in lines if line["utilisation"] is not None]
    used = max(loaded, key=lambda line: line["utilisation"]["largest"], default=None)
    kept = ("largest", "with_factor", "at_m")
    return {
        "largest": {"line": most["line"], **most["largest"]},
        "mean_n": float(np.mean([np.mean(line["mean_n"]) for line in lines])),
        "utilisation": None if used is None else {"line": used["line"], **{k: used["utilisation"][k] for k in kept}},
    }


def _worst(lines: list[dict[str, Any]], key: str) -> dict[str, Any] | None:
    """The line with the maximum value; None if no line has a value."""
    some = [line for line in lines if line.get(key) is not None]
    worst = max(some, key=lambda line: line[key], default=None)
    return None if worst is None else {"line": worst["line"], key: worst[key]}


def parts_text(found: list[dict[str, Any]] | dict[str, str]) -> list[str]:
    """The section as text; empty without parts."""
    if not isinstance(found, list):
        return []
    rows, shown = [], largest(found, lambda part: part["largest"]["n"])
    for part in shown:
        top, used, snap, tired = (part[key] for key in ("largest", "utilisation", "snap", "fatigue"))
        rows.append(
            [
                part["part"],
                str(part["lines"]),
                newton(part["mean_n"]),
                _with_line_name(part, top, f"{newton(top['n'])} at {top['at_m']:.1f} m, {top['t_s']:.2f} s"),
                "-" if used is None else _with_line_name(part, used, f"{100 * used['largest']:.1f} %"),
                _with_line_name(part, snap, str(snap["most_events"])) if snap["most_events"] else "none",
                "-" if tired is None else _with_line_name(part, tired, f"{tired['damage_per_year']:.3g}"),
            ]
        )
    head = ["part", "lines", "mean [N]", "largest [N]", "utilisation", "snaps, worst link", "damage per year"]
    return ["## Parts", with_rest(table(head, rows), len(shown), len(found), what="parts")]


def _with_line_name(part: dict[str, Any], worst: dict[str, Any], text: str) -> str:
    """A value with its line, if the part has more than one."""
    return f"{worst['line']}: {text}" if part["lines"] > 1 else text
