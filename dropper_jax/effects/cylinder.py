"""Drag and added mass of rough cylinders over Keulegan-Carpenter number and roughness, and user tables.

Circular cylinders in the post-critical regime:

    steady drag      C_DS = 0.65 (k/D < 1e-4),  (29 + 4 log10(k/D))/20,  1.05 (k/D > 1e-2)
    in waves         C_D = C_DS psi(KC),  C_pi = 1.50 - 0.024 (12/C_DS - 10)
                     psi = C_pi + 0.10 (KC - 12)             2 <= KC < 12
                           C_pi - 1.00                       0.75 <= KC < 2
                           C_pi - 1.00 - 2.00 (KC - 0.75)    KC < 0.75
    added mass       C_A = 1 (KC < 3),  max(1 - 0.044 (KC - 3), 0.6 - (C_DS - 0.65))

If the current is more than 0.4 of the wave velocity, psi is 1: the wake is carried away.

Checked against API RP 2A-WSD (22nd edition, November 2014, 5.3.1.2.8 and B.5.3.1.2.8): C_D 0.65 smooth and 1.05 rough
(1.00 to 1.10 for marine growth); C_M = 1 + C_A of 2 up to KC = 3, and of 1.6 smooth and 1.2 rough from KC = 17 C_DS;
the limit of 0.4.

Assumed: the intermediate values, from DNV-RP-C205 (2010), not verified against the original text (the logarithm of k/D,
psi below KC = 12, the slope of C_A). Beyond KC = 12 recommended practices have figures only; here psi is a straight
line to 1 at KC = 60 C_DS.

Classification Notes 30.5 (DNV, March 2000, 6.1.10) have psi = 1.45 (KC < 10), `2/(KC - 5)^(1/5)` (up to 37), 1. That is
more than here at small KC, and up to a quarter less beyond 12. All values are for nearly vertical cylinders (within 15
degrees): others have psi = 1 and C_M = 2 in API's practice.
"""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Values, plain, refuse, rises

#: Sources of coefficients: the scene's numbers, the rough cylinder above, a table over KC.
SOURCES = ("given", "rough_cylinder", "table")
#: Reynolds number above which cylinders as rough as mussel ropes are assumed to be post-critical.
POST_CRITICAL = 1e5
#: KC over C_DS from which psi is 1.
FADED = 60.0
#: Fraction of the current in current and wave from which psi is 1: a current of 0.4 of the wave velocity.
CARRIED_AWAY = 0.4 / 1.4


def steady_drag(roughness: np.ndarray) -> np.ndarray:
    """C_DS at relative roughnesses k/D (...)."""
    k = np.maximum(np.asarray(roughness, float), 1e-12)
    return np.where(k < 1e-4, 0.65, np.where(k > 1e-2, 1.05, (29.0 + 4.0 * np.log10(k)) / 20.0))


def amplification(kc: np.ndarray, steady: np.ndarray) -> np.ndarray:
    """psi at KC (...) for C_DS (...); 1 where KC is infinite (no waves)."""
    kc = np.asarray(kc, float)
    top = 1.50 - 0.024 * (12.0 / steady - 10.0)
    finite = np.where(np.isfinite(kc), kc, FADED * steady)
    high = top + (1.0 - top) * np.clip((finite - 12.0) / (FADED * steady - 12.0), 0.0, 1.0)
    low = np.where(finite < 0.75, top - 1.0 - 2.0 * (finite - 0.75), top - 1.0)
    return np.where(finite >= 12.0, high, np.where(finite >= 2.0, top + 0.10 * (finite - 12.0), low))


def rough_drag(kc: np.ndarray, roughness: np.ndarray, current: np.ndarray) -> np.ndarray:
    """C_D at KC (...), k/D (...) and the fraction of the current in current and wave (...)."""
    steady = steady_drag(roughness)
    return steady * np.where(np.asarray(current) > CARRIED_AWAY, 1.0, amplification(kc, steady))


def rough_added_mass(kc: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """C_A at KC (...) and k/D (...); 1 without waves."""
    kc = np.asarray(kc, float)
    steady = steady_drag(roughness)
    finite = np.where(np.isfinite(kc), kc, 0.0)
    return np.where(finite < 3.0, 1.0, np.maximum(1.0 - 0.044 * (finite - 3.0), 0.6 - (steady - 0.65)))


def from_table(path: str, kc: np.ndarray, re: np.ndarray, values: Values, key: str) -> np.ndarray:
    """Coefficients (links,) interpolated between the rows of a scene's table over KC.

    Raises:
        SceneError: KC or Re is outside the table.
    """
    rows = values["table_kc"]
    _check_inside(f"{path}.table_kc", kc, rows, "KC")
    if values["table_re"] is not None:
        _check_inside(f"{path}.table_re", re, values["table_re"], "Re")
    return np.interp(kc, rows, values[key])


def _check_inside(path: str, found: np.ndarray, table: np.ndarray, name: str) -> None:
    """Reject numbers of links (links,) outside the range of a rising table; `name` is the name of the number."""
    low = table[0]
    high = table[-1]
    worst = found[np.argmax(np.maximum(low - found, found - high))]
    if not low <= worst <= high:
        raise SceneError(f"{path}: {name} = {worst:.4g} of a link is outside the table; allowed: {low:g} to {high:g}")


def check_source(path: str, values: Values, key: str, word: str) -> None:
    """Check tables for consistency, and reject missing values and those of other sources.

    Args:
        key: the coefficient, `cdn` or `can`; its table is `table_{key}`.
    """
    source = values["coefficients"]
    takes = {key: "given", "table_kc": "table", f"table_{key}": "table", "table_re": "table"}
    for name, needed in takes.items():
        if needed != source and values[name] is not None:
            raise refuse(
                f"{path}.{name}", plain(values[name]), f"is not used by coefficients {source!r}", f"with {needed!r}"
            )
    if source == "given" and values[key] is None and key == "cdn":
        raise SceneError(f"{path}.{key}: missing; needed: {word}, >= 0")
    if source != "table":
        return
    kc = values["table_kc"]
    rows = values[f"table_{key}"]
    if kc is None or rows is None or len(kc) != len(rows) or not rises(kc, 2):
        raise SceneError(f"{path}.table_kc: needs at least 2 rising values, as many as `table_{key}`")
    reynolds = values["table_re"]
    if reynolds is not None and (len(reynolds) != 2 or not rises(reynolds)):
        raise refuse(f"{path}.table_re", reynolds, "is not a range", "two rising Reynolds numbers")
