"""Scenes whose upright buoys become rigid bodies that surge, heave and pitch, as plain values."""

from __future__ import annotations

from typing import Any

#: Centre of gravity above the base [m], which the paper does not give: a homogeneous spar of its size capsizes.
CENTRE = 1.0
#: Height of the ballast above the base [m]; the hull's mass is spread over its height.
BALLAST = 0.25
#: Slices of a spar.
SLICES = 12


def pitching(table: dict[str, Any], centre: float = CENTRE) -> dict[str, Any]:
    """The scene with each `[[buoy]]` as a `[[body]]`, its line at the same place.

    Hull and ballast, `m_h H/2 + m_b z_b = m z_G`, give the moments of inertia: `m_h (H^2/12 + (H/2 - z_G)^2) +
    m_b (z_G - z_b)^2` across, `m D^2/8` about the axis.
    """
    places = {point["name"]: point["position"] for point in table["point"]}
    bodies = [_body(buoy, places[buoy["point"]], centre) for buoy in table["buoy"]]
    gone = {buoy["point"] for buoy in table["buoy"]}
    note = (
        f" The spar pitches: a rigid body with its centre of gravity {centre:g} m above the base, which the paper does "
        "not give (assumed)."
    )
    rest = {key: value for key, value in table.items() if key != "buoy"}
    points = [point for point in table["point"] if point["name"] not in gone]
    return {**rest, "description": table["description"] + note, "point": points, "body": bodies}


def _body(buoy: dict[str, Any], point: list[float], centre: float) -> dict[str, Any]:
    mass, height, diameter = buoy["mass"], buoy["height"], buoy["diameter"]
    hull = mass * (centre - BALLAST) / (0.5 * height - BALLAST)
    across = hull * (height**2 / 12.0 + (0.5 * height - centre) ** 2) + (mass - hull) * (centre - BALLAST) ** 2
    attachment = buoy.get("attachment", 0.0)
    cylinder = {
        "from": [0.0, 0.0, 0.0],
        "to": [0.0, 0.0, height],
        "diameter": diameter,
        "slices": SLICES,
        "ends": "from",
        **{key: buoy[key] for key in ("cdn", "cdt", "can", "cat") if key in buoy},
    }
    return {
        "name": buoy["name"],
        "position": [point[0], point[1], point[2] - attachment],
        "mass": mass,
        "centre_of_mass": [0.0, 0.0, centre],
        "inertia": [across, across, mass * diameter**2 / 8.0],
        "cylinders": [cylinder],
        "attachments": {buoy["point"]: [0.0, 0.0, attachment]},
    }
