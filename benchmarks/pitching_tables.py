"""Tables of the paper's spar upright and pitching, from `results/pitching.json`."""

from __future__ import annotations

from typing import Any

Rows = list[tuple[str, ...]]


def pitching(found: dict[str, Any]) -> Rows:
    """Cases 1 to 3 side by side, and case 1 without drag across the spar."""
    head = ("case", "spar", "anchor, mean / deviation / 99 % / largest [N]", "at the spar [N]")
    rows = [(*head, "surge, mean / deviation [m]", "heave of the base [m]", "tilt, mean / deviation / largest [deg]")]
    for group, note in (("cases", ""), ("without_drag", ", no drag across")):
        for row in found[group]:
            loads = (_load(row, end) for end in ("anchor", "buoy"))
            moves = (_pair(row["away_m"]), _pair(row["heave_m"]))
            rows.append((row["case"].removeprefix("paper-case-"), row["form"] + note, *loads, *moves, _tilt(row)))
    return rows


def pitching_centres(found: dict[str, Any]) -> Rows:
    """Case 1 over the height of the centre of gravity."""
    head = ("centre of gravity above the base [m]", "natural period of pitch in calm water [s]")
    rows = [(*head, "tilt, mean / deviation / largest [deg]", "anchor, mean / deviation / 99 % / largest [N]")]
    rows[0] += ("beyond 60 degrees [% of time]",)
    for row in found["centres"]:
        period = "it lies" if row["pitch_period_s"] is None else f"{row['pitch_period_s']:.1f}"
        name = f"{row['centre_m']:.4g}" + (" (homogeneous)" if row["centre_m"] > 4.0 else "")
        rows.append((name, period, _tilt(row), _load(row, "anchor"), f"{100 * row['capsized_share']:.0f}"))
    return rows


def _load(row: dict[str, Any], end: str) -> str:
    load = row[f"{end}_n"]
    return " / ".join(f"{x:.0f}" for x in (load["mean"], load["std"], row[f"{end}_99_n"], load["max"]))


def _pair(values: dict[str, float]) -> str:
    return f"{values['mean']:.2f} / {values['std']:.2f}"


def _tilt(row: dict[str, Any]) -> str:
    if "tilt_deg" not in row:
        return "upright"
    tilt = row["tilt_deg"]
    return f"{tilt['mean']:.0f} / {tilt['std']:.0f} / {tilt['max']:.0f}"


TABLES = {"pitching": pitching, "pitching_centres": pitching_centres}
