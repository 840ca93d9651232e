"""Mussels on the lines of a run: their weight, and where they may have dropped off."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.record import Record
from dropper_jax.report.sections import table
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import line_slices


def crops(record: Record) -> list[dict[str, Any]] | dict[str, str]:
    """Per line with mussels: their mass [kg], weight in water [N] and maximum diameter [m], and the drop-off.

    A mussel drops off if the acceleration of its node exceeds `SeasonSpec.holding`. `mass_at_risk_kg` is the crop on
    links with a node above this limit, `share_beyond` the fraction of nodes and samples above it.
    """
    scene, season = record.scene, record.scene.season
    if season is None and all(line.growth is None for line in scene.lines):
        return {"skipped": "the scene has no mussels ([growth] or [line.growth])"}
    full = overgrown(scene)
    size = np.linalg.norm(np.gradient(record.velocities, record.t, axis=0), axis=-1)
    found = []
    for bare, line, where in zip(scene.lines, full.lines, line_slices(scene), strict=True):
        crop = line.mass - bare.mass
        if bare.growth is None and not (season is not None and season.on(bare.name, bare.piece_of)):
            continue
        volume = 0.25 * np.pi * (line.diameter**2 - bare.diameter**2) * line.length
        row: dict[str, Any] = {
            "line": bare.name,
            "mass_kg": float(np.sum(crop)),
            "wet_weight_n": float(scene.sea.gravity * np.sum(crop - scene.sea.density * volume)),
            "largest_diameter_m": float(np.max(line.diameter)),
            "drop_off": None,
        }
        if season is not None and season.attachment is not None and np.any(volume > 0.0):
            density = float(np.sum(crop) / np.sum(volume))
            limit = season.holding(density, scene.sea.density, scene.sea.gravity)
            beyond = size[:, where.nodes] > limit
            hit = beyond.any(axis=0)
            row["drop_off"] = {
                "limit_m_per_s2": limit,
                "largest_m_per_s2": float(size[:, where.nodes].max()),
                "share_beyond": float(beyond.mean()),
                "mass_at_risk_kg": float(np.sum(crop[hit[1:] | hit[:-1]])),
            }
        found.append(row)
    return found


def crop_text(found: list[dict[str, Any]] | dict[str, str]) -> list[str]:
    """The section as text; empty without mussels."""
    if not isinstance(found, list):
        return []
    rows = []
    for row in found:
        off = row["drop_off"]
        shares = (
            ["-", "-", "-"]
            if off is None
            else [
                f"{off['largest_m_per_s2']:.3g} / {off['limit_m_per_s2']:.3g}",
                f"{100 * off['share_beyond']:.3g}",
                f"{off['mass_at_risk_kg']:.4g}",
            ]
        )
        kept = (f"{row['mass_kg']:.4g}", f"{row['wet_weight_n']:.4g}", f"{row['largest_diameter_m']:.3g}")
        rows.append([row["line"], *kept, *shares])
    head = ["line", "mussels [kg]", "weight in water [N]", "largest diameter [m]"]
    head += ["acceleration, maximum / drop-off [m/s^2]", "exceeded [% of nodes and time]", "at risk [kg]"]
    said = []
    if all(row["drop_off"] is None for row in found):
        said = ["Drop-off is not computed: give `growth.attachment` and `growth.mussel_mass`."]
    return ["## Mussels", table(head, rows), *said]
