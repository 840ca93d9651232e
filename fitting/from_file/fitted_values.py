"""What a fit to a file without a scene shows: lengths, zero, damping per mass and damping ratio, with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Table
from fitting.calibration.result import FitResult
from fitting.from_file.read_file import MeasuredFile
from fitting.laws.laws import DRAG_PATHS
from fitting.report.tables import significant


@dataclass(frozen=True)
class Value:
    """A number with its standard error and unit; `name` in words; `remark` if it is not that of one force."""

    name: str
    value: float
    std_error: float
    unit: str
    remark: str = ""


def fitted_values(result: FitResult, measured: MeasuredFile, mass: float | None) -> list[Value]:
    """The values that the file shows.

    Args:
        mass: of every link's end [kg] if the user gives it; otherwise damping is per mass.
    """
    estimates = result.estimates()
    known_mass = mass or 1.0
    is_pendulum = measured.trace.links == 1
    if is_pendulum:
        found = [_scaled("effective length", estimates["line.0.length.0"], "m")]
    else:
        found = scaled_lengths(result)
    for path, row in estimates.items():
        if path.startswith("line.0.mass."):
            number = int(path.rsplit(".", 1)[1]) + 1
            found.append(_scaled(f"mass {number} over mass 1", row, "-", 1 / known_mass))
    if "camera.offset" in estimates:
        row = estimates["camera.offset"]
        # the offset is added to angles that grow against those of the file
        found.append(Value("angle at rest", measured.zero - row["value"], row["std_error"], "rad"))
    if is_pendulum and DRAG_PATHS[0] in estimates:
        rate = np.sqrt(GRAVITY / result["line.0.length.0"])
        remark = result.laws.remark(DRAG_PATHS[0])
        found.append(_scaled("damping ratio", estimates[DRAG_PATHS[0]], "-", 0.5 / (rate * known_mass), remark))
    for path, row in estimates.items():
        if path.startswith("effects."):
            name = path.split(".", 2)[2]
            unit = row["unit"]
            if mass is None:
                unit = per_mass(unit)
                name += " / m" if is_pendulum else " / mass 1"
            found.append(_scaled(name, row, unit, remark=result.laws.remark(path)))
    return found


def _scaled(name: str, row: Table, unit: str, share: float = 1.0, remark: str = "") -> Value:
    """A part of an estimate, or all of it."""
    return Value(name, share * row["value"], share * row["std_error"], unit, remark)


def scaled_lengths(result: FitResult) -> list[Value]:
    """Lengths of several links [m]."""
    values = result.solution.by_name
    names = np.array(list(values))
    scale = values.get("rig.scale", 1.0)
    found = []
    for j, start in enumerate(np.ravel(result.scene.value("line.0.length"))):
        name = f"line.0.length.{j}"
        own = values.get(name, float(start))
        slope = np.where(names == "rig.scale", own, np.where(names == name, scale, 0.0))
        spread = np.nan
        if result.has_errors:
            spread = np.sqrt(max(slope @ result.uncertainty.covariance @ slope, 0.0))
        found.append(Value(f"length {j + 1}", scale * own, float(spread), "m"))
    return found


def per_mass(unit: str) -> str:
    """A unit of the damping of 1 kg, divided by kg."""
    return {
        "kg/s": "1/s",
        "kg/m": "1/m",
        "N m": "m^2/s^2",
        "N m s/rad": "m^2/s",
        "N m^2": "m^3/s^2",
    }.get(unit, f"{unit}/kg")


def value_rows(values: list[Value]) -> list[tuple[str, ...]]:
    """The values as rows with a heading."""
    rows = [("found", "value", "std error", "unit", "")]
    for one in values:
        digits = significant(one.value, one.std_error)
        error = f"{one.std_error:.2g}" if np.isfinite(one.std_error) else "-"
        rows.append((one.name, f"{one.value:.{digits}g}", error, one.unit, one.remark))
    return rows
