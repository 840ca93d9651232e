"""Groups of numbers that may be wrong together; `group_trials` frees them with priors as wide as their usual errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.model import Model
from fitting.calibration.possible_faults import existing_parameters, second_end_paths
from fitting.laws.laws import LAW_PARTS
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import (
    CAMERA,
    CLOCK,
    MARKER,
    CameraTarget,
    ClockTarget,
    ModelTarget,
)

#: Standard deviation of a length, mass or position, as a fraction of the value (of a link, for a position): measured on
#: a bench or computed from a drawing.
PRIOR_FRACTION = 0.1
#: Standard deviation [rad] of markers that are glued, and encoders that are set to zero, by eye.
PRIOR_ANGLE = 0.05
#: Relative standard deviation of the rate of a clock.
PRIOR_CLOCK = 0.01


@dataclass(frozen=True)
class FaultGroup:
    """Numbers that are freed together.

    Attributes:
        name: in words.
        parameters: the numbers.
        instead: free parameters that they replace, which are free again when the group is fixed.
    """

    name: str
    parameters: tuple[Parameter, ...]
    instead: tuple[Parameter, ...] = ()


def fault_groups(model: Model, free: Sequence[Parameter], shared: Sequence[Parameter]) -> list[FaultGroup]:
    """The groups of a model, in the order in which they are fixed again: those that others can replace come first.

    Args:
        free: parameters that are already free.
        shared: friction coefficients that are free as one number for all joints, which those of the joints replace.
    """
    line = model.line
    body = []
    markers = []  # for one link the camera represents its marker
    if line.links > 1:
        body = ["line.0.mass"]
        markers = [MARKER]
    if line.compound:  # for one link the inertia represents its mass
        body = ["line.0.inertia", "line.0.centre_of_mass"]
    # lengths before the end that they replace: the end has too few numbers to replace them
    named = [
        ("rate of the clock", [CLOCK]),
        ("lengths of links", ["line.0.length"]),
        ("position of the second end", second_end_paths(model)),
        ("markers", markers),
        ("roll of the camera", [CAMERA]),
        ("inertia", body),
        ("linear drag", [LAW_PARTS["linear"]]),
        ("quadratic drag", [LAW_PARTS["quadratic"]]),
        ("viscous friction of each joint", [LAW_PARTS["joint viscous"]]),
        ("dry friction of each joint", [LAW_PARTS["dry"]]),
    ]
    known = {p.name for p in free} - {p.name for p in shared}
    found = []
    for name, paths in named:
        own = []
        for path in paths:
            own += [q for q in existing_parameters(model, [path]) if q.name not in known]
        instead = tuple(p for p in shared if p.name in paths)
        if own and (len(own) > 1 or not instead):
            found.append(FaultGroup(name, tuple(_with_width(model, q) for q in own), instead))
    return found


def _with_width(model: Model, p: Parameter) -> Parameter:
    """A parameter with the default prior of its kind if none is given; coefficients have none."""
    width = 0.0
    if isinstance(p.where, CameraTarget):
        width = PRIOR_ANGLE
    elif isinstance(p.where, ClockTarget):
        width = PRIOR_CLOCK
    elif isinstance(p.where, ModelTarget) and p.where.section == "lines":
        width = PRIOR_FRACTION * abs(p.value)
    elif isinstance(p.where, ModelTarget) and p.where.section == "points":
        width = PRIOR_FRACTION * np.mean(np.asarray(model.line.length))
    if width > 0:
        return replace(p, prior=(p.value, width))
    return p
