"""Farms: a backbone between two anchored spar buoys with looped droppers, as plain scene values."""

from __future__ import annotations

import re
from typing import Any

from dropper_jax.base.errors import SceneError

NAME = re.compile(r"dropper-farm(?:-(\d+))?")
#: Droppers of the scene that is listed as `dropper-farm`.
USUAL = 8
MOST = 200
#: Distance along the backbone from one dropper's first end to the next one's [m], and what each dropper spans.
BAY, SPAN = 3.0, 2.5


def is_farm(name: str) -> bool:
    """Whether a scene name is that of a farm, `dropper-farm` or `dropper-farm-K`."""
    return NAME.fullmatch(name) is not None


def farm_table(name: str) -> dict[str, Any]:
    """Plain values of `dropper-farm-K`.

    Raises:
        SceneError: K out of range.
    """
    digits = NAME.fullmatch(name).group(1)
    droppers = USUAL if digits is None else int(digits)
    if not 1 <= droppers <= MOST:
        raise SceneError(f"scene: {name!r} has {droppers} droppers; allowed: dropper-farm-1 to dropper-farm-{MOST}")
    return farm(droppers)


def farm(
    droppers: int,
    *,
    shelter: float = 0.85,
    least_shelter: float = 0.4,
    links: int = 18,
    speed: float = 0.8,
    float_volume: float = 0.20,
) -> dict[str, Any]:
    """Plain values of a farm in 30 m of water with the current along it.

    The droppers are the thesis' (17 m of 20 kg per 0.94 m, Table 8.5; 0.15 m thick), each looped over 2.5 m of a
    backbone that ends at the bases of the spar buoys, with a float at each of its ends. Assumed, not from the sources:
    backbone and chain as in `edulis-longline`, floats of 0.2 m3, which carry more than the droppers weigh in water
    (0.5 kN each) and hold the backbone at the surface (points begin at 5 m for the statics), and a shelter factor on
    the current that falls by 0.85 from dropper to dropper in the direction of the current down to 0.4 (Plew et al.
    measured reductions of this size through farms).

    Args:
        droppers: their number.
        shelter, least_shelter: factor on the current from one dropper to the next, and its lower limit.
        links: per dropper.
        speed: of the current at the surface [m/s], power law 1/7.
        float_volume: of each float [m^3].
    """
    length = BAY * droppers + 1.0
    depth, backbone_depth = 30.0, 5.0
    points = [
        {"name": "west-anchor", "position": [-60.0, 0.0, -depth]},
        {"name": "east-anchor", "position": [length + 60.0, 0.0, -depth]},
        {"name": "west-buoy", "kind": "free", "position": [0.0, 0.0, -backbone_depth]},
        {"name": "east-buoy", "kind": "free", "position": [length, 0.0, -backbone_depth]},
    ]
    attach, socks = [], []
    for i in range(droppers):
        first = 0.5 + BAY * i + 0.25
        for side, at in (("a", first), ("b", first + SPAN)):
            name = f"{side}{i + 1}"
            attach.append({"point": name, "at": at})
            points.append(
                {"name": name, "kind": "free", "position": [at, 0.0, -backbone_depth], **_float(float_volume)}
            )
        ends = {"name": f"dropper-{i + 1}", "from": f"a{i + 1}", "to": f"b{i + 1}"}
        socks.append({**ends, "shelter": max(least_shelter, shelter**i), **_section("sock", 17.0, links)})
    return {
        "name": f"dropper-farm-{droppers}",
        "description": f"A backbone with {droppers} looped droppers between two anchored spar buoys, in a current.",
        "run": {"dt": 0.03, "duration": 60.0},
        "line_type": TYPES,
        "point": points,
        "line": [
            {"name": "west-leg", "from": "west-anchor", "to": "west-buoy", **_section("chain", 68.0, 17)},
            {"name": "east-leg", "from": "east-anchor", "to": "east-buoy", **_section("chain", 68.0, 17)},
            {
                "name": "backbone",
                "from": "west-buoy",
                "to": "east-buoy",
                "attach": attach,
                **_section("backbone", length, 2 * droppers + 1),
            },
            *socks,
        ],
        "buoy": [{"name": name, "point": name, **SPAR} for name in ("west-buoy", "east-buoy")],
        "sea": {"depth": depth, "current": {"kind": "power", "speed": speed}},
        "effects": {
            "weight": {},
            "buoyancy": {},
            "morison_drag": {},
            "morison_inertia": {},
            "seabed": {},
        },
    }


def _section(kind: str, length: float, links: int) -> dict[str, Any]:
    return {"type": kind, "length": length, "links": links}


def _float(volume: float) -> dict[str, float]:
    """A foam float of 80 kg per cubic metre, drag coefficient 0.5 on its frontal area."""
    frontal = 3.14159 / 4.0 * (6.0 * volume / 3.14159) ** (2.0 / 3.0)
    return {"mass": 80.0 * volume, "volume": volume, "drag_area": 0.5 * frontal, "added_mass": 0.5}


WATER = {"cdn": 1.4, "cdt": 0.02, "can": 1.0, "cat": 0.0}
TYPES = [
    {"name": "chain", "mass": 10.91, "diameter": 0.042, "EA": 48.884e6, "damping_ratio": 0.1, **WATER, "cdt": 0.2},
    {"name": "backbone", "mass": 2.1, "diameter": 0.053053, "EA": 2.0e6, "damping_ratio": 0.1, **WATER, "cdn": 1.2},
    {"name": "sock", "mass": 21.176, "diameter": 0.15, "EA": 4.0e5, "damping_ratio": 0.1, **WATER},
]
SPAR = {
    "mass": 2500.0,
    "diameter": 0.79,
    "height": 8.865,
    "cdn": 0.81,
    "cdt": 0.40,
    "can": 0.94,
    "cat": 0.50,
}
