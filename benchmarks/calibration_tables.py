"""The tables of docs/statistics-of-fits.md, from results of benchmarks/calibration.py and measured_pendulums.py.

python benchmarks/calibration_tables.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"


def load(name: str) -> dict[str, Any]:
    """One result file."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def markdown(rows: list[tuple[str, ...]]) -> str:
    """Rows as a Markdown table; the first one is the heading."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]])


def held_out_table() -> str:
    """Errors on the held-out windows of both rigs [mrad]."""
    rows = [("rig", "held out [s]", "published [mrad]", "fitted [mrad]", "ratio of means")]
    for rig in ("single", "double"):
        found = load(f"measured_{rig}_pendulum")
        spans = found["held_out_s"]
        numbers = [", ".join(f"{1e3 * x:.2g}" for x in found[key]) for key in ("published_rad", "held_out_rad")]
        rows.append((rig, f"{spans[0][0]:g} to {spans[-1][1]:g}", *numbers, f"{found['ratio_of_means']:.2f}"))
    return markdown(rows)


def twin_table() -> str:
    """Fits of synthetic data: how many converge, errors over standard errors, cover, and how large the errors are."""
    rows = [
        ("synthetic data", "method", "converged", "RMS of error/std error", "90 % intervals cover", "median std error")
    ]
    dry = {f"dry friction, {links}": found for links, found in load("calibration_dry").items()}
    twins = {"linear + quadratic": load("calibration_twin"), "60 draws": load("calibration_coverage"), **dry}
    for title, methods in twins.items():
        for method in ("windows", "shooting"):
            if method not in methods:
                continue
            found = methods[method]
            three = (
                ", ".join(f"{x:.2f}" for x in found["z_rms"]),
                ", ".join(f"{100 * x:.0f} %" for x in found["covered_90"]),
                ", ".join(f"{100 * x:.2g} %" for x in found["median_relative_std_error"]),
            )
            rows.append((title, method, f"{found['converged']} of {found['fits']}", *three))
    return markdown(rows)


def law_table(rig: str) -> str:
    """Damping laws of one rig on windows before the held-out part."""
    laws = load(f"measured_{rig}_pendulum")["laws_on_windows_before_the_held_out_part"]
    least = min(law["bic"] for law in laws)
    rows = [("law", "coefficients", "fitted [mrad]", "not fitted [mrad]", "BIC - minimum", "")]
    for law in laws:
        note = "simplest within one standard error" if law["chosen"] else "" if law["status"] == "ok" else law["status"]
        numbers = (f"{1e3 * law['rms']:.3g}", f"{1e3 * law['held_out']:.3g}", f"{law['bic'] - least:.0f}")
        rows.append((law["name"], str(law["coefficients"]), *numbers, note))
    return markdown(rows)


TABLES = {
    "twins": twin_table,
    "held out": held_out_table,
    "laws of the single pendulum": lambda: law_table("single"),
    "laws of the double pendulum": lambda: law_table("double"),
}


def main() -> None:
    for name, make in TABLES.items():
        print(f"{name}\n\n{make()}\n")


if __name__ == "__main__":
    main()
