"""Tables of the thesis' releases and of its dropper in the North Sea, of docs/validation.md and docs/water.md."""

from __future__ import annotations

from typing import Any

Rows = list[tuple[str, ...]]


def north_sea(found: dict[str, Any]) -> Rows:
    """Angles, tensions and speeds of the dropper in the North Sea, effect by effect."""
    head = ("effects", "minimum polar [rad]", "maximum", "maximum azimuth [rad]", "peak [Hz]", "first link at most [N]")
    rows = [(*head, "last", "minimum [N]", "fastest [m/s]", "status")]
    keys = {"polar_min_rad": 2, "polar_max_rad": 2, "azimuth_max_rad": 2, "azimuth_peak_hz": 2}
    keys |= {"tension_first_max_n": 0, "tension_last_max_n": 0, "tension_min_n": 0, "speed_max_m_s": 1}
    for row in found["rows"]:
        ends = {
            run["status"] if run["status"] == "ok" else f"{run['status']} after {run['duration_s']:.2f} s"
            for run in row["runs"]
        }
        cells = (_range([run[key] for run in row["runs"]], digits) for key, digits in keys.items())
        rows.append((row["name"], *cells, ", ".join(sorted(ends))))
    return rows


def _range(values: list[float | None], digits: int) -> str:
    """The value of several runs where they agree to the digits that are printed, else from the least to the largest."""
    if None in values:
        return "-"
    shown = list(dict.fromkeys(f"{value:.{digits}f}" for value in (min(values), max(values))))
    return " to ".join(shown)


def thesis_release(found: dict[str, Any]) -> Rows:
    """Scenarios from the thesis' ramp and from their packaged poses, by the default scheme and by the thesis' own."""
    head = ("scenario, start", "angles before the release, RMS to the thesis' model [rad]", "energy_momentum")
    dampings = [(row["b_l"], row["b_q"]) for row in found["scenarios"][0]["ramp"]["thesis_angles"]]
    rows = [(*head, *(f"thesis_angles, b_l {b_l:g} kg/s, b_q {b_q:g} kg/m" for b_l, b_q in dampings))]
    for row in found["scenarios"]:
        for start, words in (("ramp", "force until 15 s"), ("pose", "packaged pose")):
            one = row[start]
            rms = f"{one['rms_to_model_rad']:.3f}" if "rms_to_model_rad" in one else "no angles given"
            ends = [_ended(run) for run in (one["default"], *one["thesis_angles"])]
            rows.append((f"{row['scenario']}, {words}", rms, *ends))
    return rows


def _ended(run: dict[str, Any]) -> str:
    return f"{run['status']}, {run['reached_s']:.2f} s"


def thesis_dampings(found: dict[str, Any]) -> Rows:
    """Scenario A by the thesis' scheme with its dampings."""
    rows = [("b_l [kg/s]", "b_q [kg/m]", "in Table E.1", "ends", "after [s]", "energy not accounted for")]
    for row in found["dampings"]:
        share = 100 * row["energy_share"]
        ends = (row["status"], f"{row['reached_s']:.2f}", f"{share:.0f} %" if share >= 10 else f"{share:.1f} %")
        rows.append((f"{row['b_l']:g}", f"{row['b_q']:g}", "yes" if row["table_e_1"] else "no", *ends))
    return rows


def independent(found: dict[str, Any]) -> str:
    """How far the thesis' equations run in a code of their own."""
    ran = "; ".join(
        f"at {row['dt_s']:g} s corrected to {row['corrected']:.3f} s, as printed to {row['printed']:.3f} s"
        for row in found["independent"]
    )
    return f"\n\nIn NumPy (C.32)-(C.41) in the plane run, undamped, {ran}."
