"""Loads and utilisation of Edulis' four anchors through the tide at each heading.

    python benchmarks/edulis_anchors.py

Takes about a minute. Writes results/edulis_anchors.json, of which `python benchmarks/tables.py` makes a table.
"""

from __future__ import annotations

import numpy as np
from study import store

from dropper_jax import load_scene
from dropper_jax.study.sea_facts import tidal_cycle

NAMES = ("west-danforth", "east-danforth", "west-gravity", "east-gravity")
HEADINGS = range(0, 91, 15)  # [deg] of the tide against the backbone


def main() -> None:
    rows = []
    for heading in HEADINGS:
        scene = load_scene("edulis-tide").with_values({"sea.current.direction": float(np.radians(heading))})
        found = tidal_cycle(scene)
        assert all(row["status"] == "ok" for row in found["rows"])
        loads = {n: max(float(np.linalg.norm(r["held_load_n"][n])) for r in found["rows"]) for n in NAMES}
        used = {n: max(r["anchor_utilisation"][n] for r in found["rows"]) for n in NAMES}
        moved = max(row["displacement_m"] for row in found["rows"])
        rows.append({"heading_deg": heading, "largest_load_n": loads, "utilisation": used, "moved_m": moved})
        print(rows[-1], flush=True)
    store("edulis_anchors", {"schema": 1, "rows": rows})


if __name__ == "__main__":
    main()
