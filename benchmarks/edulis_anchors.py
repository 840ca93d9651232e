"""Loads and utilisation of Edulis' four anchors through the tide at each heading.

    python benchmarks/edulis_anchors.py

Takes about a minute. Writes results/edulis_anchors.json, of which `python benchmarks/tables.py` makes a table.
"""

import numpy as np
from study import Found, collect, command

from dropper_jax import load_scene
from dropper_jax.study.sea_facts import tidal_cycle

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


@command()
def main() -> None:
    collect("edulis_anchors", {"rows": map(anchors, HEADINGS)}, schema=1)
