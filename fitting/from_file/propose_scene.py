"""A scene for a measured file: a chain of point masses, or one pendulum of its effective length, and what is free.

A pivot that the points of a film do not show is off, which turns the first link by an amount that depends on its angle:
like a marker at the pivot that is out of place (`marker.node.0`).

One link of any shape, with inertia I about its pivot, mass m and centre of mass at a, swings as a point mass at its
effective length L = I/(m a). Its angle shows L, b/m and b_q/m, but no mass: that of the scene is then 1 kg.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Table
from fitting.from_file.read_file import FileOptions, MeasuredFile
from fitting.from_file.swing import Swing
from fitting.traces.planar import pendulum_period

#: Drag at the start of the fit of several links, per mass [1/s], [1/m].
START_DRAG = 0.02
#: Standard error of a length from points relative to the first one [%], and of a pivot that is found: a lens distorts
#: by as much.
LENGTH_ERROR = 0.2
#: Steps of time per period of the shortest link, in a run of the scene.
STEPS_PER_PERIOD = 200
#: Minimum typical speed of the end [m/s], by which linear drag is divided for the start value of quadratic drag.
SLOWEST = 1e-6


class Proposal(NamedTuple):
    """What depends on the number of links: lengths (n,) [m], start values of linear and quadratic drag [kg/s], [kg/m],
    names of free parameters and priors."""

    lengths: np.ndarray
    b_l: float
    b_q: float
    free: list[str]
    priors: list[Table]


def propose_scene(measured: MeasuredFile, given: FileOptions) -> Table:
    """Plain values of a scene with its `[fit]`."""
    mass = 1.0 if given.mass is None else given.mass
    if measured.swing is not None:
        proposal = _propose_pendulum(measured.swing, mass)
    else:
        proposal = _propose_chain(np.array(measured.lengths), measured.open_end, mass)
    lengths, b_l, b_q, free, priors = proposal
    if measured.pivot_error is not None:
        free.append("marker.node.0")
        error = np.hypot(measured.pivot_error, LENGTH_ERROR / 100) * lengths[0]
        for axis, size in enumerate(error.tolist()):
            priors.append({"of": f"marker.node.0.{axis}", "sigma": size, "unit": "m"})
    fit: Table = {"free": free}
    if priors:
        fit["prior"] = priors
    links = measured.trace.links
    start = measured.trace.at(measured.trace.t[:1])[0]
    chain = {"name": "chain", "from": "pivot", "to": "end", "links": links}
    return {
        "description": f"Proposed by `dropper fit` for {measured.trace.name}.",
        "run": {"dt": float(np.round(pendulum_period(lengths) / STEPS_PER_PERIOD, 6)), "duration": 10.0},
        "point": [
            {"name": "pivot", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [0.0, 0.0, -float(np.sum(lengths))]},
        ],
        "line": [chain | {"length": lengths.tolist(), "mass": [mass] * links}],
        "effects": {"weight": {}, "linear_damping": {"b_l": b_l}, "quadratic_damping": {"b_q": b_q}},
        "start": {"kind": "angles", "zero": "down", "polar": start.tolist()},
        "fit": fit,
    }


def _propose_pendulum(swing: Swing, mass: float) -> Proposal:
    """One link by its free swing: half of its damping is linear drag, half quadratic."""
    length = GRAVITY / swing.stiffness
    linear = 0.5 * swing.damping * mass
    quadratic = linear / max(swing.rate * length, SLOWEST)
    return Proposal(np.array([length]), linear, quadratic, ["line.0.length", "b_l", "b_q", "camera.offset"], [])


def _propose_chain(lengths: np.ndarray, open_end: bool, mass: float) -> Proposal:
    """Several links of known relative lengths but that of an open end, and of unknown relative masses."""
    others = range(1, len(lengths))
    free = [f"line.0.mass.{j}" for j in others]
    free += ["b_l", "b_q", "rig.scale", "camera.offset"]
    free += [f"line.0.length.{j}" for j in others]
    priors: list[Table] = []
    for j in others:
        if not (open_end and j == others[-1]):
            priors.append({"of": f"line.0.length.{j}", "sigma": LENGTH_ERROR, "unit": "%"})
    drag = START_DRAG * mass
    return Proposal(lengths, drag, drag, free, priors)
