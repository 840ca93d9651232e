"""Lines whose names differ only in their numbers, as one part: the worst of them."""

from __future__ import annotations

import re

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.markdown import table
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, spread
from dropper_jax.report.sections import Cells, Rows, empty_unless_rows, largest_table, newton, table_of, with_position
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
    names = [line["line"] for line in tension]
    # maximum number of lines without parts
    if len(names) <= 10:
        return {"skipped": "ten lines or fewer"}
    members = _alike(names)
    if len(members) == len(names):
        return {"skipped": "no lines whose names differ only in their numbers"}
    damaged = fatigue if isinstance(fatigue, list) else []
    found = []
    for own in members:
        found.append(
            {
                "part": _name([names[i] for i in own]),
                "lines": len(own),
                **_tension([tension[i] for i in own]),
                "snap": _worst([snap[i] for i in own], "most_events"),
                "fatigue": _worst([damaged[i] for i in own] if damaged else [], "damage_per_year"),
            }
        )
    return found


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


def _tension(lines: list[Table]) -> Table:
    most = max(lines, key=lambda line: line["largest"]["n"])
    loaded = [line for line in lines if line["utilisation"] is not None]
    used = max(loaded, key=lambda line: line["utilisation"]["largest"], default=None)
    kept = ("largest", "with_factor", "at_m")
    utilisation = None
    if used is not None:
        utilisation = {"line": used["line"], **{k: used["utilisation"][k] for k in kept}}
    return {
        "largest": {"line": most["line"], **most["largest"]},
        "mean_n": float(np.mean([np.mean(line["mean_n"]) for line in lines])),
        "utilisation": utilisation,
    }


def _worst(lines: list[Table], key: str) -> Table | None:
    """The line with the maximum value; None if no line has a value."""
    some = [line for line in lines if line.get(key) is not None]
    worst = max(some, key=lambda line: line[key], default=None)
    if worst is None:
        return None
    return {"line": worst["line"], key: worst[key]}


@empty_unless_rows
def parts_text(found: list[Table]) -> list[str]:
    """The section as text; empty without parts."""
    return ["## Parts", largest_table(found, lambda part: part["largest"]["n"], _part_row, what="parts")]


def _part_row(part: Table) -> Cells:
    top = part["largest"]
    used = part["utilisation"]
    snap = part["snap"]
    tired = part["fatigue"]
    utilisation = "-"
    if used is not None:
        utilisation = _with_line_name(part, used, f"{100 * used['largest']:.1f} %")
    return {
        "part": part["part"],
        "lines": str(part["lines"]),
        "mean [N]": newton(part["mean_n"]),
        "largest [N]": _with_line_name(part, top, with_position(top, newton(top["n"]))),
        "utilisation": utilisation,
        "snaps, worst link": _with_line_name(part, snap, str(snap["most_events"])) if snap["most_events"] else "none",
        "damage per year": "-" if tired is None else _with_line_name(part, tired, f"{tired['damage_per_year']:.3g}"),
    }


def _with_line_name(part: Table, worst: Table, text: str) -> str:
    """A value with its line, if the part has more than one."""
    if part["lines"] > 1:
        return f"{worst['line']}: {text}"
    return text


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
    full = overgrown(scene)
    size = record.acceleration
    found = []
    for bare, (line, where) in zip(scene.lines, sliced_lines(full), strict=True):
        crop = line.mass - bare.mass
        if bare.growth is None and not (season is not None and season.on(bare.name, bare.piece_of)):
            continue
        if sea is None or line.diameter is None or bare.diameter is None:
            continue  # a line with mussels has both
        volume = 0.25 * np.pi * (line.diameter**2 - bare.diameter**2) * line.length
        row: Table = {
            "line": bare.name,
            "mass_kg": float(np.sum(crop)),
            "wet_weight_n": float(sea.gravity * np.sum(crop - sea.density * volume)),
            "largest_diameter_m": float(np.max(line.diameter)),
            "drop_off": None,
        }
        if season is not None and season.attachment is not None and np.any(volume > 0.0):
            limit = season.holding(float(np.sum(crop) / np.sum(volume)), sea.density, sea.gravity)
            beyond = size[:, where.nodes] > limit
            hit = np.any(beyond, axis=0)
            row["drop_off"] = {
                "limit_m_per_s2": limit,
                "largest_m_per_s2": float(size[:, where.nodes].max()),
                "share_beyond": float(beyond.mean()),
                "mass_at_risk_kg": float(np.sum(crop[hit[1:] | hit[:-1]])),
            }
        found.append(row)
    return found


@empty_unless_rows
def crop_text(found: list[Table]) -> list[str]:
    """The section as text; empty without mussels."""
    text = table_of([_crop_row(row) for row in found])
    if all(row["drop_off"] is None for row in found):
        return ["## Mussels", text, "Drop-off is not computed: give `growth.attachment` and `growth.mussel_mass`."]
    return ["## Mussels", text]


def _crop_row(row: Table) -> Cells:
    off = row["drop_off"]
    shares = ("-", "-", "-")
    if off is not None:
        reached = f"{off['largest_m_per_s2']:.3g} / {off['limit_m_per_s2']:.3g}"
        shares = (reached, f"{100 * off['share_beyond']:.3g}", f"{off['mass_at_risk_kg']:.4g}")
    columns = ("acceleration, maximum / drop-off [m/s^2]", "exceeded [% of nodes and time]", "at risk [kg]")
    return {
        "line": row["line"],
        "mussels [kg]": f"{row['mass_kg']:.4g}",
        "weight in water [N]": f"{row['wet_weight_n']:.4g}",
        "largest diameter [m]": f"{row['largest_diameter_m']:.3g}",
        **dict(zip(columns, shares, strict=True)),
    }


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
        position = run.body_position[kept, i]
        turn = run.body_attitude[kept, i]
        tilt = np.arccos(np.clip(np.cos(turn[:, 0]) * np.cos(turn[:, 1]), -1.0, 1.0))
        moves = {f"{name}_m": spread(position[:, j]) for j, name in enumerate(MOVES)}
        turns = {f"{name}_deg": spread(DEGREE * turn[:, j]) for j, name in enumerate(TURNS)}
        found.append({"body": body.name, **moves, **turns, "tilt_deg": spread(DEGREE * tilt)})
    return found


@empty_unless_rows
def bodies_text(found: list[Table]) -> list[str]:
    """The section as text; empty without bodies."""
    rows = []
    for body in found:
        for key in (*(f"{name}_m" for name in MOVES), *(f"{name}_deg" for name in TURNS), "tilt_deg"):
            name, _, unit = key.partition("_")
            cells = (f"{0.0 if abs(body[key][k]) < 5e-4 else body[key][k]:.3f}" for k in ("mean", "std", "min", "max"))
            rows.append([body["body"], f"{name} [{unit}]", *cells])
    return ["## Bodies", table(["body", "motion", "mean", "deviation", "least", "largest"], rows)]
