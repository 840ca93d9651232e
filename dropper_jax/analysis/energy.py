"""Energy balance of a run: drift, power of each contribution, and a table."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dropper_jax.base.read import Table


class Energies(Protocol):
    """Attributes of a solution: kinetic, potential (k,) [J]; work (k, w) [J] since the start, named by `work_names`."""

    kinetic: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    work_names: tuple[str, ...]


def balance_drift(solution: Energies) -> np.ndarray:
    """`E(t) - E(0) - sum of the work done since`, (k,) [J]: zero for an exact solution.

    Work includes energy taken out (damping, friction) and put in (applied forces, moving ends).
    """
    with np.errstate(invalid="ignore"):  # a failed run may contain infinities
        total = np.asarray(solution.kinetic) + np.asarray(solution.potential)
        work = _work(solution).sum(axis=1)
        return (total - total[0]) - (work - work[0])


def effect_power(solution: Energies, t: np.ndarray) -> dict[str, np.ndarray]:
    """Mean power of each contribution between saved times, {name: (k - 1,)} [W]: `(W_i+1 - W_i)/(t_i+1 - t_i)`.

    Exact as a mean, because the work is summed step by step along with the motion.
    """
    power = np.diff(_work(solution), axis=0) / np.diff(np.asarray(t))[:, None]
    return dict(zip(solution.work_names, power.T, strict=True))


def energy_table(solution: Energies) -> Table:
    """Energies at both ends of a run, work by contribution, and how well the balance closes.

    Returns:
        `initial` and `final`, each {kinetic, potential, total} [J]; `work` {name: J}, over the whole run; `scale` [J],
        the larger of the greatest kinetic energy and the range of the potential; `drift` {final, largest} [J] and
        `relative_drift`, the largest over the scale (0 where nothing moves).
    """
    kinetic = np.asarray(solution.kinetic)
    potential = np.asarray(solution.potential)
    work = _work(solution)
    drift = balance_drift(solution)
    with np.errstate(invalid="ignore"):
        scale = float(max(kinetic.max(), np.ptp(potential)))
    max_drift = float(np.abs(drift).max())
    relative = 0.0
    if scale != 0.0:
        relative = max_drift / scale
    return {
        "initial": _instant(kinetic[0], potential[0]),
        "final": _instant(kinetic[-1], potential[-1]),
        "work": dict(zip(solution.work_names, (work[-1] - work[0]).tolist(), strict=True)),
        "scale": scale,
        "drift": {"final": float(drift[-1]), "largest": max_drift},
        "relative_drift": relative,
    }


def _work(solution: Energies) -> np.ndarray:
    return np.asarray(solution.work).reshape(len(solution.kinetic), -1)


def _instant(kinetic: float, potential: float) -> dict[str, float]:
    # Python floats, unlike NumPy scalars, do not warn about infinities of a failed run
    kinetic = float(kinetic)
    potential = float(potential)
    return {"kinetic": kinetic, "potential": potential, "total": kinetic + potential}
