"""Sections of the report of one run as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import TypeVar

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.markdown import cells, first_names, table
from dropper_jax.base.read import Table
from dropper_jax.run.statistics import NOT_GAUSSIAN

#: The rows of a section, or why it is left out.
Rows = list[Table] | dict[str, str]
#: Cells of a row by the headings of their columns.
Cells = dict[str, str]
#: Maximum number of lines in one table, those with the largest values; report.json has all.
SECTION_ROWS = 30
#: What to do about a line without a breaking load.
GIVE_LOAD = "give `breaking_load` in the scene, or --breaking-load"
#: Limit of rounding.
SHOWN_ROUNDING = 1e-6


def section(values: Rows, write: Callable[[list[Table]], str]) -> str:
    """The table that `write` makes of a section, or the reason why it is left out."""
    if isinstance(values, dict):
        return f"Left out: {values['skipped']}."
    return write(values)


def empty_unless_rows(write: Callable[[list[Table]], list[str]]) -> Callable[[Rows | None], list[str]]:
    """A section of rows that is empty where the run has none of them."""

    @wraps(write)
    def section_of(found: Rows | None) -> list[str]:
        if isinstance(found, list):
            return write(found)
        return []

    return section_of


Item = TypeVar("Item")


def largest(items: Sequence[Item], size: Callable[[Item], float], most: int = SECTION_ROWS) -> list[Item]:
    """The `most` largest, in their original order."""
    kept = sorted(range(len(items)), key=lambda i: -size(items[i]))[:most]
    return [items[i] for i in sorted(kept)]


def largest_table(
    lines: list[Table],
    size: Callable[[Table], float],
    row: Callable[[Table], Cells],
    which: str = "largest",
    what: str = "lines",
) -> str:
    """The table of the `SECTION_ROWS` largest, and a note if there are more; `row` gives the cells of one.

    Rows keep the order of the scene, with a count where others are left out.
    """
    shown = largest(lines, size)
    if len(shown) == len(lines):
        return table_of([row(line) for line in shown])
    at = []
    for i, line in enumerate(lines):
        if any(line is one for one in shown):
            at.append(i)
    rows = []
    for before, here in zip([-1, *at], [*at, len(lines)], strict=True):
        if here - before > 1:
            heads = row(shown[0])
            rows.append({**dict.fromkeys(heads, ""), next(iter(heads)): f"({here - before - 1} not shown)"})
        if here < len(lines):
            rows.append(row(lines[here]))
    text = table_of(rows)
    return f"{text}\n\nThe {which} {len(shown)} of {len(lines)} {what}; report.json has all."


def tension(lines: list[Table]) -> str:
    why = {line["line"]: GIVE_LOAD for line in lines if line["utilisation"] is None}
    text = largest_table(lines, lambda line: line["largest"]["n"], _tension_row)
    return text + _missing("breaking load", lines, why)


def _tension_row(line: Table) -> Cells:
    used = line["utilisation"]
    utilisation = "-"
    if used is not None:
        utilisation = f"{100 * used['largest']:.1f} % at {used['at_m']:.1f} m"
    return {
        "line": line["line"],
        "least [N]": with_position(line["least"], newton(line["least"]["n"])),
        "mean, first link [N]": newton(line["mean_first_link_n"]),
        "mean, last link [N]": newton(line["mean_last_link_n"]),
        **{f"force on {end} point, mean / max [N]": _mean_and_peak(line, end) for end in ("first", "last")},
        **{f"angle up at {end} point, mean / max [deg]": _angles_up(line, end) for end in ("first", "last")},
        "99 % [N]": newton(max(line["percentiles_n"]["99"])),
        "largest [N]": with_position(line["largest"], newton(line["largest"]["n"])),
        "largest mean over 0.2 s [N]": newton(line["sustained_n"]),
        "most probable maximum in 3 h [N]": _most_probable(line),
        "utilisation": utilisation,
        "with the safety factor": "-" if used is None else f"{100 * used['with_factor']:.1f} %",
    }


def _most_probable(line: Table) -> str:
    """The most probable maximum, unless the tensions are not Gaussian, as it assumes."""
    kurtosis = line["excess_kurtosis"]
    if abs(kurtosis) <= NOT_GAUSSIAN:
        return newton(line["most_probable_n"])
    return f"- (excess kurtosis {kurtosis:.2g})"


def _mean_and_peak(line: Table, end: str) -> str:
    """Mean and maximum force on an end point, with the time of the maximum."""
    mean = newton(line[f"mean_{end}_force_n"])
    most = newton(line[f"max_{end}_force_n"])
    return f"{mean} / {most} at {line[f'max_{end}_force_s']:.2f} s"


def _angles_up(line: Table, end: str) -> str:
    return f"{line[f'mean_{end}_angle_deg']:.1f} / {line[f'max_{end}_angle_deg']:.1f}"


def with_position(found: Table, value: str, when: str = "t_s") -> str:
    """A value with its arc length and time."""
    return f"{value} at {found['at_m']:.1f} m, {found[when]:.2f} s"


def _missing(what: str, lines: list[Table], why: dict[str, str]) -> str:
    """A note on lines without a value, by the reason for each."""
    found = ""
    for reason in dict.fromkeys(why.values()):
        names = [name for name, own in why.items() if own == reason]
        which = "any line"
        if len(names) != len(lines):
            which = first_names(names, SECTION_ROWS)
        found += f"\n\nNo {what} of {which}: {reason}."
    return found


def anchors(anchors: list[Table]) -> str:
    text = largest_table(anchors, load_of_anchor, _anchor_row, what="points")
    rows = [_holding_row(a) for a in largest(anchors, load_of_anchor) if a.get("holding") is not None]
    if rows:
        return f"{text}\n\n{table_of(rows)}"
    return text


def load_of_anchor(anchor: Table) -> float:
    return anchor["total_n"]["max"]


def _anchor_row(anchor: Table) -> Cells:
    angle = anchor["uplift_rad"]
    most = anchor["uplift_at_largest_load_rad"]
    return {
        "point": anchor["point"],
        "horizontal, mean / max [N]": _range(anchor["horizontal_n"], newton, ("mean", "max")),
        "vertical, min / mean / max [N]": _range(anchor["vertical_n"], newton),
        "total, mean / max [N]": _range(anchor["total_n"], newton, ("mean", "max"))
        + f" at {anchor['total_n']['max_s']:.2f} s",
        "uplift angle, mean / max [deg]": "no load" if angle is None else _range(angle, _degrees, ("mean", "max")),
        "at the maximum load [deg]": "no load" if angle is None else _degrees(most),
    }


def _range(values: dict[str, float], text: Callable[[float], str], keys: Sequence[str] = ("min", "mean", "max")) -> str:
    """Some of the minimum, mean and maximum."""
    return " / ".join(text(values[key]) for key in keys)


def _degrees(angle: float) -> str:
    return f"{DEGREE * angle:.2f}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


def _holding_row(anchor: Table) -> Cells:
    """Utilisation of an anchor of the scene."""
    found = anchor["holding"]
    return {
        "anchor": anchor["point"],
        "kind": found["kind"].replace("_", " "),
        "utilisation, mean / max [%]": _range(found["utilisation"], _percent, ("mean", "max")),
        "factor at the maximum load": "no load" if found["factor"] is None else f"{found['factor']:.2f}",
        "required factor met": f"{found['required_factor']:g}: {'yes' if found['holds'] else 'NO'}",
    }


def snaps(lines: list[Table]) -> str:
    """Slack and snaps of lines that stretch, compression of rigid ones."""
    key = "largest_share_slack"
    parts = []
    for rigid, never, what in ((False, "Never slack", "slack"), (True, "Never in compression", "compression")):
        some = [line for line in lines if line["rigid"] == rigid]
        if len(some) == len(lines):
            every = "all lines"
        else:
            every = f"all {'rigid' if rigid else 'elastic'} lines"
        if some:
            row = partial(_snap_row, what=what)
            parts.append(_table_and_others(never, some, key, 0.0, _largest_snap, row, every))
    return "\n\n".join(parts)


def _largest_snap(line: Table) -> float:
    if line["shown"]:
        return line["shown"][0]["peak_n"]
    return 0.0


def _snap_row(line: Table, what: str) -> Cells:
    peak = "none"
    if line["shown"]:
        peak = with_position(line["shown"][0], newton(_largest_snap(line)), "peak_s")
    return {
        "line": line["line"],
        "events in the worst link": str(line["most_events"]),
        f"{what}, worst link [% of time]": _percent(line["largest_share_slack"]),
        "largest peak [N]": peak,
    }


def _table_and_others(
    word: str,
    lines: list[Table],
    key: str,
    limit: float,
    size: Callable[[Table], float],
    row: Callable[[Table], Cells],
    every: str = "all lines",
) -> str:
    """The table of the lines with a value above the limit, and the names of the others after a heading."""
    some = [line for line in lines if line[key] > limit]
    others = [line["line"] for line in lines if line not in some]
    text = largest_table(some, size, row) if some else ""
    which = every
    if some:
        which = first_names(others, SECTION_ROWS)
    return "\n\n".join(part for part in (text, f"{word}: {which}." if others else "") if part)


def fatigue(lines: list[Table]) -> str:
    why = {line["line"]: line["why_no_damage"] for line in lines if line["damage"] is None}
    text = largest_table(lines, lambda line: max(line["equivalent_range_n"]), _fatigue_row)
    return text + _missing("damage", lines, why)


def _fatigue_row(line: Table) -> Cells:
    worst = int(np.argmax(line["equivalent_range_n"]))
    with_load = line["damage"] is not None
    life = "-"
    if with_load and line["life_years"] is None:
        life = "no damage"
    elif with_load:
        life = f"{line['life_years']:.3g}"
    return {
        "line": line["line"],
        "cycles": f"{line['cycles'][worst]:g}",
        "equivalent range [N]": newton(line["equivalent_range_n"][worst]),
        "largest range [N]": newton(max(line["largest_range_n"])),
        "damage per year": f"{line['damage_per_year']:.3g}" if with_load else "-",
        "life [years]": life,
    }


def watch(points: list[Table]) -> str:
    return largest_table(points, lambda point: point["radius_max_m"], _watch_row, what="points")


def _watch_row(point: Table) -> Cells:
    static = point["radius_from_static_max_m"]
    return {
        "point": point["point"] + (f" ({point['buoy']})" if point["buoy"] else ""),
        "radius, max / 95 % [m]": f"{point['radius_max_m']:.3f} / {point['radius_95_m']:.3f}",
        "from the static position [m]": "no static start" if static is None else f"{static:.3f}",
        "range of x / y / z [m]": " / ".join(cells(point["range_m"], ".3f")),
    }


def water(section: Table) -> str:
    if "skipped" in section:
        return f"Left out: {section['skipped']}."
    text = largest_table(section["lines"], lambda line: -min(line["least_depth_m"]), _depth_row, "highest")
    buoys = [_draught_row(buoy) for buoy in section["buoys"]]
    if buoys:
        return f"{text}\n\n{table_of(buoys)}"
    return text


def _depth_row(line: Table) -> Cells:
    return {
        "line": line["line"],
        "under water, minimum over nodes [% of time]": _percent(min(line["share_under_water"])),
        "least depth [m]": f"{min(line['least_depth_m']):.2f}",
        "largest depth [m]": f"{max(line['largest_depth_m']):.2f}",
    }


def _draught_row(buoy: Table) -> Cells:
    return {
        "buoy": buoy["buoy"],
        "draught, min / mean / max [m]": _range(buoy["draught_m"], "{:.2f}".format),
        "height [m]": f"{buoy['height_m']:.2f}",
        "under water [% of time]": _percent(buoy["share_under_water"]),
        "out of water [% of time]": _percent(buoy["share_out_of_water"]),
        "longest submergence [s]": f"{buoy['longest_under_water_s']:.2f}",
    }


def acceleration(lines: list[Table]) -> str:
    key = "largest_m_per_s2"
    return _table_and_others("At rest", lines, key, SHOWN_ROUNDING, lambda line: line[key], _acceleration_row)


def _acceleration_row(line: Table) -> Cells:
    return {
        "line": line["line"],
        "rms, worst node [m/s^2]": f"{max(line['rms_m_per_s2']):.3g}",
        "99 %, worst node [m/s^2]": f"{max(line['p99_m_per_s2']):.3g}",
        "largest [m/s^2]": with_position(line, f"{line['largest_m_per_s2']:.3g}"),
    }


def distance(lines: list[Table]) -> str:
    return largest_table(lines, lambda line: -(line["least_distance_m"] or math.inf), _distance_row, "nearest")


def _distance_row(line: Table) -> Cells:
    near = line["least_distance_m"]
    touch = line["diameters_m"] if line["nearest"] else None
    text = "no links without a common point"
    touches = "-"
    if line["nearest"] is not None:
        text = f"{near:.3f} at {line['at_m']:.1f} m and {line['nearest_at_m']:.1f} m, {line['t_s']:.2f} s"
        if touch is None:
            touches = "no diameter"
        elif near <= touch:
            touches = "yes"
        else:
            touches = "no"
    return {
        "line": line["line"],
        "nearest line": line["nearest"] or "none",
        "minimum distance of the axes [m]": text,
        "touch": touches,
    }


def seabed(lines: list[Table]) -> str:
    key = "share_with_contact"
    return _table_and_others("No link on the seabed", lines, key, 0.0, lambda line: line["length_m"]["mean"], _bed_row)


def _bed_row(line: Table) -> Cells:
    return {
        "line": line["line"],
        "length on the seabed, min / mean / max [m]": _range(line["length_m"], "{:.2f}".format),
        "mean [% of the line]": _percent(line["share_of_line"]),
        "any contact [% of time]": _percent(line["share_with_contact"]),
    }


def newton(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    if abs(value) < SHOWN_ROUNDING:
        return "0"
    if abs(value) >= 1000:
        return f"{value:.0f}"
    return f"{value:.4g}"


def table_of(rows: Sequence[Cells]) -> str:
    """Rows by column as a Markdown table."""
    return table(list(rows[0]), [list(row.values()) for row in rows])
