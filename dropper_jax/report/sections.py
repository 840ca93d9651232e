"""Sections of the report of one run as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

DEGREE = 180.0 / math.pi


def section(values: Any, write: Any) -> str:
    """The table that `write` makes of a section, or why it is left out."""
    return f"Left out: {values['skipped']}." if isinstance(values, dict) else write(values)


def tension(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        used = line["utilisation"]
        rows.append(
            [
                line["line"],
                newton(line["least"]["n"]),
                newton(line["mean_first_link_n"]),
                newton(line["mean_last_link_n"]),
                newton(max(line["percentiles_n"]["99"])),
                f"{newton(line['largest']['n'])} at {line['largest']['at_m']:.1f} m, {line['largest']['t_s']:.2f} s",
                "no breaking load" if used is None else f"{100 * used['largest']:.1f} % at {used['at_m']:.1f} m",
            ]
        )
    head = [
        "line",
        "least [N]",
        "mean, first link [N]",
        "mean, last link [N]",
        "99 % [N]",
        "largest [N]",
        "utilisation",
    ]
    return table(head, rows)


def anchors(anchors: list[dict[str, Any]]) -> str:
    rows = []
    for a in anchors:
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
        "at the largest load [deg]",
    ]
    return table(head, rows)


def snaps(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        first = line["shown"][0] if line["shown"] else None
        text = (
            "none" if first is None else f"{newton(first['peak_n'])} at {first['at_m']:.1f} m, {first['peak_s']:.2f} s"
        )
        rows.append([line["line"], str(line["most_events"]), f"{100 * line['largest_share_slack']:.1f}", text])
    return table(["line", "events in the worst link", "slack, worst link [% of time]", "largest peak [N]"], rows)


def fatigue(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        worst = int(np.argmax(line["equivalent_range_n"]))
        with_load = line["damage"] is not None
        rows.append(
            [
                line["line"],
                f"{line['cycles'][worst]:g}",
                newton(line["equivalent_range_n"][worst]),
                newton(max(line["largest_range_n"])),
                f"{line['damage_per_year']:.3g}" if with_load else line["why_no_damage"],
                "-" if not with_load else "no damage" if line["life_years"] is None else f"{line['life_years']:.3g}",
            ]
        )
    head = ["line", "cycles", "equivalent range [N]", "largest range [N]", "damage per year", "life [years]"]
    return table(head, rows)


def watch(points: list[dict[str, Any]]) -> str:
    rows = [
        [
            p["point"] + (f" ({p['buoy']})" if p["buoy"] else ""),
            f"{p['radius_max_m']:.3f} / {p['radius_95_m']:.3f}",
            "no static start" if p["radius_from_static_max_m"] is None else f"{p['radius_from_static_max_m']:.3f}",
            " / ".join(f"{x:.3f}" for x in p["range_m"]),
        ]
        for p in points
    ]
    return table(["point", "radius, max / 95 % [m]", "from the static place [m]", "range of x / y / z [m]"], rows)


def water(section: dict[str, Any]) -> str:
    if "skipped" in section:
        return f"Left out: {section['skipped']}."
    rows = [
        [
            line["line"],
            f"{100 * min(line['share_under_water']):.1f}",
            f"{min(line['least_depth_m']):.2f}",
            f"{max(line['largest_depth_m']):.2f}",
        ]
        for line in section["lines"]
    ]
    text = table(["line", "under water, driest node [% of time]", "least depth [m]", "largest depth [m]"], rows)
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
        "out of it [% of time]",
        "longest under water [s]",
    ]
    return f"{text}\n\n{table(head, rows)}"


def acceleration(lines: list[dict[str, Any]]) -> str:
    rows = [
        [
            line["line"],
            f"{max(line['rms_m_per_s2']):.3g}",
            f"{max(line['p99_m_per_s2']):.3g}",
            f"{line['largest_m_per_s2']:.3g} at {line['at_m']:.1f} m, {line['t_s']:.2f} s",
        ]
        for line in lines
    ]
    return table(["line", "rms, worst node [m/s^2]", "99 %, worst node [m/s^2]", "largest [m/s^2]"], rows)


def distance(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        if line["nearest"] is None:
            rows.append([line["line"], "none", "no links apart from shared points", "-"])
            continue
        touch = line["diameters_m"]
        rows.append(
            [
                line["line"],
                line["nearest"],
                _place_of(line),
                "no diameter" if touch is None else "yes" if line["least_distance_m"] <= touch else "no",
            ]
        )
    return table(["line", "nearest line", "least distance of the axes [m]", "touch"], rows)


def _place_of(line: dict[str, Any]) -> str:
    where = f"at {line['at_m']:.1f} m and {line['nearest_at_m']:.1f} m, {line['t_s']:.2f} s"
    return f"{line['least_distance_m']:.3f} {where}"


def seabed(lines: list[dict[str, Any]]) -> str:
    rows = [
        [
            line["line"],
            " / ".join(f"{line['length_m'][k]:.2f}" for k in ("min", "mean", "max")),
            f"{100 * line['share_of_line']:.1f}",
            f"{100 * line['share_with_contact']:.1f}",
        ]
        for line in lines
    ]
    head = ["line", "length on the bed, min / mean / max [m]", "mean [% of the line]", "any contact [% of time]"]
    return table(head, rows)


def newton(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in lines)
