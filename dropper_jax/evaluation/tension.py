"""Tensions along each line: statistics, percentiles, utilisation, and the loads of the supports."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc, spread
from dropper_jax.evaluation.settings import Settings
from dropper_jax.run.bends import held_points
from dropper_jax.run.bends import point_load as line_load
from dropper_jax.run.end_links import positions_at
from dropper_jax.run.line_weights import end_angles, end_forces
from dropper_jax.run.statistics import excess_kurtosis, statistic
from dropper_jax.scene import AnchorSpec, LineSpec, WholeLine, utilisations
from dropper_jax.stepping.extremes import Extremes


def line_tensions(record: Record, settings: Settings) -> list[Table]:
    """Per line: min, mean, standard deviation, max and percentiles of each link [N] against arc length [m].

    The maximum and minimum of the line have their arc length and time. Utilisation is the maximum over the links of the
    ratio of maximum tension to breaking load, without and with the safety factor.
    """
    at_tension = positions_at(record.t, record.positions, record.t_tension)
    forces = end_forces(record.scene, at_tension, record.tension, t=record.t_tension)
    angles = end_angles(at_tension, record.written_lines)
    found = []
    for i, where in enumerate(record.written_lines):
        extremes = Extremes(*(a[:, i] for a in record.extremes["end_force"]))
        ends = _ends("force_n", forces[where.name]) | _force_peaks(extremes)
        found.append(_line(record, where, settings) | ends | _ends("angle_deg", angles[where.name]))
    return found


def _ends(key: str, values: np.ndarray) -> dict[str, float]:
    """Mean and maximum of values (k, 2) at both ends."""
    found = {}
    for i, end in enumerate(("first", "last")):
        for what, function in (("mean", np.mean), ("max", np.max)):
            found[f"{what}_{end}_{key}"] = float(function(values[:, i]))
    return found


def _force_peaks(extremes: Extremes) -> dict[str, float]:
    """Maximum force on both end points over all steps [N], and its time [s]."""
    found = {}
    for i, end in enumerate(("first", "last")):
        when = int(np.argmax(extremes.largest[:, i]))
        found[f"max_{end}_force_n"] = float(extremes.largest[when, i])
        found[f"max_{end}_force_s"] = float(extremes.largest_at[when, i])
    return found


def _line(record: Record, where: WholeLine, settings: Settings) -> Table:
    percentiles = (1, 5, 25, 50, 75, 95, 99)
    spec = where.spec
    tension = record.tension[:, where.links]
    s = arc(spec.length)
    square = record.square[:, where.links]
    least, largest, least_at, largest_at = (a[:, where.links] for a in record.extremes["tension"])
    high = np.unravel_index(np.argmax(largest), tension.shape)
    low = np.unravel_index(np.argmin(least), tension.shape)
    found: Table = {
        "line": where.name,
        "arc_length_m": s,
        "min_n": least.min(axis=0),
        "mean_n": tension.mean(axis=0),
        "std_n": np.sqrt(tension.var(axis=0) + np.mean(square - tension**2, axis=0)),
        "max_n": largest.max(axis=0),
        "percentiles_n": dict(zip(map(str, percentiles), np.percentile(tension, percentiles, axis=0), strict=True)),
        "largest": {"n": float(largest[high]), "at_m": float(s[high[1]]), "t_s": float(largest_at[high])},
        "least": {"n": float(least[low]), "at_m": float(s[low[1]]), "t_s": float(least_at[low])},
        "mean_first_link_n": float(tension[:, 0].mean()),
        "mean_last_link_n": float(tension[:, -1].mean()),
        "utilisation": None,
    }
    found |= _smooth_maxima(record, tension)
    load = breaking_load(spec, settings)
    if load is not None:
        share = largest.max(axis=0) / load
        worst = int(np.argmax(share))
        found["utilisation"] = {
            "largest": float(share[worst]),
            "with_factor": settings.safety_factor * float(share[worst]),
            "at_m": float(s[worst]),
            "breaking_load_n": float(load[worst]),
            "from": "the line" if spec.breaking_load is not None else "--breaking-load",
            "along": share,
        }
    return found


def _smooth_maxima(record: Record, tension: np.ndarray) -> dict[str, float]:
    """Maxima of a line's tensions (k, n) [N] that do not depend on a single step: `sustained_n` of the means over
    0.2 s, `most_probable_n` in three hours of a Gaussian process, and the excess kurtosis, 0 for such a process."""
    t = record.t_tension
    interval = 1.0
    if len(t) > 1:
        interval = float(np.mean(np.diff(t)))
    return {
        "sustained_n": float(statistic("sustained", jnp.asarray(tension), interval)),
        "most_probable_n": float(statistic("mpm", jnp.asarray(tension), interval)),
        "excess_kurtosis": excess_kurtosis(tension),
    }


def breaking_load(spec: LineSpec, settings: Settings) -> np.ndarray | None:
    """Breaking load (n,) [N] of the links of a line: that of the line, else the setting, else None."""
    if spec.breaking_load is not None:
        return np.asarray(spec.breaking_load, float)
    if settings.breaking_load is None:
        return None
    return np.full(spec.links, settings.breaking_load)


#: Below this fraction of its mean a load has no defined direction.
NO_DIRECTION = 0.01


def anchors(record: Record) -> list[Table]:
    """Force of the lines on each fixed point: horizontal and vertical (upwards positive) load [N], uplift angle [rad].

    It is the sum of the forces of the lines that end there (see `run.end_links`), at the times of the tensions. The
    uplift angle, `atan2(vertical, horizontal)`, is evaluated if the load is at least 1 % of its mean: a zero load has
    no direction. Minima and maxima of the loads are those of all steps, the total one at the time `max_s` [s].
    """
    found = []
    held = {anchor.point: anchor for anchor in record.scene.anchors}
    peaks = load_extremes(record)
    for name, extremes in peaks.items():
        load = point_load(record, name)
        across = np.hypot(load[:, 0], load[:, 1])
        up = load[:, 2]
        size = np.linalg.norm(load, axis=1)
        top = int(np.argmax(extremes.largest[:, 2]))
        most = {"max_s": float(extremes.largest_at[top, 2])}
        loaded = size >= max(NO_DIRECTION * size.mean(), 1e-12)
        uplift_rad = None
        uplift_at_largest_load_rad = None
        if loaded.any():
            uplift_rad = spread(np.arctan2(up[loaded], across[loaded]))
            uplift_at_largest_load_rad = _uplift(extremes, top)
        holding = None
        if name in held:
            holding = _holding(held[name], record.scene.anchors, peaks)
        found.append(
            {
                "point": name,
                "horizontal_n": spread(across) | _extremes_of(extremes, 0),
                "vertical_n": spread(up) | _extremes_of(extremes, 1),
                "total_n": spread(size) | _extremes_of(extremes, 2) | most,
                "uplift_rad": uplift_rad,
                "share_without_angle": float(1.0 - loaded.mean()),
                "uplift_at_largest_load_rad": uplift_at_largest_load_rad,
                "holding": holding,
            }
        )
    return found


def load_extremes(record: Record) -> dict[str, Extremes]:
    """Extremes (q, 3) [N] of the horizontal, vertical and total load of each fixed point; zero where no line ends."""
    found = record.extremes["point_load"]
    loaded = held_points(record.scene)
    zero = np.zeros((len(record.t_tension), 3))
    times = np.tile(record.t_tension[:, None], 3)
    none = Extremes(zero, zero, times, times)
    rows = {}
    for point in record.scene.points:
        if not point.is_free:
            rows[point.name] = (
                Extremes(*(a[:, loaded.index(point.name)] for a in found)) if point.name in loaded else none
            )
    return rows


def _extremes_of(extremes: Extremes, part: int) -> dict[str, float]:
    """Minimum and maximum of a part of a load over all steps [N]."""
    return {"min": float(extremes.least[:, part].min()), "max": float(extremes.largest[:, part].max())}


def _uplift(extremes: Extremes, row: int) -> float:
    """Angle [rad] above the horizontal of the maximum load since the previous sample.

    An extreme of the vertical or the horizontal part at the time of the maximum load gives it; if neither is at this
    time, it is that of both maxima.
    """
    size = extremes.largest[row, 2]
    when = extremes.largest_at[row, 2]
    ups = (extremes.largest[row, 1], extremes.largest_at[row, 1]), (extremes.least[row, 1], extremes.least_at[row, 1])
    for up, at in ups:
        if at == when and size > 0.0:
            return float(np.arcsin(np.clip(up / size, -1.0, 1.0)))
    steepest = max((up for up, _ in ups), key=abs)
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


def point_load(record: Record, name: str) -> np.ndarray:
    """Force (q, 3) [N] of all lines on a point."""
    return line_load(record.scene, name, record.t, record.positions, record.t_tension, record.tension)
