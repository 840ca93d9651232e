"""Loads and utilisation of fixed points over all load cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from dropper_jax.base.read import Table
from fitting.farm.cases.flags import characteristic
from fitting.farm.site import Anchor, Site, Storm


def anchor_of(site: Site, name: str) -> Anchor | None:
    """The anchor of a point, None if the site does not define one."""
    return next((anchor for anchor in site.anchors if name in anchor.points), None)


def anchor_row(site: Site, name: str, storm: Storm, loads: Sequence[np.ndarray]) -> Table:
    """A fixed point in one case: loads, uplift and utilisation, each the characteristic value of the seeds' maxima.

    Args:
        loads: horizontal and upward loads (k, 2) [N] of each seed.
    """
    run = site.run_of(storm)
    anchor = anchor_of(site, name)
    row: Table = {
        "case": storm.number,
        "total_n": asdict(characteristic(np.array([np.hypot(*load.T).max() for load in loads]), run)),
        "upward_n": asdict(characteristic(np.array([load[:, 1].max() for load in loads]), run)),
        "uplift_deg": max(map(_uplift, loads)),
        "utilisation": None,
        "utilisation_error": None,
    }
    if anchor is not None:
        factor = anchor.factor[storm.kind]
        used = characteristic(np.array([anchor.table.utilisation(*load.T).max() for load in loads]), run)
        error = None
        if used.error is not None:
            error = factor * used.error
        row |= {"factor": factor, "utilisation": factor * used.value, "utilisation_error": error}
    return row


#: Below 1 % of its mean a load has no defined direction.
NO_DIRECTION = 0.01


def _uplift(load: np.ndarray) -> float:
    """Maximum angle [deg] above the horizontal of loads (k, 2), among those that have a direction."""
    size = np.hypot(*load.T)
    loaded = size >= max(NO_DIRECTION * size.mean(), 1e-12)
    if loaded.any():
        return float(np.degrees(np.arctan2(load[loaded, 1], load[loaded, 0]).max()))
    return 0.0


def anchor_found(site: Site, name: str, rows: list[Table]) -> Table:
    """A fixed point over all cases: its rows, the worst of them, and the uplift with its limit [deg]."""
    anchor = anchor_of(site, name)

    def load(row: Table) -> float:
        return row["total_n"]["value"] if anchor is None else row["utilisation"]

    allowed_uplift_deg = None
    if anchor is not None:
        allowed_uplift_deg = anchor.table.uplift
    return {
        "point": name,
        "anchor": None if anchor is None else anchor.name,
        "cases": rows,
        "worst": max(rows, key=load, default=None),
        "uplift_deg": max((row["uplift_deg"] for row in rows), default=None),
        "allowed_uplift_deg": allowed_uplift_deg,
    }
