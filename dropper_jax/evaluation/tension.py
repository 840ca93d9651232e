"""Tensions along each line: statistics, percentiles, utilisation, and the loads of the supports."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.interpolation import interpolate_rows
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.evaluation.settings import Settings
from dropper_jax.quantities.end_forces import end_angles, end_forces
from dropper_jax.quantities.end_links import loaded_fixed_points, point_loads
from dropper_jax.quantities.statistics import excess_kurtosis, statistic
from dropper_jax.quantities.step_extremes import LOADS, load_components
from dropper_jax.scene import AnchorSpec, WholeLine, sliced_lines, utilisations
from dropper_jax.stepping.extremes import Extremes


def line_tensions(record: Record, settings: Settings) -> list[Table]:
    """Per line: min, mean, standard deviation, max and percentiles of each link [N] against arc length [m].

    The maximum and minimum of the line have their arc length and time. Utilisation is the maximum over the links of the
    ratio of maximum tension to breaking load, without and with the safety factor. At both ends of the line the mean and
    the maximum of its force on the point over all steps [N], with its time [s], and of its angle [deg].
    """
    at_tension = interpolate_rows(record.t, record.positions, record.t_tension)
    forces = end_forces(record.scene, at_tension, record.tension, t=record.t_tension)
    angles = end_angles(at_tension, record.written_lines)
    found = []
    for i, where in enumerate(record.written_lines):
        row = _line(record, where, settings)
        peaks = record.extremes["end_force"].of(i)
        for j, end in enumerate(("first", "last")):
            top = int(np.argmax(peaks.largest[:, j]))
            angle = angles[where.name][:, j]
            row |= {
                f"mean_{end}_force_n": float(np.mean(forces[where.name][:, j])),
                f"max_{end}_force_n": float(peaks.largest[top, j]),
                f"max_{end}_force_s": float(peaks.largest_at[top, j]),
                f"mean_{end}_angle_deg": float(np.mean(angle)),
                f"max_{end}_angle_deg": float(np.max(angle)),
            }
        found.append(row)
    return found


def _line(record: Record, where: WholeLine, settings: Settings) -> Table:
    """Statistics of the tensions of one line, without those of its ends."""
    percentiles = (1, 5, 25, 50, 75, 95, 99)
    spec = where.spec
    tension = record.tension[:, where.links]
    s = arc(spec.length)
    within = np.mean(record.square[:, where.links] - tension**2, axis=0)
    extremes = record.extremes["tension"].of(where.links)
    high = np.unravel_index(np.argmax(extremes.largest), tension.shape)
    low = np.unravel_index(np.argmin(extremes.least), tension.shape)
    largest = extremes.largest.max(axis=0)
    return {
        "line": where.name,
        "arc_length_m": s,
        "min_n": extremes.least.min(axis=0),
        "mean_n": tension.mean(axis=0),
        "std_n": np.sqrt(tension.var(axis=0) + within),
        "max_n": largest,
        "percentiles_n": dict(zip(map(str, percentiles), np.percentile(tension, percentiles, axis=0), strict=True)),
        "largest": _peak(s, high, extremes.largest, extremes.largest_at),
        "least": _peak(s, low, extremes.least, extremes.least_at),
        "mean_first_link_n": float(tension[:, 0].mean()),
        "mean_last_link_n": float(tension[:, -1].mean()),
        "utilisation": _utilisation(record, where, largest, settings),
        **_smooth_maxima(record, tension),
    }


def _utilisation(record: Record, where: WholeLine, largest: np.ndarray, settings: Settings) -> Table | None:
    """Maximum tensions (n,) [N] of a line over its breaking load, without and with the safety factor."""
    load = breaking_load(record, where, settings)
    if load is None:
        return None
    share = largest / load
    worst = int(np.argmax(share))
    source = "the line"
    if np.isnan(_breaking_load(record, where)[worst]):
        source = "--breaking-load"
    return {
        "largest": float(share[worst]),
        "with_factor": settings.safety_factor * float(share[worst]),
        "at_m": float(arc(where.spec.length)[worst]),
        "breaking_load_n": float(load[worst]),
        "from": source,
        "along": share,
    }


def _peak(s: np.ndarray, where: tuple[np.intp, ...], values: np.ndarray, times: np.ndarray) -> dict[str, float]:
    """A value (k, n) of links at arc lengths s (n,), with its arc length and time."""
    return {"n": float(values[where]), "at_m": float(s[where[1]]), "t_s": float(times[where])}


def _smooth_maxima(record: Record, tension: np.ndarray) -> dict[str, float]:
    """Maxima of a line's tensions (k, n) [N] that do not depend on a single step: `sustained_n` of the means over
    0.2 s, `most_probable_n` in three hours of a Gaussian process, and the excess kurtosis, 0 for such a process."""
    interval = float(np.mean(np.diff(record.t_tension)))
    samples = jnp.asarray(tension)
    return {
        "sustained_n": float(statistic("sustained", samples, interval)),
        "most_probable_n": float(statistic("mpm", samples, interval)),
        "excess_kurtosis": excess_kurtosis(tension),
    }


def breaking_load(record: Record, where: WholeLine, settings: Settings) -> np.ndarray | None:
    """Breaking load (n,) [N] of the links of a line: that of their piece of the line, else the setting; None if links
    have neither."""
    load = _breaking_load(record, where)
    if settings.breaking_load is not None:
        load = np.where(np.isnan(load), settings.breaking_load, load)
    if np.isnan(load).any():
        return None
    return load


def _breaking_load(record: Record, where: WholeLine) -> np.ndarray:
    """Breaking load (n,) [N] of the links of a line in the scene; NaN of a piece without one."""
    loads = np.full(record.tension.shape[1], np.nan)
    for piece, own in sliced_lines(record.scene):
        if piece.breaking_load is not None:
            loads[own.links] = piece.breaking_load
    return loads[where.links]


#: Below this fraction of its mean a load has no defined direction.
NO_DIRECTION = 0.01


def anchors(record: Record) -> list[Table]:
    """Force of the lines on each fixed point: horizontal and vertical (upwards positive) load [N], uplift angle [rad].

    It is the sum of the forces of the lines that end there (see `quantities.end_links`), at the times of the tensions.
    The uplift angle, `atan2(vertical, horizontal)`, is evaluated if the load is at least 1 % of its mean: a zero load
    has no direction. Minima and maxima of the loads are those of all steps, the total one at the time `max_s` [s].
    """
    found = []
    anchor_at = {anchor.point: anchor for anchor in record.scene.anchors}
    loads = point_loads(record.motion)
    peaks = load_extremes(record)
    for name, extremes in peaks.items():
        load = load_components(loads[name])
        row: Table = {"point": name}
        for i, part in enumerate(LOADS):
            low = float(extremes.least[:, i].min())
            row[f"{part}_n"] = spread(load[:, i]) | {"min": low, "max": float(extremes.largest[:, i].max())}
        top = int(np.argmax(extremes.largest[:, 2]))
        row["total_n"]["max_s"] = float(extremes.largest_at[top, 2])
        horizontal, vertical, size = load.T
        loaded = size >= max(NO_DIRECTION * size.mean(), 1e-12)
        row["share_without_angle"] = float(1.0 - loaded.mean())
        row |= dict.fromkeys(("uplift_rad", "uplift_at_largest_load_rad", "holding"))
        if loaded.any():
            row["uplift_rad"] = spread(np.arctan2(vertical[loaded], horizontal[loaded]))
            row["uplift_at_largest_load_rad"] = _uplift(extremes, top)
        if name in anchor_at:
            row["holding"] = _holding(anchor_at[name], record.scene.anchors, peaks)
        found.append(row)
    return found


def load_extremes(record: Record) -> dict[str, Extremes]:
    """Extremes (q, 3) [N] of the horizontal, vertical and total load of each fixed point; zero where no line ends."""
    zero = np.zeros((len(record.t_tension), 3))
    times = np.tile(record.t_tension[:, None], 3)
    rows = dict.fromkeys(record.scene.fixed_points, Extremes(zero, zero, times, times))
    for i, name in enumerate(loaded_fixed_points(record.scene)):
        rows[name] = record.extremes["point_load"].of(i)
    return rows


def _uplift(extremes: Extremes, row: int) -> float:
    """Angle [rad] above the horizontal of the maximum load since the previous sample.

    An extreme of the vertical or the horizontal part at the time of the maximum load gives it; if neither is at this
    time, it is that of both maxima.
    """
    size = extremes.largest[row, 2]
    when = extremes.largest_at[row, 2]
    highest = extremes.largest[row, 1]
    lowest = extremes.least[row, 1]
    for up, at in ((highest, extremes.largest_at[row, 1]), (lowest, extremes.least_at[row, 1])):
        if at == when and size > 0.0:
            return float(np.arcsin(np.clip(up / size, -1.0, 1.0)))
    steepest = max(highest, lowest, key=abs)
    across = extremes.largest[row, 0]
    if extremes.largest_at[row, 0] == when:
        steepest = np.copysign(np.sqrt(max(size**2 - across**2, 0.0)), steepest)
    return float(np.arctan2(steepest, across))


def _holding(anchor: AnchorSpec, anchors: tuple[AnchorSpec, ...], peaks: dict[str, Extremes]) -> Table:
    """Utilisation of an anchor over the run, and the ratio of its capacity to its maximum load.

    The loads of a sample are the maxima of the horizontal and of the vertical part over its steps, which is on the safe
    side where these are at different times.

    It holds with the required factor if it holds the loads multiplied by this factor, or if the anchor behind it does.
    """
    loads = {name: extremes.largest[:, :2].T for name, extremes in peaks.items()}
    used = utilisations(anchors, loads)
    factored = utilisations(anchors, {name: anchor.safety_factor * load for name, load in loads.items()})
    largest = float(used[anchor.point].max())
    factor = None
    if largest > 0.0:
        factor = 1.0 / largest
    found = {
        "kind": anchor.kind,
        "behind": anchor.behind,
        "utilisation": spread(used[anchor.point]),
        "factor": factor,
        "required_factor": anchor.safety_factor,
        "holds": bool(factored[anchor.behind or anchor.point].max() <= 1.0),
    }
    if anchor.kind == "screw":
        found["capacity_n"] = anchor.screw_capacity
    return found
