"""Wave and current files in the folder of a deck, read as `[sea.waves]` and `[sea.current]`, and their names.

MoorDyn's components are `eta = sum A sin(w t - k . x + e)`, with `A exp(i e)` given by real and imaginary part.
Those here are `a cos(k . x - w t + p)`, so `p = pi/2 - e`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import read_lines
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.sea.wave_files import elevation_components

FREQUENCIES = "wave_frequencies.txt"
ELEVATION = "wave_elevation.txt"
CURRENT = "current_profile.txt"


def read_waves(folder: Path, kind: int, step: float, notes: list[str]) -> Table:
    """`[sea.waves]` of WaveKin 2, 3 or 7.

    Args:
        folder: folder of the file.
        kind: MoorDyn's WaveKin.
        step: dtWave [s], to which an elevation series is resampled first, as in MoorDyn.
        notes: list to which the number of omitted components of a series is added.

    Raises:
        SceneError: a missing file or a line that is not a row of numbers.
    """
    if kind == 3:
        found = _largest(_elevation_series(folder / ELEVATION, step), notes)
        return {"kind": "components", "direction": 0.0, **{key: value.tolist() for key, value in found.items()}}
    rows = [row for row in _rows(folder / FREQUENCIES, 3, 0) if row[0] > 0.0 and (row[1] or row[2])]
    if not rows:
        raise SceneError(f"{folder / FREQUENCIES}: holds no component above 0 rad/s")
    omega, real, imaginary = np.array([row[:3] for row in rows]).T
    found = {
        "amplitude": _short(np.hypot(real, imaginary)),
        "period": _short(2 * np.pi / omega),
        "phase": _short(np.mod(0.5 * np.pi - np.arctan2(imaginary, real), 2 * np.pi)),
    }
    courses = [[*row, 0.0][3] for row in rows]  # 0 where a row has no direction
    if len(rows) == 1:
        return {"kind": "regular", "direction": courses[0], **{key: value[0] for key, value in found.items()}}
    direction = courses
    if len(set(courses)) <= 1:
        direction = courses[0]
    return {"kind": "components", "direction": direction, **found}


def _elevation_series(path: Path, step: float) -> dict[str, np.ndarray]:
    """Components of an elevation series, resampled to a step [s]."""
    t, eta = np.array([row[:2] for row in _rows(path, 2, 0)]).T
    if not step > 0.0:
        raise SceneError(f"dtWave: {step:g} is out of range; allowed: > 0 s")
    if np.any(np.diff(t) <= 0.0):
        raise SceneError(f"{path}: the times do not rise; allowed: rows of time and elevation in rising order")
    even = np.arange(t[0], t[-1] + 1e-9 * step, step)
    if len(even) < 4:
        raise SceneError(f"{path}: has {len(even)} times dtWave = {step:g} s apart; allowed: at least 4")
    eta = np.interp(even, t, eta)
    if np.ptp(eta) == 0.0:
        raise SceneError(f"{path}: the elevation is constant; allowed: waves, or WaveKin 0")
    return elevation_components(even, eta)


def read_current(folder: Path) -> Table:
    """`[sea.current]` of Currents 1: a steady profile over height."""
    rows = sorted(_rows(folder / CURRENT, 4, 3))
    if len(rows) == 1:
        rows = [[rows[0][0] - 1.0, *rows[0][1:]], rows[0]]
    return {"kind": "table", "heights": column(rows, 0), "velocities": [row[1:4] for row in rows]}


def _largest(found: dict[str, np.ndarray], notes: list[str]) -> dict[str, np.ndarray]:
    """The components without the smallest ones, which together have at most 0.01 % of the variance."""
    # fraction of the variance of an elevation series that its omitted smallest components may have together. A series
    # of whole periods has one component, a series half a sample longer has hundreds. Each costs time at every node in
    # every step
    omitted_variance = 1e-4
    order = np.argsort(found["amplitude"])
    below = np.cumsum(found["amplitude"][order] ** 2) <= omitted_variance * np.sum(found["amplitude"] ** 2)
    if below.any():
        left = int(below.sum())
        several = len(order)
        notes.append(
            f"{ELEVATION}: {left} of {several} components are omitted, {omitted_variance:.2%} of the variance or less"
        )
    return {key: values[np.sort(order[~below])] for key, values in found.items()}


def _short(values: np.ndarray) -> list[float]:
    """Numbers without the rounding of the last digits, so that written values are read back exactly."""
    # 12 digits survive the conversion to real and imaginary part and back
    return [float(f"{x:.12g}") for x in values]


def _rows(path: Path, least: int, skip: int) -> list[list[float]]:
    """Rows of numbers after the first `skip` lines."""
    found = []
    for at, line in enumerate(read_lines(path), start=1):
        if at <= skip or not line.strip():
            continue
        try:
            row = list(map(float, line.split()))
        except ValueError:
            raise SceneError(f"{path}:{at}: {line.strip()!r} is not all numbers") from None
        if len(row) < least or not np.all(np.isfinite(row)):
            raise SceneError(f"{path}:{at}: needs at least {least} finite numbers")
        found.append(row)
    if not found:
        raise SceneError(f"{path}: has no rows of numbers")
    return found
