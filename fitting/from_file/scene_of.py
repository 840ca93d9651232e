"""A scene for a measured file: a chain of point masses, or one pendulum of its effective length, and what is free.

A pivot that the points of a film do not show is off, which turns the first link by an amount that depends on its angle:
like a marker at the pivot that is out of place (`marker.node.0`).

One link of any shape, with inertia I about its pivot, mass m and centre of mass at a, swings as a point mass at its
effective length L = I/(m a). Its angle shows L, b/m and b_q/m, but no mass: that of the scene is then 1 kg.
"""

from __future__ import annotations

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Table
from fitting.from_file.read_file import FileOptions, MeasuredFile
from fitting.traces.planar import pendulum_period

#: Drag at the start of the fit of several links, per mass [1/s], [1/m].
START_DRAG = 0.02
#: Standard error of a length from points relative to the first one [%], and of a pivot that is found: a lens distorts
#: by as much.
LENGTH_ERROR = 0.2


def propose_scene(measured: MeasuredFile, given: FileOptions) -> Table:
    """Plain values of a scene with its `[fit]`."""
    count = measured.trace.links
    mass = 1.0
    if given.mass is not None:
        mass = given.mass
    if measured.swing is not None:
        lengths = np.array([GRAVITY / measured.swing.stiffness])
        linear = 0.5 * measured.swing.damping * mass
        quadratic = linear / max(measured.swing.rate * lengths[0], 1e-6)
        free = ["line.0.length", "b_l", "b_q", "camera.offset"]
        priors = []
    else:
        lengths = np.array(measured.lengths)
        linear = START_DRAG * mass
        quadratic = linear
        free = [f"line.0.mass.{j}" for j in range(1, count)]
        free += ["b_l", "b_q", "rig.scale", "camera.offset"]
        free += [f"line.0.length.{j}" for j in range(1, count)]
        known = count - 1 if measured.open_end else count
        priors = [{"of": f"line.0.length.{j}", "sigma": LENGTH_ERROR, "unit": "%"} for j in range(1, known)]
    if measured.pivot_error is not None:
        free.append("marker.node.0")
        error = np.hypot(measured.pivot_error, LENGTH_ERROR / 100) * lengths[0]
        priors += [
            {"of": f"marker.node.0.{axis}", "sigma": float(size), "unit": "m"} for axis, size in enumerate(error)
        ]
    fit: Table = {"free": free}
    if priors:
        fit["prior"] = priors
    start = measured.trace.at(measured.trace.t[:1])[0]
    return {
        "description": f"Proposed by `dropper fit` for {measured.trace.name}.",
        "run": {"dt": float(np.round(pendulum_period(lengths) / 200, 6)), "duration": 10.0},
        "point": [
            {"name": "pivot", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [0.0, 0.0, -float(np.sum(lengths))]},
        ],
        "line": [
            {
                "name": "chain",
                "from": "pivot",
                "to": "end",
                "links": count,
                "length": lengths.tolist(),
                "mass": [mass] * count,
            }
        ],
        "effects": {
            "weight": {},
            "linear_damping": {"b_l": float(linear)},
            "quadratic_damping": {"b_q": float(quadratic)},
        },
        "start": {"kind": "angles", "zero": "down", "polar": start.tolist()},
        "fit": fit,
    }
