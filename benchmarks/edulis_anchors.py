"""Loads and utilisation of Edulis' four anchors through the tide at each heading.

    python benchmarks/edulis_anchors.py

Takes about a minute. Writes results/edulis_anchors.json, of which `python benchmarks/tables.py` makes a table.
"""

import numpy as np
from study import Found, Rows, collect, columns, command, table_of

from dropper_jax import load_scene
from dropper_jax.study.tide import tidal_cycle

NAMES = ("west-danforth", "east-danforth", "west-gravity", "east-gravity")
HEADINGS = range(0, 91, 15)  # [deg] of the tide against the backbone


def anchors(heading: int) -> Found:
    """Largest loads over a tide at one heading [deg]."""
    scene = load_scene("edulis-tide").with_values({"sea.current.direction": float(np.radians(heading))})
    rows = tidal_cycle(scene)["rows"]
    assert all(row["status"] == "ok" for row in rows)
    return {
        "heading_deg": heading,
        "largest_load_n": {n: max(float(np.linalg.norm(row["held_load_n"][n])) for row in rows) for n in NAMES},
        "utilisation": {n: max(row["anchor_utilisation"][n] for row in rows) for n in NAMES},
        "moved_m": max(row["displacement_m"] for row in rows),
    }


@table_of("edulis_anchors")
def edulis_anchors(found: Found) -> Rows:
    """Edulis' anchors by heading of the tide."""

    def load(row: Found, name: str) -> str:
        return f"{1e-3 * row['largest_load_n'][name]:.2f} ({100 * row['utilisation'][name]:.1f})"

    anchors = ((f"{name} [kN] ([%])", load, name) for name in found["rows"][0]["largest_load_n"])
    return columns(found["rows"], ("heading [deg]", "{heading_deg}"), *anchors, ("moved [m]", "{moved_m:.1f}"))


@command()
def main() -> None:
    collect("edulis_anchors", {"rows": map(anchors, HEADINGS)}, schema=1)
