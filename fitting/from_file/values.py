"""What a fit to a file without a scene shows: lengths, zero, damping per mass and damping ratio, with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dropper_jax.base.constants import GRAVITY
from fitting.calibration.laws import DRAG
from fitting.calibration.result import FitResult
from fitting.from_file.read_file import Measured
from fitting.report.tables import significant


@dataclass(frozen=True)
class Value:
    """A number with its standard error and unit; `name` in words; `remark` if it is not that of one force."""

    name: str
    value: float
    std_error: float
    unit: str
    remark: str = ""


def found_values(result: FitResult, measured: Measured, mass: float | None) -> list[Value]:
    """The values that the file shows.

    Args:
        mass: of every link's end [kg] if the user gives it; otherwise damping is per mass.
    """
    estimates = result.estimates()
    value = {name: row["value"] for name, row in estimates.items()}
    error = {name: row["std_error"] for name, row in estimates.items()}
    found = []
    one = measured.trace.links == 1
    length = "line.0.length.0"
    if one:
        found.append(Value("effective length", value[length], error[length], "m"))
    else:
        found += scaled_lengths(result, value)
    for name in value:
        if name.startswith("line.0.mass."):
            j = int(name.rsplit(".", 1)[1])
            known = mass or 1.0
            found.append(Value(f"mass {j + 1} over mass 1", value[name] / known, error[name] / known, "-"))
    if "camera.offset" in value:
        # the offset is added to angles that grow against those of the file
        zero = measured.zero - value["camera.offset"]
        found.append(Value("angle at rest", zero, error["camera.offset"], "rad"))
    if one and DRAG[0] in value:
        rate = np.sqrt(GRAVITY / value[length])
        share = 0.5 / (rate * (mass or 1.0))
        remark = result.laws.remark(DRAG[0])
        found.append(Value("damping ratio", share * value[DRAG[0]], share * error[DRAG[0]], "-", remark))
    for name in value:
        if name.startswith("effects."):
            unit = estimates[name]["unit"]
            if "joint_friction" not in name:
                short = name.rsplit(".", 1)[1]
            else:
                short = name.split(".", 2)[2]
            if mass is None:
                what = "m" if one else "mass 1"
                short = f"{short} / {what}"
                unit = per_mass(unit)
            found.append(Value(short, value[name], error[name], unit, result.laws.remark(name)))
    return found


def scaled_lengths(result: FitResult, value: dict[str, float]) -> list[Value]:
    """Lengths of several links [m]."""
    scene = result.scene
    names = list(value)
    covariance = result.uncertainty.covariance
    scale = value.get("rig.scale", 1.0)
    found = []
    for j, start in enumerate(np.ravel(scene.value("line.0.length"))):
        name = f"line.0.length.{j}"
        own = value.get(name, float(start))
        slope = np.array([own if one == "rig.scale" else scale if one == name else 0.0 for one in names])
        if result.has_errors:
            spread = np.sqrt(max(float(slope @ covariance @ slope), 0.0))
        else:
            spread = np.nan
        found.append(Value(f"length {j + 1}", scale * own, float(spread), "m"))
    return found


def per_mass(unit: str) -> str:
    """A unit of the damping of 1 kg, divided by kg."""
    return {
        "kg/s": "1/s",
        "kg/m": "1/m",
        "N m": "m^2/s^2",
        "N m s/rad": "m^2/s",
        "N m^2": "m^4/s^2",
    }.get(unit, f"{unit}/kg")


def value_rows(values: list[Value]) -> list[tuple[str, ...]]:
    """The values as rows with a heading."""
    rows = [("found", "value", "std error", "unit", "")]
    for one in values:
        digits = significant(one.value, one.std_error)
        shown = "-"
        if np.isfinite(one.std_error):
            shown = f"{one.std_error:.2g}"
        rows.append((one.name, f"{one.value:.{digits}g}", shown, one.unit, one.remark))
    return rows
