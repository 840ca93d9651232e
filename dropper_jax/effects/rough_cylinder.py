"""Drag and added mass of rough cylinders over Keulegan-Carpenter number and roughness.

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

#: Reynolds number above which cylinders as rough as mussel ropes are assumed to be post-critical.
POST_CRITICAL = 1e5
#: KC over C_DS [-] from which psi is 1: the wake no longer amplifies the drag.
NO_AMPLIFICATION_KC = 60.0
#: Fraction [-] of the current in current and wave from which psi is 1: a current of 0.4 of the wave velocity.
WAKE_CARRIED_AWAY = 0.4 / 1.4
#: Relative roughness k/D [-] below which a cylinder counts as smooth, and above which as fully rough.
SMOOTH = 1e-4
FULLY_ROUGH = 1e-2


def steady_drag(roughness: np.ndarray) -> np.ndarray:
    """C_DS at relative roughnesses k/D (...)."""
    k = np.maximum(roughness, 1e-12)  # a positive argument of the logarithm
    between = (29.0 + 4.0 * np.log10(k)) / 20.0
    return np.select([k < SMOOTH, k > FULLY_ROUGH], [0.65, 1.05], between)


def amplification(kc: np.ndarray, steady: np.ndarray) -> np.ndarray:
    """psi at KC (...) for C_DS (...); 1 where KC is infinite (no waves)."""
    top = 1.50 - 0.024 * (12.0 / steady - 10.0)
    finite = np.where(np.isfinite(kc), kc, NO_AMPLIFICATION_KC * steady)
    high = top + (1.0 - top) * np.clip((finite - 12.0) / (NO_AMPLIFICATION_KC * steady - 12.0), 0.0, 1.0)
    conditions = [finite >= 12.0, finite >= 2.0, finite >= 0.75]
    values = [high, top + 0.10 * (finite - 12.0), top - 1.0]
    return np.select(conditions, values, top - 1.0 - 2.0 * (finite - 0.75))


def rough_drag(kc: np.ndarray, roughness: np.ndarray, current: np.ndarray) -> np.ndarray:
    """C_D at KC (...), k/D (...) and the fraction of the current in current and wave (...)."""
    steady = steady_drag(roughness)
    return steady * np.where(current > WAKE_CARRIED_AWAY, 1.0, amplification(kc, steady))


def rough_added_mass(kc: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """C_A at KC (...) and k/D (...); 1 without waves."""
    steady = steady_drag(roughness)
    finite = np.where(np.isfinite(kc), kc, 0.0)
    return np.where(finite < 3.0, 1.0, np.maximum(1.0 - 0.044 * (finite - 3.0), 0.6 - (steady - 0.65)))
