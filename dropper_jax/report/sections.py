"""Sections of the report of one run as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dropper_jax.base.markdown import first_names, markdown_table
from dropper_jax.base.read import Table
from dropper_jax.base.table_cells import Columns, fill
from dropper_jax.modelling.flow_coefficients import flow_cells
from dropper_jax.plausibility.line_weights import weight_cells
from dropper_jax.quantities.statistics import NOT_GAUSSIAN
from dropper_jax.report.tables import SECTION_ROWS, largest, largest_table, table_of

#: What to do about a line without a breaking load.
GIVE_LOAD = "give `breaking_load` in the scene, or --breaking-load"
#: Fractions of time and accelerations [m/s^2] up to this are rounding.
ROUNDING_LIMIT = 1e-6
#: Where and when.
POSITION = "at {at_m:.1f} m, {t_s:.2f} s"


def _most_probable(line: Table) -> str:
    """The most probable maximum, unless the tensions are not Gaussian, as it assumes."""
    if abs(line["excess_kurtosis"]) <= NOT_GAUSSIAN:
        return fill("{most_probable_n:newton}", line)
    return fill("- (excess kurtosis {excess_kurtosis:.2g})", line)


TENSION: Columns = {
    "line": "{line}",
    "minimum [N]": "{least[n]:newton} at {least[at_m]:.1f} m, {least[t_s]:.2f} s",
    "mean, first link [N]": "{mean_first_link_n:newton}",
    "mean, last link [N]": "{mean_last_link_n:newton}",
    "force on first point, mean / max [N]": (
        "{mean_first_force_n:newton} / {max_first_force_n:newton} at {max_first_force_s:.2f} s"
    ),
    "force on last point, mean / max [N]": (
        "{mean_last_force_n:newton} / {max_last_force_n:newton} at {max_last_force_s:.2f} s"
    ),
    "angle up at first point, mean / max [deg]": "{mean_first_angle_deg:.1f} / {max_first_angle_deg:.1f}",
    "angle up at last point, mean / max [deg]": "{mean_last_angle_deg:.1f} / {max_last_angle_deg:.1f}",
    "99 % [N]": "{p99_n:newton}",
    "maximum [N]": "{largest[n]:newton} at {largest[at_m]:.1f} m, {largest[t_s]:.2f} s",
    "maximum mean over 0.2 s [N]": "{sustained_n:newton}",
    "most probable maximum in 3 h [N]": _most_probable,
    "utilisation": "{utilisation[largest]:percent .1f} % at {utilisation[at_m]:.1f} m",
    "with the safety factor": "{utilisation[with_factor]:percent .1f} %",
}


def tension(lines: list[Table]) -> str:
    rows = [{**line, "p99_n": max(line["percentiles_n"]["99"])} for line in lines]
    why = {line["line"]: GIVE_LOAD for line in lines if line["utilisation"] is None}
    return largest_table(rows, lambda line: line["largest"]["n"], TENSION) + _missing("breaking load", lines, why)


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


ANCHORS: Columns = {
    "point": "{point}",
    "horizontal, mean / max [N]": "{horizontal_n[mean]:newton} / {horizontal_n[max]:newton}",
    "vertical, min / mean / max [N]": (
        "{vertical_n[min]:newton} / {vertical_n[mean]:newton} / {vertical_n[max]:newton}"
    ),
    "total, mean / max [N]": "{total_n[mean]:newton} / {total_n[max]:newton} at {total_n[max_s]:.2f} s",
    "uplift angle, mean / max [deg]": "{uplift_rad[mean]:degrees .2f} / {uplift_rad[max]:degrees .2f}|no load",
    "at the maximum load [deg]": "{uplift_at_largest_load_rad:degrees .2f}|no load",
}
HOLDING: Columns = {
    "anchor": "{point}",
    "kind": "{kind:spaced}",
    "utilisation, mean / max [%]": "{utilisation[mean]:percent .1f} / {utilisation[max]:percent .1f}",
    "factor at the maximum load": "{factor:.2f}|no load",
    "required factor met": "{required_factor:g}: {holds:yes_no}",
}


def anchors(anchors: list[Table]) -> str:
    """Loads of fixed points, and utilisations of the anchors of the scene."""
    text = largest_table(anchors, load_of_anchor, ANCHORS, what="points")
    rows = [{**a, **a["holding"]} for a in largest(anchors, load_of_anchor) if a.get("holding") is not None]
    if rows:
        return f"{text}\n\n{table_of(HOLDING, rows)}"
    return text


def load_of_anchor(anchor: Table) -> float:
    return anchor["total_n"]["max"]


BENDING: Columns = {
    "line": "{line}",
    "maximum moment [N m]": f"{{largest_moment_n_m:.4g}} {POSITION}",
    "minimum radius [m]": "{least_radius_m:.3g}|straight",
}


def bending(lines: list[Table]) -> str:
    return table_of(BENDING, lines)


def snaps(lines: list[Table]) -> str:
    """Slack and snaps of lines that stretch, compression of rigid ones."""
    parts = []
    for kind, never, what in (("elastic", "Never slack", "slack"), ("rigid", "Never in compression", "compression")):
        some = []
        for line in lines:
            if line["rigid"] == (kind == "rigid"):
                some.append({**line, "top": next(iter(line["shown"]), None)})
        every = "all lines"
        if len(some) < len(lines):
            every = f"all {kind} lines"
        columns: Columns = {
            "line": "{line}",
            "events in the worst link": "{most_events}",
            f"{what}, worst link [% of time]": "{largest_share_slack:percent .1f}",
            "maximum peak [N]": "{top[peak_n]:newton} at {top[at_m]:.1f} m, {top[peak_s]:.2f} s|none",
        }
        if some:
            parts.append(_table_and_others(never, some, "largest_share_slack", _largest_snap, columns, every))
    return "\n\n".join(parts)


def _largest_snap(line: Table) -> float:
    if line["top"] is None:
        return 0.0
    return line["top"]["peak_n"]


def _table_and_others(
    word: str,
    lines: list[Table],
    key: str,
    size: Callable[[Table], float],
    columns: Columns,
    every: str = "all lines",
) -> str:
    """The table of the lines with a value above zero, and the names of the others after a heading."""
    some = [line for line in lines if line[key] > ROUNDING_LIMIT]
    others = [line["line"] for line in lines if not line[key] > ROUNDING_LIMIT]
    parts = []
    if some:
        parts.append(largest_table(some, size, columns))
        every = first_names(others, SECTION_ROWS)
    if others:
        parts.append(f"{word}: {every}.")
    return "\n\n".join(parts)


def _life(line: Table) -> str:
    if line["damage"] is None:
        return "-"
    return fill("{life_years:.3g}|no damage", line)


FATIGUE: Columns = {
    "line": "{line}",
    "cycles": "{worst_cycles:g}",
    "equivalent range [N]": "{equivalent_range_n:max newton}",
    "maximum range [N]": "{largest_range_n:max newton}",
    "damage per year": "{damage_per_year:.3g}",
    "life [years]": _life,
}


def fatigue(lines: list[Table]) -> str:
    why = {line["line"]: line["why_no_damage"] for line in lines if line["damage"] is None}
    rows = []
    for line in lines:
        worst = int(np.argmax(line["equivalent_range_n"]))
        rows.append({"damage_per_year": None, **line, "worst_cycles": line["cycles"][worst]})
    text = largest_table(rows, lambda line: max(line["equivalent_range_n"]), FATIGUE)
    return text + _missing("damage", lines, why)


def _point_and_buoy(point: Table) -> str:
    if point["buoy"] is None:
        return point["point"]
    return f"{point['point']} ({point['buoy']})"


WATCH: Columns = {
    "point": _point_and_buoy,
    "radius, max / 95 % [m]": "{radius_max_m:.3f} / {radius_95_m:.3f}",
    "from the static position [m]": "{radius_from_static_max_m:.3f}|no static start",
    "range of x / y / z [m]": "{range_m[0]:.3f} / {range_m[1]:.3f} / {range_m[2]:.3f}",
}


def watch(points: list[Table]) -> str:
    if not points:
        return "No point moves."
    return largest_table(points, lambda point: point["radius_max_m"], WATCH, what="points")


DEPTHS: Columns = {
    "line": "{line}",
    "under water, minimum over nodes [% of time]": "{share_under_water:min percent .1f}",
    "minimum depth [m]": "{least_depth_m:min .2f}",
    "maximum depth [m]": "{largest_depth_m:max .2f}",
}
DRAUGHTS: Columns = {
    "buoy": "{buoy}",
    "draught, min / mean / max [m]": "{draught_m[min]:.2f} / {draught_m[mean]:.2f} / {draught_m[max]:.2f}",
    "height [m]": "{height_m:.2f}",
    "under water [% of time]": "{share_under_water:percent .1f}",
    "out of water [% of time]": "{share_out_of_water:percent .1f}",
    "longest submergence [s]": "{longest_under_water_s:.2f}",
}


def water(section: Table) -> str:
    text = largest_table(section["lines"], lambda line: -min(line["least_depth_m"]), DEPTHS, "highest")
    if section["buoys"]:
        return f"{text}\n\n{table_of(DRAUGHTS, section['buoys'])}"
    return text


ACCELERATION: Columns = {
    "line": "{line}",
    "rms, worst node [m/s^2]": "{rms_m_per_s2:max .3g}",
    "99 %, worst node [m/s^2]": "{p99_m_per_s2:max .3g}",
    "maximum [m/s^2]": f"{{largest_m_per_s2:.3g}} {POSITION}",
}


def acceleration(lines: list[Table]) -> str:
    key = "largest_m_per_s2"
    return _table_and_others("At rest", lines, key, lambda line: line[key], ACCELERATION)


def _touch(line: Table) -> str:
    if line["nearest"] is None:
        return "-"
    if line["diameters_m"] is None:
        return "no diameter"
    if line["least_distance_m"] <= line["diameters_m"]:
        return "yes"
    return "no"


DISTANCE: Columns = {
    "line": "{line}",
    "nearest line": "{nearest}|none",
    "minimum distance of the axes [m]": (
        "{least_distance_m:.3f} at {at_m:.1f} m and {nearest_at_m:.1f} m, {t_s:.2f} s|no links without a common point"
    ),
    "touch": _touch,
}


def _nearness(line: Table) -> float:
    """Minus the distance to the nearest line [m]."""
    if line["nearest"] is None:
        return -math.inf
    return -line["least_distance_m"]


def distance(lines: list[Table]) -> str:
    return largest_table(lines, _nearness, DISTANCE, "nearest")


SEABED: Columns = {
    "line": "{line}",
    "length on the seabed, min / mean / max [m]": "{length_m[min]:.2f} / {length_m[mean]:.2f} / {length_m[max]:.2f}",
    "mean [% of the line]": "{share_of_line:percent .1f}",
    "any contact [% of time]": "{share_with_contact:percent .1f}",
}


def seabed(lines: list[Table]) -> str:
    key = "share_with_contact"
    return _table_and_others("No link on the seabed", lines, key, lambda line: line["length_m"]["mean"], SEABED)


def weights(rows: list[Table]) -> str:
    return markdown_table(*weight_cells(rows))


def coefficients(rows: list[Table]) -> str:
    return markdown_table(*flow_cells(rows))


def _worst(key: str, text: str) -> Callable[[Table], str]:
    """A cell with values of the worst line of a part, after its name if the part has more than one line."""

    def cell(part: Table) -> str:
        worst = part[key]
        if worst is None:
            return "-"
        if part["lines"] > 1:
            return fill(f"{{line}}: {text}", worst)
        return fill(text, worst)

    return cell


def _worst_snaps(part: Table) -> str:
    if part["snap"]["most_events"] == 0:
        return "none"
    return _worst("snap", "{most_events}")(part)


PARTS: Columns = {
    "part": "{part}",
    "lines": "{lines}",
    "mean [N]": "{mean_n:newton}",
    "maximum [N]": _worst("largest", f"{{n:newton}} {POSITION}"),
    "utilisation": _worst("utilisation", "{largest:percent .1f} %"),
    "snaps, worst link": _worst_snaps,
    "damage per year": _worst("fatigue", "{damage_per_year:.3g}"),
}


def parts(found: list[Table]) -> str:
    return largest_table(found, lambda part: part["largest"]["n"], PARTS, what="parts")


CROPS: Columns = {
    "line": "{line}",
    "mussels [kg]": "{mass_kg:.4g}",
    "weight in water [N]": "{wet_weight_n:.4g}",
    "maximum diameter [m]": "{largest_diameter_m:.3g}",
    "acceleration, maximum / drop-off [m/s^2]": ("{drop_off[largest_m_per_s2]:.3g} / {drop_off[limit_m_per_s2]:.3g}"),
    "exceeded [% of nodes and time]": "{drop_off[share_beyond]:percent .3g}",
    "at risk [kg]": "{drop_off[mass_at_risk_kg]:.4g}",
}


def crop(found: list[Table]) -> str:
    text = table_of(CROPS, found)
    if all(row["drop_off"] is None for row in found):
        return f"{text}\n\nDrop-off is not computed: give `growth.attachment` and `growth.mussel_mass`."
    return text


MOTION: Columns = {
    "body": "{body}",
    "motion": "{motion}",
    "mean": "{mean:.3f}",
    "deviation": "{std:.3f}",
    "minimum": "{min:.3f}",
    "maximum": "{max:.3f}",
}


def bodies(found: list[Table]) -> str:
    rows = []
    for body in found:
        for key, values in body.items():
            if key != "body":
                name, _, unit = key.partition("_")
                row = {"body": body["body"], "motion": f"{name} [{unit}]"}
                for statistic, value in values.items():
                    if abs(value) < 5e-4:
                        value = 0.0  # not -0.000
                    row[statistic] = value
                rows.append(row)
    return table_of(MOTION, rows)
