"""Lines whose names differ only in their numbers, as one part: the worst of them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record
from dropper_jax.report.cells import Rows
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import sliced_lines


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
                "part": _name([line["line"] for line in lines]),
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


def crops(record: Record) -> Rows:
    """Per line with mussels: their mass [kg], weight in water [N] and maximum diameter [m], and the drop-off.

    A mussel drops off if the acceleration of its node exceeds `SeasonSpec.holding`. `mass_at_risk_kg` is the crop on
    links with a node above this limit, `share_beyond` the fraction of nodes and samples above it.
    """
    scene = record.scene
    sea = scene.sea
    season = scene.season
    if season is None and all(line.growth is None for line in scene.lines):
        return {"skipped": "the scene has no mussels ([growth] or [line.growth])"}
    found = []
    for bare, (line, where) in zip(scene.lines, sliced_lines(overgrown(scene)), strict=True):
        if bare.growth is None and not (season is not None and season.on(bare.name, bare.piece_of)):
            continue
        if sea is None or line.diameter is None or bare.diameter is None:
            continue  # a line with mussels has both
        crop = line.mass - bare.mass
        volume = 0.25 * np.pi * (line.diameter**2 - bare.diameter**2) * line.length
        drop_off = None
        if season is not None and season.attachment is not None and np.any(volume > 0.0):
            limit = season.holding(float(np.sum(crop) / np.sum(volume)), sea.density, sea.gravity)
            size = record.acceleration[:, where.nodes]
            hit = np.any(size > limit, axis=0)
            drop_off = {
                "limit_m_per_s2": limit,
                "largest_m_per_s2": float(size.max()),
                "share_beyond": float(np.mean(size > limit)),
                "mass_at_risk_kg": float(np.sum(crop[hit[1:] | hit[:-1]])),
            }
        found.append(
            {
                "line": bare.name,
                "mass_kg": float(np.sum(crop)),
                "wet_weight_n": float(sea.gravity * np.sum(crop - sea.density * volume)),
                "largest_diameter_m": float(np.max(line.diameter)),
                "drop_off": drop_off,
            }
        )
    return found


#: Motions in the order of `body_position` and `body_attitude`.
MOVES = ("surge", "sway", "heave")
TURNS = ("roll", "pitch", "yaw")


def body_motions(record: Record) -> Rows:
    """Per rigid body: mean, standard deviation and extremes of its reference point [m] and of its attitude [deg].

    `tilt_deg` is the angle between the body's z-axis and the vertical.
    """
    run = record.solution
    if run.body_position is None or run.body_attitude is None or not record.scene.bodies:
        return {"skipped": "the scene has no rigid bodies"}
    kept = np.isin(run.t, record.t)
    found = []
    for i, body in enumerate(record.scene.bodies):
        turn = DEGREE * run.body_attitude[kept, i]
        cosine = np.cos(run.body_attitude[kept, i, :2]).prod(axis=-1)
        tilt = DEGREE * np.arccos(np.clip(cosine, -1.0, 1.0))
        row: Table = {"body": body.name}
        for name, values in zip(MOVES, run.body_position[kept, i].T, strict=True):
            row[f"{name}_m"] = spread(values)
        for name, values in zip((*TURNS, "tilt"), (*turn.T, tilt), strict=True):
            row[f"{name}_deg"] = spread(values)
        found.append(row)
    return found
