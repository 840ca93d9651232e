"""Scenes derived from packaged ones: without damping, with a ramp, other starts, farms of any size, pitching spars."""

from __future__ import annotations

import re
from functools import partial

from dropper_jax.base.read import Plain, Table
from dropper_jax.base.records import column, without_keys

#: Effects that an undamped scene lacks.
DAMPING = ("linear_damping", "quadratic_damping")
#: Rate at which the force of thesis (E.1)-(E.3) rises [N/s], by release; (E.2) and (E.3) print the node of (E.1).
RAMPS = {"dropper-release-a": 0.094, "dropper-release-b": 0.065, "dropper-release-c": 0.065}
#: Start of the force [s], and releases of the node [s] by suffix. The thesis does not give the release: 15 s is that of
#: its Figure 5.3; at 14.1 s the angles of its model (Tables E.2 to E.4) are met best.
RAMP_START = 3.0
RELEASES = {"-ramp": 15.0, "-ramp-14": 14.1}
#: Centre of gravity of a pitching spar above its base [m], which the paper does not give: a homogeneous spar of its
#: size capsizes.
CENTRE_HEIGHT = 1.0


def _variant(table: Table, note: str, **sections: Plain) -> Table:
    return {**table, "description": f"{table['description']} {note}", **sections}


def _without_damping(table: Table, file: str) -> Table:
    effects = without_keys(table["effects"], DAMPING)
    return _variant(table, "Without damping.", effects=effects)


def _table_6(table: Table, file: str) -> Table:
    note = (
        "It starts from the configurations of Table 6: the buoy is held at that position until the chain settles, "
        "then released."
    )
    return _variant(table, note, start={"kind": "points"})


def _ramp(table: Table, file: str, release: float) -> Table:
    start = table["start"]
    force = start["release_force"]
    of = "the packaged release, because the thesis gives none"
    if file in RAMPS:
        force = [[0.0, 0.0, RAMPS[file] * (release - RAMP_START)]]
        of = "thesis appendix E"
    ramp = {"nodes": start["release_nodes"], "force_n": force, "start": RAMP_START, "rise": release - RAMP_START}
    return _variant(
        table,
        f"As in the thesis: starting from rest, a force rises from {RAMP_START:g} s to that of {of}, until "
        f"{release:g} s.",
        run={"accuracy": 0.01, "save_interval": 0.02, "source_dt": 0.0065, "duration": 65.0},
        effects={**table["effects"], "nodal_force": {**ramp, "release": release}},
        start={"kind": "static"},
    )


def _relative(table: Table, file: str) -> Table:
    force = {**table["effects"]["thesis_wave_force"], "velocity": "relative"}
    return _variant(
        table,
        "With the velocity relative to the nodes, thesis (6.13), which (C.22)-(C.24) omit.",
        run={**table["run"], "source_dt": 0.0025},
        effects={**table["effects"], "thesis_wave_force": force},
    )


#: Scenes derived from packaged ones: the suffix of their names, which scenes have it, and how the scene is changed.
VARIANTS = {
    "-undamped": (re.compile("dropper-release-.*"), _without_damping),
    "-ramp": (re.compile("dropper-release-[a-e]"), partial(_ramp, release=RELEASES["-ramp"])),
    "-ramp-14": (re.compile("dropper-release-[a-c]"), partial(_ramp, release=RELEASES["-ramp-14"])),
    "-relative": (re.compile("dropper-north-sea-thesis"), _relative),
    "-table-6": (re.compile("paper-case-.*"), _table_6),
    "-pitching": (re.compile("paper-case-[1-3]"), lambda table, file: pitching(table)),
}


def pitching(table: Table) -> Table:
    """The scene with each `[[buoy]]` as a `[[body]]`, with its line at the same position.

    Hull and ballast, `m_h H/2 + m_b z_b = m z_G`, give the moments of inertia:
    `m_h (H^2/12 + (H/2 - z_G)^2) + m_b (z_G - z_b)^2` across, `m D^2/8` about the axis.
    """
    positions = {point["name"]: point["position"] for point in table["point"]}
    bodies = [_body(buoy, positions[buoy["point"]]) for buoy in table["buoy"]]
    replaced = set(column(table["buoy"], "point"))  # by attachments of the bodies
    note = (
        f"The spar pitches: a rigid body with its centre of gravity {CENTRE_HEIGHT:g} m above the base, which the "
        "paper does not give (assumed)."
    )
    rest = without_keys(table, ("buoy",))
    points = [point for point in table["point"] if point["name"] not in replaced]
    return _variant(rest, note, point=points, body=bodies)


def _body(buoy: Table, point: list[float]) -> Table:
    ballast = 0.25  # height of the ballast above the base [m]; the hull's mass is spread over its height
    mass = buoy["mass"]
    height = buoy["height"]
    diameter = buoy["diameter"]
    hull = mass * (CENTRE_HEIGHT - ballast) / (0.5 * height - ballast)
    across = (
        hull * (height**2 / 12.0 + (0.5 * height - CENTRE_HEIGHT) ** 2) + (mass - hull) * (CENTRE_HEIGHT - ballast) ** 2
    )
    attachment = buoy.get("attachment", 0.0)
    cylinder = {
        "from": [0.0, 0.0, 0.0],
        "to": [0.0, 0.0, height],
        "diameter": diameter,
        "slices": 12,
        "ends": "from",
    }
    for key in ("cdn", "cdt", "can", "cat"):
        if key in buoy:
            cylinder[key] = buoy[key]
    return {
        "name": buoy["name"],
        "position": [point[0], point[1], point[2] - attachment],
        "mass": mass,
        "centre_of_mass": [0.0, 0.0, CENTRE_HEIGHT],
        "inertia": [across, across, mass * diameter**2 / 8.0],
        "cylinders": [cylinder],
        "attachments": {buoy["point"]: [0.0, 0.0, attachment]},
    }
