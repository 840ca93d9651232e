"""The report as Markdown: tables of the values, pictures, and what was left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

DEGREE = 180.0 / math.pi


def markdown(found: dict[str, Any], pictures: list[dict[str, str]]) -> str:
    """The whole report.

    Args:
        pictures: paths from the report's folder, by name, of each run.
    """
    runs = found["runs"]
    parts = [f"# Report: {', '.join(dict.fromkeys(run['scene'] for run in runs))}", _overview(runs)]
    for number, (run, files) in enumerate(zip(runs, pictures, strict=True), start=1):
        if len(runs) > 1:
            parts.append(f"# Run {number}: {run['file']}")
        parts += _run(run, files)
    if len(runs) > 1:
        parts += ["# Between the runs", _spread(found["spread"])]
    parts += [
        f"# Extremes of a storm of {found['settings']['storm']['value'] / 3600:g} h",
        _extremes(found["extremes"]),
    ]
    if any("extremes" in files for files in pictures):
        parts.append("![extremes](extremes.png)")
    parts += ["# Settings", _settings(found["settings"])]
    return "\n\n".join(part for part in parts if part) + "\n"


def _overview(runs: list[dict[str, Any]]) -> str:
    rows = [
        [
            run["file"],
            run["status"],
            f"{run['from_s']:g} to {run['to_s']:g}",
            f"{run['saved_every_s']:g}",
            f"{run['dt_s']:g}",
        ]
        for run in runs
    ]
    return _table(["run", "status", "time [s]", "samples every [s]", "step [s]"], rows)


def _run(run: dict[str, Any], files: dict[str, str]) -> list[str]:
    def picture(name: str) -> str:
        return f"![{name.replace('_', ' ')}]({files[name]})" if name in files else ""

    return [
        "\n".join(f"- {note}" for note in run["notes"]),
        "## Tension",
        _tension(run["tension"]),
        picture("tension_range"),
        "## Held points",
        _section(run["anchors"], _anchors),
        picture("anchors"),
        "## Snap loads",
        _snaps(run["snap"]),
        "## Fatigue",
        _section(run["fatigue"], _fatigue),
        picture("fatigue"),
        "## Watch circles",
        _watch(run["watch_circle"]) if run["watch_circle"] else "No point moves.",
        picture("watch_circle"),
        "## Water",
        _water(run["submergence"]),
        "## Accelerations",
        _acceleration(run["acceleration"]),
        "## Distance between lines",
        _section(run["distance"], _distance),
        "## Seabed",
        _section(run["seabed"], _seabed),
        picture("along"),
    ]


def _section(section: Any, write: Any) -> str:
    return f"Left out: {section['skipped']}." if isinstance(section, dict) else write(section)


def _tension(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        used = line["utilisation"]
        rows.append(
            [
                line["line"],
                _n(line["least"]["n"]),
                _n(line["mean_first_link_n"]),
                _n(line["mean_last_link_n"]),
                _n(max(line["percentiles_n"]["99"])),
                f"{_n(line['largest']['n'])} at {line['largest']['at_m']:.1f} m, {line['largest']['t_s']:.2f} s",
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
    return _table(head, rows)


def _anchors(anchors: list[dict[str, Any]]) -> str:
    rows = []
    for a in anchors:
        angle = a["uplift_rad"]
        rows.append(
            [
                a["point"],
                f"{_n(a['horizontal_n']['mean'])} / {_n(a['horizontal_n']['max'])}",
                f"{_n(a['vertical_n']['min'])} / {_n(a['vertical_n']['mean'])} / {_n(a['vertical_n']['max'])}",
                f"{_n(a['total_n']['mean'])} / {_n(a['total_n']['max'])}",
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
    return _table(head, rows)


def _snaps(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        first = line["shown"][0] if line["shown"] else None
        text = "none" if first is None else f"{_n(first['peak_n'])} at {first['at_m']:.1f} m, {first['peak_s']:.2f} s"
        rows.append([line["line"], str(line["most_events"]), f"{100 * line['largest_share_slack']:.1f}", text])
    return _table(["line", "events in the worst link", "slack, worst link [% of time]", "largest peak [N]"], rows)


def _fatigue(lines: list[dict[str, Any]]) -> str:
    rows = []
    for line in lines:
        worst = int(np.argmax(line["equivalent_range_n"]))
        with_load = line["damage"] is not None
        rows.append(
            [
                line["line"],
                f"{line['cycles'][worst]:g}",
                _n(line["equivalent_range_n"][worst]),
                _n(max(line["largest_range_n"])),
                f"{line['damage_per_year']:.3g}" if with_load else line["why_no_damage"],
                "-" if not with_load else "no damage" if line["life_years"] is None else f"{line['life_years']:.3g}",
            ]
        )
    head = ["line", "cycles", "equivalent range [N]", "largest range [N]", "damage per year", "life [years]"]
    return _table(head, rows)


def _watch(points: list[dict[str, Any]]) -> str:
    rows = [
        [
            p["point"] + (f" ({p['buoy']})" if p["buoy"] else ""),
            f"{p['radius_max_m']:.3f} / {p['radius_95_m']:.3f}",
            "no static start" if p["radius_from_static_max_m"] is None else f"{p['radius_from_static_max_m']:.3f}",
            " / ".join(f"{x:.3f}" for x in p["range_m"]),
        ]
        for p in points
    ]
    return _table(["point", "radius, max / 95 % [m]", "from the static place [m]", "range of x / y / z [m]"], rows)


def _water(section: dict[str, Any]) -> str:
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
    text = _table(["line", "under water, driest node [% of time]", "least depth [m]", "largest depth [m]"], rows)
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
    return f"{text}\n\n{_table(head, rows)}"


def _acceleration(lines: list[dict[str, Any]]) -> str:
    rows = [
        [
            line["line"],
            f"{max(line['rms_m_per_s2']):.3g}",
            f"{max(line['p99_m_per_s2']):.3g}",
            f"{line['largest_m_per_s2']:.3g} at {line['at_m']:.1f} m, {line['t_s']:.2f} s",
        ]
        for line in lines
    ]
    return _table(["line", "rms, worst node [m/s^2]", "99 %, worst node [m/s^2]", "largest [m/s^2]"], rows)


def _distance(lines: list[dict[str, Any]]) -> str:
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
    return _table(["line", "nearest line", "least distance of the axes [m]", "touch"], rows)


def _place_of(line: dict[str, Any]) -> str:
    where = f"at {line['at_m']:.1f} m and {line['nearest_at_m']:.1f} m, {line['t_s']:.2f} s"
    return f"{line['least_distance_m']:.3f} {where}"


def _seabed(lines: list[dict[str, Any]]) -> str:
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
    return _table(head, rows)


def _spread(section: dict[str, Any]) -> str:
    rows = [[name, *(f"{v[key]:.4g}" for key in ("min", "mean", "max"))] for name, v in section["values"].items()]
    steps = ", ".join(f"{dt:g}" for dt in section["dt_s"])
    return f"Steps of the runs: {steps} s.\n\n" + _table(["of the runs (loads in N)", "least", "mean", "largest"], rows)


def _extremes(section: dict[str, Any]) -> str:
    if isinstance(section.get("skipped"), str):
        return f"Left out: {section['skipped']}."
    rows = []
    for name, one in section.items():
        if "skipped" in one:
            rows.append([name, one["skipped"], "-", "-"])
            continue
        cells = [_with_interval(one, key) for key in ("most_probable", "mean", "percentile_90")]
        rows.append([name, *cells])
    level = next((one["confidence"] for one in section.values() if "confidence" in one), None)
    what = "" if level is None else f" [N], {100 * level:g} % interval"
    return _table(["largest in the storm", f"most probable{what}", f"mean{what}", f"90th percentile{what}"], rows)


def _with_interval(one: dict[str, Any], key: str) -> str:
    low, high = one[f"{key}_interval"]
    return f"{_n(one[key])} ({_n(low)} to {_n(high)})"


def _settings(settings: dict[str, Any]) -> str:
    rows = [
        [key, s["meaning"], "none" if s["value"] is None else f"{s['value']:g} {s['unit']}".replace(" -", "")]
        for key, s in settings.items()
    ]
    return _table(["setting", "meaning", "value"], rows)


def _n(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in lines)
