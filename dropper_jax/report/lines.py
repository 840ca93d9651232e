"""Sections of the report line by line: bending, seabed, water, coefficients and mussels."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record
from dropper_jax.evaluation.settings import Settings
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import bed_height, surface_over
from dropper_jax.modelling.flow_coefficients import flow_dependent_effects, flow_table
from dropper_jax.modelling.growth import has_mussels, overgrown
from dropper_jax.quantities.bending import bending_moment, bending_summary, curvature, has_bending
from dropper_jax.report.motion import node_arc, node_rows
from dropper_jax.report.tables import Rows
from dropper_jax.scene import BuoySpec, sliced_lines
from dropper_jax.scene.slices import point_nodes


def bed_contact(record: Record, settings: Settings) -> Rows:
    """Per line: length on the seabed [m] over time, and fraction of time of each node.

    A node is on the seabed if it is at most `contact` above it, a link if both its ends are. The length is a number of
    complete links, so it is zero for a line that rises from an anchor on the seabed.
    """
    bed = bed_height(record.scene, record.positions)
    if bed is None:
        return {"skipped": "the scene has no [effects.seabed]"}
    touching = record.positions[..., 2] - bed <= settings.contact
    found = []
    for row, where in node_rows(record):
        node_touches = touching[:, where.nodes]
        length = (node_touches[:, :-1] & node_touches[:, 1:]) @ np.asarray(where.spec.length, float)
        found.append(
            {
                **row,
                "length_m": spread(length, ("min", "mean", "max")),
                "share_of_line": float(length.mean() / where.spec.total),
                "share_of_time": node_touches.mean(axis=0),
                "share_with_contact": float(np.mean(length > 0)),
            }
        )
    return found


def flow_coefficients(scene: Scene) -> Rows:
    """Coefficients that depend on the flow, per line."""
    if flow_dependent_effects(scene):
        return flow_table(overgrown(scene))
    return {"skipped": "the scene has no flow-dependent coefficients"}


def line_bending(record: Record) -> Rows:
    """Per line the maximum moment [N m], its arc length [m] and time [s], the minimum radius [m], and the maximum and
    mean moment of each node [N m] against arc length from the first point [m]."""
    scene = record.scene
    if not has_bending(scene):
        return {"skipped": "the scene has no [effects.bending]"}
    kappa = curvature(scene, record.positions, record.t)
    moment = bending_moment(scene, record.positions, record.t, tuple(record.solution.broken))
    summary = bending_summary(scene, record.t, kappa, moment)
    found = []
    for line, where in sliced_lines(scene):
        own = moment[:, where.nodes]
        along = {"length_m": node_arc(line.length), "max_n_m": own.max(axis=0)}
        found.append({"line": line.name, **summary[line.name], **along, "mean_n_m": own.mean(axis=0)})
    return found


def submergence(record: Record) -> Table:
    """Per line the fraction of time under the actual surface and the depth [m] of its nodes; per buoy the draught."""
    if record.scene.sea is None:
        return {"skipped": "the scene has no water"}
    depth = surface_over(record.scene, record.positions, record.t) - record.positions[..., 2]
    lines = []
    for row, where in node_rows(record):
        own = depth[:, where.nodes]
        lines.append(
            {
                **row,
                "share_under_water": (own > 0).mean(axis=0),
                "mean_depth_m": own.mean(axis=0),
                "least_depth_m": own.min(axis=0),
                "largest_depth_m": own.max(axis=0),
            }
        )
    return {"lines": lines, "buoys": [_buoy_row(record, buoy, depth) for buoy in record.scene.buoys]}


def _buoy_row(record: Record, buoy: BuoySpec, depth: np.ndarray) -> Table:
    """Draught and submergence of a buoy, from the depths (k, nodes) [m] of all nodes."""
    draught = depth[:, point_nodes(record.scene)[buoy.point]] + buoy.attachment
    return {
        "buoy": buoy.name,
        "draught_m": spread(draught, ("min", "mean", "max")),
        "height_m": buoy.height,
        "share_under_water": float(np.mean(draught >= buoy.height)),
        "share_out_of_water": float(np.mean(draught <= 0)),
        "longest_under_water_s": _longest_span(draught >= buoy.height, record.t),
    }


def _longest_span(under: np.ndarray, t: np.ndarray) -> float:
    """Longest uninterrupted time [s] in which all samples are true."""
    changes = np.diff(under.astype(int), prepend=0, append=0)
    first = np.flatnonzero(changes == 1)
    last = np.flatnonzero(changes == -1) - 1
    return float(np.max(t[last] - t[first], initial=0.0))


def crops(record: Record) -> Rows:
    """Per line with mussels: their mass [kg], weight in water [N] and maximum diameter [m], and the drop-off.

    A mussel drops off if the acceleration of its node exceeds `SeasonSpec.holding`. `mass_at_risk_kg` is the crop on
    links with a node above this limit, `share_beyond` the fraction of nodes and samples above it.
    """
    scene = record.scene
    sea = scene.sea
    season = scene.season
    if not any(has_mussels(scene, line) for line in scene.lines):
        return {"skipped": "the scene has no mussels ([growth] or [line.growth])"}
    found = []
    for bare, (line, where) in zip(scene.lines, sliced_lines(overgrown(scene)), strict=True):
        if not has_mussels(scene, bare):
            continue
        if sea is None or line.diameter is None or bare.diameter is None:
            continue  # a line with mussels has both
        crop = line.mass - bare.mass
        volume = 0.25 * np.pi * (line.diameter**2 - bare.diameter**2) * line.length
        drop_off = None
        if season is not None and np.any(volume > 0.0):
            limit = season.detachment_acceleration(float(np.sum(crop) / np.sum(volume)), sea.density, sea.gravity)
            if limit is not None:
                drop_off = _drop_off(record.acceleration[:, where.nodes], crop, limit)
        found.append(
            {
                "line": bare.name,
                "mass_kg": float(np.sum(crop)),
                "wet_weight_n": float(sea.gravity * np.sum(crop - sea.density * volume)),
                "largest_diameter_m": float(np.max(line.diameter)),
                "drop_off": drop_off,
            }
        )
    return found


def _drop_off(acceleration: np.ndarray, crop: np.ndarray, limit: float) -> Table:
    """The drop-off of a line: acceleration (k, n + 1) [m/s^2] of its nodes, mussels (n,) [kg] on its links."""
    beyond = acceleration > limit
    ever = np.any(beyond, axis=0)
    at_risk = ever[1:] | ever[:-1]
    return {
        "limit_m_per_s2": limit,
        "largest_m_per_s2": float(acceleration.max()),
        "share_beyond": float(np.mean(beyond)),
        "mass_at_risk_kg": float(np.sum(crop[at_risk])),
    }
