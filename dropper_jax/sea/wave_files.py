"""Readers of component tables, measured elevations and directional spectra, as values of `[sea.waves]`."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table

#: Components below this fraction of the largest amplitude (of a series) or energy (of a spectrum) are left out.
SMALLEST = 1e-9
#: Columns of components in addition to that of their periods or frequencies, and their names in a scene.
VALUES = {"amplitude_m": "amplitude", "phase_rad": "phase", "direction_rad": "direction"}
COLUMNS = "period_s or frequency_hz, amplitude_m, phase_rad and, optionally, direction_rad"


def read_components(file: str | Path, path: str = "file") -> Table:
    """Components from a CSV with a header; periods are preferred to frequencies, since they are rounded less.

    Raises:
        SceneError: missing file, wrong columns, a cell that is not a number, or a period that is not positive.
    """
    names, rows = _read_csv(file, path)
    key = "period_s" if "period_s" in names else "frequency_hz"
    if set(names) - {"period_s", "frequency_hz", *VALUES} or not {"amplitude_m", key} <= set(names):
        raise SceneError(f"{path}: {str(file)!r} has the columns {', '.join(names)}; allowed: {COLUMNS}")
    column = dict(zip(names, rows.T, strict=True))
    given = column[key]
    if np.any(given <= 0):
        worst = np.argmin(given)
        raise SceneError(f"{path}: {key} of component {worst + 1} is {given[worst]:g}; allowed: > 0")
    found = {"phase": np.zeros(len(rows)), "period": given}
    if key == "frequency_hz":
        found["period"] = 1.0 / given
    elif "frequency_hz" in column:
        _check_frequencies(given, column["frequency_hz"], f"{path}: {str(file)!r}")
    for name in column.keys() & VALUES.keys():
        found[VALUES[name]] = column[name]
    return found


def _check_frequencies(period: np.ndarray, frequency: np.ndarray, label: str) -> None:
    """Reject periods [s] and frequencies [Hz] of the same components that differ by more than their rounding."""
    rounding = 0.1  # of frequencies with two decimals, which tables of components have
    wrong = np.flatnonzero(np.abs(period * frequency - 1.0) > rounding)
    if wrong.size:
        worst = int(wrong[0])
        raise SceneError(
            f"{label} component {worst + 1}: frequency_hz {frequency[worst]:g} is not 1/period_s, "
            f"{1.0 / period[worst]:.4g} Hz. Leave one of the columns out"
        )


def read_elevation(file: str | Path, path: str = "file") -> Table:
    """Fourier series of an elevation measured at x = y = 0, evenly sampled, columns t_s and elevation_m.

    The mean is left out. The series repeats after its length; between the samples it is band-limited.
    """
    names, rows = _read_csv(file, path)
    if names != ["t_s", "elevation_m"]:
        raise SceneError(f"{path}: {str(file)!r} has the columns {', '.join(names)}; allowed: t_s, elevation_m")
    t, eta = rows.T
    step = np.diff(t)
    if len(t) < 4 or np.any(step <= 0) or np.ptp(step) > 1e-3 * np.mean(step):
        raise SceneError(f"{path}: {str(file)!r} is not evenly sampled over at least 4 times; allowed: a constant step")
    if np.ptp(eta) == 0.0:
        raise SceneError(f"{path}: {str(file)!r} has one elevation at all times; allowed: an elevation that changes")
    return elevation_components(t, eta)


def elevation_components(t: np.ndarray, eta: np.ndarray) -> Table:
    """Amplitudes, periods and phases (`a cos(p - w t)`) of an evenly sampled elevation (k,) [m] at times (k,) [s]."""
    count = len(t)
    step = (t[-1] - t[0]) / (count - 1)
    line = np.fft.rfft(eta)[1:]
    frequency = np.fft.rfftfreq(count, step)[1:]
    amplitude = 2.0 * np.abs(line) / count
    if count % 2 == 0:
        amplitude[-1] *= 0.5
    phase = -np.angle(line) + 2 * np.pi * frequency * t[0]
    counts = amplitude > SMALLEST * amplitude.max()
    return {
        "amplitude": amplitude[counts],
        "period": 1.0 / frequency[counts],
        "phase": np.mod(phase[counts], 2 * np.pi),
    }


def from_wavespectra(dataset: Any, seed: int = 0) -> Table:
    """`[sea.waves]` of a wavespectra-style dataset: `efth` [m^2/Hz/degree] over `freq` [Hz] and `dir` [degree].

    `dir` is where waves come from, clockwise from north (their convention); here +x is east and +y north. One component
    per bin, phases from the seed. Only the dataset itself needs xarray (extra `io`). Select one time and site first.

    Raises:
        SceneError: a variable is missing, other dimensions, directions of several spacings, or densities without waves.
    """
    for name in ("efth", "freq", "dir"):
        if name not in dataset:
            raise SceneError(f"dataset: has no {name!r}; allowed: a wavespectra dataset with efth, freq and dir")
    density = dataset["efth"].squeeze()
    if set(density.dims) != {"freq", "dir"}:
        raise SceneError(
            f"dataset.efth: has the dimensions {density.dims}; allowed: freq and dir, several of each, of one time"
        )
    frequency = np.asarray(dataset["freq"], float)
    coming = np.asarray(dataset["dir"], float)
    spacings = np.diff(frequency)
    if not (np.all(frequency >= 0.0) and (np.all(spacings > 0.0) or np.all(spacings < 0.0))):
        raise SceneError("dataset.freq: allowed: frequencies of at least 0 Hz, all rising or all falling")
    spacing = _direction_spacing(coming)
    energy = np.asarray(density.transpose("freq", "dir"), float) * np.abs(np.gradient(frequency))[:, None] * spacing
    counts = energy > SMALLEST * energy.max()
    possible = np.all(np.isfinite(energy)) and np.all(energy >= 0.0) and np.any(counts)
    if not possible or np.any(counts[frequency == 0.0]):
        raise SceneError("dataset.efth: needs finite densities of at least 0, one at least above 0, none at 0 Hz")
    return {
        "kind": "components",
        "amplitude": np.sqrt(2.0 * energy[counts]),
        "period": 1.0 / np.broadcast_to(frequency[:, None], energy.shape)[counts],
        "direction": np.broadcast_to(np.deg2rad(np.mod(270.0 - coming, 360.0)), energy.shape)[counts],
        "phase": np.random.default_rng(seed).uniform(0.0, 2 * np.pi, int(counts.sum())),
    }


def _direction_spacing(coming: np.ndarray) -> float:
    """The one spacing of directions (d,) [degree], which need not go all round: the widest gap is left out."""
    turns = np.sort(np.mod(coming, 360.0))
    gaps = np.sort(np.diff(turns, append=turns[0] + 360.0))
    if not (gaps[0] > 0.0 and np.allclose(gaps[:-1], gaps[0], rtol=1e-2)):
        raise SceneError("dataset.dir: allowed: directions of one spacing, each once (0 and 360 degrees are the same)")
    return float(gaps[0])


def _read_csv(file: str | Path, path: str) -> tuple[list[str], np.ndarray]:
    """Names of the columns, and rows of finite numbers."""
    try:
        with open(file, newline="", encoding="utf-8-sig") as opened:
            # comments become empty lines, so that the reader counts the lines of the file
            reader = csv.reader(("" if line.startswith("#") else line for line in opened), strict=True)
            lines = [(reader.line_num, cells) for cells in reader if cells]
    except (OSError, csv.Error, ValueError) as error:
        raise SceneError(f"{path}: cannot read {str(file)!r}: {getattr(error, 'strerror', None) or error}") from None
    if len(lines) < 2:
        raise SceneError(f"{path}: {str(file)!r} has no rows; allowed: a header and one row per component or time")
    names = [name.strip() for name in lines[0][1]]
    if len(set(names)) < len(names):
        raise SceneError(f"{path}: {str(file)!r} has the columns {', '.join(names)}; allowed: every column once")
    rows = []
    for number, line in lines[1:]:
        try:
            rows.append(list(map(float, line)))
        except ValueError:
            raise SceneError(f"{path}: {str(file)!r} line {number}: {','.join(line)!r} is not all numbers") from None
        if len(line) != len(names) or not np.all(np.isfinite(rows[-1])):
            raise SceneError(f"{path}: {str(file)!r} line {number}: needs {len(names)} finite numbers, as the header")
    return names, np.array(rows)
