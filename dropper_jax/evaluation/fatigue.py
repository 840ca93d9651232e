"""Fatigue of lines: rainflow cycles of their tensions, equivalent ranges, and the damage of a year."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.tension import breaking_load
from dropper_jax.run.storage import extra
from dropper_jax.scene import WholeLine

#: A year of 365.25 days [s].
YEAR = 365.25 * 86400.0
#: Ranges below this fraction of the maximum tension of the record are rounding and are not counted.
RANGE_ROUNDING = 1e-9
#: Number of links of a scene up to which all are counted: the counting is plain Python.
MAX_COUNTED_LINKS = 200
#: Curves of parts, K and m over the breaking load: a curve for chain does not apply to rope.
CURVES = (
    "316 and 3 for studless chain, 1000 and 3 for stud chain (API RP 2SK), 25000 and 5.2 for polyester (API RP 2SM)"
)
NO_LOAD = "no breaking load: give `breaking_load` in the scene, or --breaking-load"
NO_CURVE = f"no curve of the part: give --curve-k and --curve-m, as {CURVES}"


def turning_points(x: np.ndarray) -> np.ndarray:
    """First and last value of x (k,) and every peak and valley between; one of equal neighbours."""
    x = x[np.concatenate([[True], np.diff(x) != 0])]
    if len(x) < 3:
        return x
    up = np.diff(x) > 0
    return x[np.concatenate([[True], up[1:] != up[:-1], [True]])]


def cycles(tension: np.ndarray) -> np.ndarray:
    """Rainflow cycles (c, 3) of a tension (k,): range [N], mean [N], count 0.5 or 1 (ASTM E1049-85, 5.4.4).

    Raises:
        SceneError: the package `rainflow` is not installed.
    """
    rainflow = extra("rainflow", "fatigue")
    found = [cycle[:3] for cycle in rainflow.extract_cycles(turning_points(tension).tolist())]
    return np.array(found, float).reshape(-1, 3)


def damage(counted: np.ndarray, load: float, k: float, m: float) -> float:
    """Palmgren-Miner damage of cycles (c, 3) `sum count/N`, `N = k (range/load)^-m`, load the breaking load [N]."""
    return float(np.sum(counted[:, 2] * (counted[:, 0] / load) ** m) / k)


def line_fatigue(record: Record, settings: Settings) -> list[Table]:
    """Per line: equivalent range, counted cycles and, with a breaking load, the damage of the record and of a year.

    The equivalent range `(sum n R^m / sum n)^(1/m)` [N] needs no breaking load. Of a scene with many links
    (`MAX_COUNTED_LINKS`) only the end links of each line and the one with the largest deviation are counted.
    """
    return [_fatigue(record, line, settings) for line in record.written_lines]


def _fatigue(record: Record, line: WholeLine, settings: Settings) -> Table:
    """The fatigue of the counted links of one line."""
    spec = line.spec
    tension = record.tension[:, line.links]
    picked = list(range(spec.links))
    if record.tension.shape[1] > MAX_COUNTED_LINKS:
        picked = sorted({0, int(np.argmax(tension.std(axis=0))), spec.links - 1})
    least = RANGE_ROUNDING * float(np.abs(record.tension).max())
    counted = []
    for j in picked:
        own = cycles(tension[:, j])
        counted.append(own[own[:, 0] > least])
    load = breaking_load(record, line, settings)
    damages = None
    why_not = NO_CURVE
    if load is None:
        why_not = NO_LOAD
    elif settings.curve_k is not None:
        pairs = zip(counted, load[picked], strict=True)
        damages = [damage(c, breaking, settings.curve_k, settings.curve_m) for c, breaking in pairs]
    return {
        "line": line.name,
        "arc_length_m": arc(spec.length)[picked],
        "cycles": [float(c[:, 2].sum()) for c in counted],
        "equivalent_range_n": [_equivalent_range(c, settings.curve_m) for c in counted],
        "largest_range_n": [float(c[:, 0].max(initial=0.0)) for c in counted],
        **_damages(record, damages, why_not),
    }


def _equivalent_range(counted: np.ndarray, m: float) -> float:
    """The equivalent range [N] of cycles (c, 3); 0 without any."""
    total = counted[:, 2].sum()
    if total > 0:
        return float((np.sum(counted[:, 2] * counted[:, 0] ** m) / total) ** (1 / m))
    return 0.0


def _damages(record: Record, values: list[float] | None, why_not: str) -> Table:
    """Damages of the record by link, the damage of a year and the life, or the reason for their absence."""
    if values is None:
        return {"damage": None, "why_no_damage": why_not}
    worst = max(values)
    yearly = worst * YEAR / record.duration
    life = None
    if yearly > 0:
        life = 1.0 / yearly
    return {"damage": values, "largest_damage": worst, "damage_per_year": yearly, "life_years": life}
