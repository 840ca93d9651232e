"""What the lines pull on held points in a load case, and how much of it their anchors hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fitting.cases.characteristic import characteristic
from fitting.site import Anchor, Site, Storm

#: Share of an anchor's mean load below which a load has no direction.
LOADED = 0.01


def anchor_of(site: Site, name: str) -> Anchor | None:
    """What holds a point, None where the site does not say."""
    return next((anchor for anchor in site.anchors if name in anchor.points), None)


def anchor_row(site: Site, name: str, storm: Storm, loads: Sequence[np.ndarray]) -> dict[str, Any]:
    """A held point in a case: loads, uplift and utilisation, each the characteristic value of the seeds' maxima.

    Args:
        loads: horizontal and upward loads (k, 2) [N] of each seed.
    """
    run, anchor = site.run_of(storm), anchor_of(site, name)
    row: dict[str, Any] = {
        "case": storm.number,
        "total_n": characteristic(np.array([np.hypot(*load.T).max() for load in loads]), run),
        "upward_n": characteristic(np.array([load[:, 1].max() for load in loads]), run),
        "uplift_deg": max(_uplift(load) for load in loads),
        "utilisation": None,
        "utilisation_error": None,
    }
    if anchor is not None:
        factor = anchor.factor[storm.kind]
        used = characteristic(np.array([anchor.utilisation(*load.T).max() for load in loads]), run)
        error = None if used["error"] is None else factor * used["error"]
        row |= {"factor": factor, "utilisation": factor * used["value"], "utilisation_error": error}
    return row


def _uplift(load: np.ndarray) -> float:
    """Largest angle [deg] of loads (k, 2) over the horizontal, of those that have a direction."""
    size = np.hypot(*load.T)
    loaded = size >= max(LOADED * size.mean(), 1e-12)
    return float(np.degrees(np.arctan2(load[loaded, 1], load[loaded, 0]).max())) if loaded.any() else 0.0


def anchor_found(site: Site, name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A held point over all cases: its rows, the worst of them, and the uplift beside what is allowed [deg]."""
    anchor = anchor_of(site, name)
    by = (lambda row: row["total_n"]["value"]) if anchor is None else (lambda row: row["utilisation"])
    return {
        "point": name,
        "anchor": None if anchor is None else anchor.name,
        "cases": rows,
        "worst": max(rows, key=by) if rows else None,
        "uplift_deg": max((row["uplift_deg"] for row in rows), default=None),
        "allowed_uplift_deg": None if anchor is None else anchor.table.uplift,
    }
