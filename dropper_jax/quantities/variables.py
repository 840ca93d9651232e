"""The arrays of a solution: their names in files, dimensions, units and meaning."""

from __future__ import annotations

from typing import NamedTuple


class Variable(NamedTuple):
    """Name in a dataset, dimensions, unit and meaning of an array."""

    name: str
    dimensions: tuple[str, ...]
    unit: str
    meaning: str


BODY_AXES = ("time", "body", "axis")
#: Arrays of all runs at their times `t`, which is the coordinate of files.
OF_ALL = {
    "positions": Variable("position", ("time", "node", "axis"), "m", "position of the nodes"),
    "velocities": Variable("velocity", ("time", "node", "axis"), "m s-1", "velocity of the nodes"),
    "tension": Variable("tension", ("time", "link"), "N", "tension of the links"),
    "t_tension": Variable("tension_time", ("time",), "s", "time to which the tension belongs"),
    "kinetic": Variable("kinetic_energy", ("time",), "J", "kinetic energy"),
    "potential": Variable("potential_energy", ("time",), "J", "potential energy"),
    "work": Variable("work", ("time", "contribution"), "J", "work done since the start"),
    "step_status": Variable("step_status", ("time",), "1", "0 where every step up to this time is good"),
}
ARRAYS = ("t", *OF_ALL)
#: Arrays of runs with rigid bodies.
BODIES = {
    "body_position": Variable("body_position", BODY_AXES, "m", "position of the bodies' reference points"),
    "body_attitude": Variable("body_attitude", BODY_AXES, "rad", "roll, pitch and yaw of the bodies: about x, y and z"),
    "body_velocity": Variable("body_velocity", BODY_AXES, "m s-1", "velocity of the bodies' reference points"),
    "body_rates": Variable("body_angular_velocity", BODY_AXES, "rad s-1", "angular velocity of the bodies"),
}
#: Signals whose extremes over all steps a run keeps, in this order: their dimensions and names; the arrays of each.
STEP_SIGNALS = {
    "tension": (("time", "link"), "tension"),
    "end_force": (("time", "line", "end"), "force of a line on its end point"),
    "point_load": (("time", "held_point", "load"), "load of a fixed point"),
}
EXTREMES = {
    "min": ("N", "minimum {} over the steps since the last time"),
    "max": ("N", "maximum {} over the steps since the last time"),
    "min_time": ("s", "time of the minimum {}"),
    "max_time": ("s", "time of the maximum {}"),
}
#: Arrays of runs that save fewer states than they take steps; mean squares only with an accuracy.
WITHIN = {
    f"{signal}_{key}": Variable(f"{signal}_{key}", dimensions, unit, meaning.format(words))
    for signal, (dimensions, words) in STEP_SIGNALS.items()
    for key, (unit, meaning) in EXTREMES.items()
}
STEP_EXTREMES = tuple(WITHIN)
WITHIN["tension_square"] = Variable(
    "tension_square", ("time", "link"), "N2", "mean square of the tension since the last time"
)
#: Arrays that some runs do not have, and all.
SOME = WITHIN | BODIES
VARIABLES = OF_ALL | SOME
#: Quantities derived from the arrays, for convenience; None of a run that has none.
DERIVED = {
    "polar": Variable(
        "polar_angle", ("time", "link"), "rad", "angle of the links from the horizontal, positive downwards"
    ),
    "azimuth": Variable("azimuth", ("time", "link"), "rad", "azimuth of the links"),
    "curvature": Variable("curvature", ("time", "node"), "m-1", "curvature of the lines"),
    "bending_moment": Variable("bending_moment", ("time", "node"), "N m", "bending moment of the lines"),
    "twist": Variable("twist", ("time", "node"), "rad", "twist of the lines"),
    "torque": Variable("torque", ("time", "link"), "N m", "torque of the links"),
}
