"""Sections of the report of one run as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.toml_text import literal

#: Maximum number of lines in one table, those with the largest values; report.json has all.
SECTION_ROWS = 30
#: Limit of rounding.
SHOWN_ROUNDING = 1e-6


def section(values: list[dict[str, Any]] | dict[str, str], write: Callable[[list[dict[str, Any]]], str]) -> str:
    """The table that `write` makes of a section, or the reason why it is left out."""
    return f"Left out: {values['skipped']}." if isinstance(values, dict) else write(values)


def empty_unless_rows(write: Callable[[Any], list[str]]) -> Callable[[Any], list[str]]:
    """A section of rows that is empty where the run has none of them."""

    @wraps(write)
    def section_of(found: list[dict[str, Any]] | dict[str, str] | None) -> list[str]:
        return write(found) if isinstance(found, list) else []

    return section_of


def largest(lines: list[dict[str, Any]], size: Callable[[dict[str, Any]], float]) -> list[dict[str, Any]]:
    """The `SECTION_ROWS` largest, in their original order."""
    kept = sorted(range(len(lines)), key=lambda i: -size(lines[i]))[:SECTION_ROWS]
    return [lines[i] for i in sorted(kept)]


def with_rest(text: str, shown: int, total: int, which: str = "largest", what: str = "lines") -> str:
    return text if shown == total else f"{text}\n\nThe {which} {shown} of {total} {what}; report.json has all."


def _names(lines: list[dict[str, Any]]) -> str:
    names = [line["line"] for line in lines]
    return ", ".join(names[:SECTION_ROWS]) + (
        f" and {len(names) - SECTION_ROWS} more" if len(names) > SECTION_ROWS else ""
    )


def tension(lines: list[dict[str, Any]]) -> str:
    rows, shown = [], largest(lines, lambda line: line["largest"]["n"])
    for line in shown:
        used = line["utilisation"]
        rows.append(
            [
                line["line"],
                newton(line["least"]["n"]),
                newton(line["mean_first_link_n"]),
                newton(line["mean_last_link_n"]),
                f"{newton(line['mean_first_force_n'])} / {newton(line['max_first_force_n'])}",
                f"{newton(line['mean_last_force_n'])} / {newton(line['max_last_force_n'])}",
                *(f"{line[f'mean_{x}_angle_deg']:.1f} / {line[f'max_{x}_angle_deg']:.1f}" for x in ("first", "last")),
                newton(max(line["percentiles_n"]["99"])),
                f"{newton(line['largest']['n'])} at {line['largest']['at_m']:.1f} m, {line['largest']['t_s']:.2f} s",
                "-" if used is None else f"{100 * used['largest']:.1f} % at {used['at_m']:.1f} m",
                "-" if used is None else f"{100 * used['with_factor']:.1f} %",
            ]
        )
    head = [
        "line",
        "least [N]",
        "mean, first link [N]",
        "mean, last link [N]",
        "force on first point, mean / max [N]",
        "force on last point, mean / max [N]",
        "angle up at first point, mean / max [deg]",
        "angle up at last point, mean / max [deg]",
        "99 % [N]",
        "largest [N]",
        "utilisation",
        "with the safety factor",
    ]
    return with_rest(table(head, rows), len(shown), len(lines)) + _without_load(lines, "utilisation")


def _without_load(lines: list[dict[str, Any]], key: str) -> str:
    """A note on lines without a breaking load."""
    without = [line for line in lines if line[key] is None]
    if not without:
        return ""
    which = "any line" if len(without) == len(lines) else _names(without)
    return f"\n\nNo breaking load of {which}: give `breaking_load` in the scene, or --breaking-load."


def _without_damage(lines: list[dict[str, Any]]) -> str:
    """A note on lines without a damage, by the missing value."""
    why = dict.fromkeys(line["why_no_damage"] for line in lines if line["damage"] is None)
    found = ""
    for reason in why:
        own = [line for line in lines if line["damage"] is None and line["why_no_damage"] == reason]
        which = "any line" if len(own) == len(lines) else _names(own)
        found += f"\n\nNo damage of {which}: {reason}."
    return found


def anchors(anchors: list[dict[str, Any]]) -> str:
    rows, shown = [], largest(anchors, lambda a: a["total_n"]["max"])
    for a in shown:
        angle = a["uplift_rad"]
        rows.append(
            [
                a["point"],
                f"{newton(a['horizontal_n']['mean'])} / {newton(a['horizontal_n']['max'])}",
                " / ".join(newton(a["vertical_n"][key]) for key in ("min", "mean", "max")),
                f"{newton(a['total_n']['mean'])} / {newton(a['total_n']['max'])}",
                "no load" if angle is None else f"{DEGREE * angle['mean']:.2f} / {DEGREE * angle['max']:.2f}",
                "no load" if angle is None else f"{DEGREE * a['uplift_at_largest_load_rad']:.2f}",
            ]
        )
    head = [
        "point",
        "horizontal, mean / max [N]",
        "vertical, min / mean / max [N]",
        "total, mean / max [N]",
        "uplift angle, mean / max [deg]",
        "at the maximum load [deg]",
    ]
    return with_rest(table(head, rows), len(shown), len(anchors), what="points") + _holding(shown)


def _holding(anchors: list[dict[str, Any]]) -> str:
    """Utilisation of the anchors of the scene; empty without any."""
    rows = []
    for a in anchors:
        found = a.get("holding")
        if found is not None:
            used, factor = found["utilisation"], found["factor"]
            rows.append(
                [
                    a["point"],
                    found["kind"].replace("_", " "),
                    f"{100 * used['mean']:.1f} / {100 * used['max']:.1f}",
                    "no load" if factor is None else f"{factor:.2f}",
                    f"{found['required_factor']:g}: {'yes' if found['holds'] else 'NO'}",
                ]
            )
    head = ["anchor", "kind", "utilisation, mean / max [%]", "factor at the maximum load", "required factor met"]
    return "\n\n" + table(head, rows) if rows else ""


def snaps(lines: list[dict[str, Any]]) -> str:
    rows, some = [], [line for line in lines if line["largest_share_slack"] > 0]
    shown = largest(some, lambda line: line["shown"][0]["peak_n"] if line["shown"] else 0.0)
    for line in shown:
        first = line["shown"][0] if line["shown"] else None
        text = (
            "none" if first is None else f"{newton(first['peak_n'])} at {first['at_m']:.1f} m, {first['peak_s']:.2f} s"
        )
        rows.append([line["line"], str(line["most_events"]), f"{100 * line['largest_share_slack']:.1f}", text])
    head = ["line", "events in the worst link", "slack, worst link [% of time]", "largest peak [N]"]
    return _split_table("Never slack", head, rows, shown, some, lines)


def _split_table(
    word: str,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    shown: list[dict[str, Any]],
    some: list[dict[str, Any]],
    lines: list[dict[str, Any]],
) -> str:
    """The table of some lines, and the names of the others after a heading."""
    others = [line for line in lines if line not in some]
    text = with_rest(table(head, rows), len(shown), len(some)) if rows else ""
    which = _names(others) if some else "all lines"
    return "\n\n".join(part for part in (text, f"{word}: {which}." if others else "") if part)


def fatigue(lines: list[dict[str, Any]]) -> str:
    rows, shown = [], largest(lines, lambda line: max(line["equivalent_range_n"]))
    for line in shown:
        worst = int(np.argmax(line["equivalent_range_n"]))
        with_load = line["damage"] is not None
        rows.append(
            [
                line["line"],
                f"{line['cycles'][worst]:g}",
                newton(line["equivalent_range_n"][worst]),
                newton(max(line["largest_range_n"])),
                f"{line['damage_per_year']:.3g}" if with_load else "-",
                "-" if not with_load else "no damage" if line["life_years"] is None else f"{line['life_years']:.3g}",
            ]
        )
    head = ["line", "cycles", "equivalent range [N]", "largest range [N]", "damage per year", "life [years]"]
    return with_rest(table(head, rows), len(shown), len(lines)) + _without_damage(lines)


def watch(points: list[dict[str, Any]]) -> str:
    shown = largest(points, lambda p: p["radius_max_m"])
    rows = [
        [
            p["point"] + (f" ({p['buoy']})" if p["buoy"] else ""),
            f"{p['radius_max_m']:.3f} / {p['radius_95_m']:.3f}",
            "no static start" if p["radius_from_static_max_m"] is None else f"{p['radius_from_static_max_m']:.3f}",
            " / ".join(f"{x:.3f}" for x in p["range_m"]),
        ]
        for p in shown
    ]
    head = ["point", "radius, max / 95 % [m]", "from the static position [m]", "range of x / y / z [m]"]
    return with_rest(table(head, rows), len(shown), len(points), what="points")


def water(section: dict[str, Any]) -> str:
    if "skipped" in section:
        return f"Left out: {section['skipped']}."
    shown = largest(section["lines"], lambda line: -min(line["least_depth_m"]))
    rows = [
        [
            line["line"],
            f"{100 * min(line['share_under_water']):.1f}",
            f"{min(line['least_depth_m']):.2f}",
            f"{max(line['largest_depth_m']):.2f}",
        ]
        for line in shown
    ]
    head = ["line", "under water, minimum over nodes [% of time]", "least depth [m]", "largest depth [m]"]
    text = with_rest(table(head, rows), len(shown), len(section["lines"]), "highest")
    if not section["buoys"]:
        return text
    rows = [
        [
            b["buoy"],
            " / ".join(f"{b['draught_m'][k]:.2f}" for k in ("min", "mean", "max")),
            f"{b['height_m']:.2f}",
            f"{100 * b['share_under_water']:.1f}",
            f"{100 * b['share_out_of_water']:.1f}",
            f"{b['longest_under_water_s']:.2f}",
        ]
        for b in section["buoys"]
    ]
    head = [
        "buoy",
        "draught, min / mean / max [m]",
        "height [m]",
        "under water [% of time]",
        "out of water [% of time]",
        "longest submergence [s]",
    ]
    return f"{text}\n\n{table(head, rows)}"


def acceleration(lines: list[dict[str, Any]]) -> str:
    some = [line for line in lines if line["largest_m_per_s2"] >= SHOWN_ROUNDING]
    shown = largest(some, lambda line: line["largest_m_per_s2"])
    rows = [
        [
            line["line"],
            f"{max(line['rms_m_per_s2']):.3g}",
            f"{max(line['p99_m_per_s2']):.3g}",
            f"{line['largest_m_per_s2']:.3g} at {line['at_m']:.1f} m, {line['t_s']:.2f} s",
        ]
        for line in shown
    ]
    head = ["line", "rms, worst node [m/s^2]", "99 %, worst node [m/s^2]", "largest [m/s^2]"]
    return _split_table("At rest", head, rows, shown, some, lines)


def distance(lines: list[dict[str, Any]]) -> str:
    rows, shown = [], largest(lines, lambda line: -(line["least_distance_m"] or math.inf))
    for line in shown:
        if line["nearest"] is None:
            rows.append([line["line"], "none", "no links without a common point", "-"])
            continue
        touch = line["diameters_m"]
        rows.append(
            [
                line["line"],
                line["nearest"],
                _distance_text(line),
                "no diameter" if touch is None else "yes" if line["least_distance_m"] <= touch else "no",
            ]
        )
    text = table(["line", "nearest line", "minimum distance of the axes [m]", "touch"], rows)
    return with_rest(text, len(shown), len(lines), "nearest")


def _distance_text(line: dict[str, Any]) -> str:
    where = f"at {line['at_m']:.1f} m and {line['nearest_at_m']:.1f} m, {line['t_s']:.2f} s"
    return f"{line['least_distance_m']:.3f} {where}"


def seabed(lines: list[dict[str, Any]]) -> str:
    some = [line for line in lines if line["share_with_contact"] > 0]
    shown = largest(some, lambda line: line["length_m"]["mean"])
    rows = [
        [
            line["line"],
            " / ".join(f"{line['length_m'][k]:.2f}" for k in ("min", "mean", "max")),
            f"{100 * line['share_of_line']:.1f}",
            f"{100 * line['share_with_contact']:.1f}",
        ]
        for line in shown
    ]
    head = ["line", "length on the seabed, min / mean / max [m]", "mean [% of the line]", "any contact [% of time]"]
    return _split_table("No link on the seabed", head, rows, shown, some, lines)


def newton(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    if abs(value) < SHOWN_ROUNDING:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return markdown_table([head, *rows])


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows as a Markdown table; the first one is the heading."""
    cells = [[literal(cell) for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in (cells[0], ["---"] * len(cells[0]), *cells[1:]))
