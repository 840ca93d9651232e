"""Tables of wakes against measurements, from `results/farm_wakes.json`."""

from __future__ import annotations

from typing import Any

Rows = list[tuple[str, ...]]


def farm_wakes(found: dict[str, Any]) -> Rows:
    """The farm of Plew et al. (2005) over the ropes per metre, which are not stated."""
    head = ("ropes per metre of longline", "crop rope [km]", "depth [m], turbulence", "reduced within, mean / largest")
    rows = [(*head, "beneath", "Plew (2011), endless canopy", "balance")]
    for row in (*found["rows"], *found["others"]):
        rows.append(
            (
                f"{row['ropes_per_m']:g}",
                f"{row['crop_rope_km']:.0f}",
                f"{row['depth_m']:g}, {row['turbulence']:g}",
                f"{row['reduction_mean']:.0%} / {row['reduction_max']:.0%}",
                f"{row['reduction_beneath']:.0%}",
                f"{row['plew_2011']:.0%}",
                f"{row['balance']:.2f}",
            )
        )
    return rows


def cylinder_wake(found: dict[str, Any]) -> Rows:
    """One cylinder, 420 diameters behind it."""
    one = found["cylinder"]
    width, defect = one["half_width_over_d"], one["defect_over_u"]
    return [
        ("420 d behind a cylinder", "measured", "here", "difference"),
        _against("half-width over d", width["measured"], width["ours"], ".2f"),
        _against(
            "defect over U, from the measured width and C_D = 1", defect["from_measured_width"], defect["ours"], ".4f"
        ),
    ]


def _against(name: str, wanted: float, ours: float, form: str) -> tuple[str, ...]:
    return name, format(wanted, form), format(ours, form), f"{ours / wanted - 1.0:+.0%}"


TABLES = {"farm_wakes": farm_wakes, "cylinder_wake": cylinder_wake}
