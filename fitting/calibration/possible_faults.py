"""Numbers of a scene that may be wrong, under names that a user understands: the candidates of `advice`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.estimate.release import RELEASE_TIME, Release
from fitting.estimate.simulator import Simulator
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.targets import (
    CAMERA,
    CLOCK,
    LOST,
    MARKER,
    NODE,
    SCALE,
    LostTarget,
)
from fitting.windows.preparation import at_frames
from fitting.windows.prepared import Prepared


class PossibleFault(NamedTuple):
    """Numbers of the scene that may be wrong: a name, the paths that free them, and the numbers at these paths."""

    name: str
    paths: list[str]
    parameters: list[Parameter]


def possible_faults(model: Model, release: Release | None) -> list[PossibleFault]:
    """The candidates whose numbers the scene has."""
    links = model.line.links
    named = [
        ("lengths of links", ["line.0.length"]),
        ("position of the second end", second_end_paths(model)),
        ("roll of the camera", [CAMERA]),
    ]
    if links > 1:
        named += [(f"marker of link {j + 1}", [f"{MARKER}.{j}"]) for j in range(links)]
        named += [(f"marker of node {i}", [f"{NODE}.{i}"]) for i in range(links + 1)]
    named += [
        ("rate of the clock", [CLOCK]),
        ("scale of the rig", [SCALE]),
        ("gravity", ["effects.weight.gravity"]),
        ("centres of mass", ["line.0.centre_of_mass"]),
        ("moments of inertia", ["line.0.inertia"]),
    ]
    if links > 1 and not model.line.compound:
        named.append(("masses", ["line.0.mass"]))
    if release is not None:
        named += [(f"start of run {i}", [f"{RELEASE_TIME}.{i}"]) for i in range(release.runs)]
    faults = []
    for name, paths in named:
        parameters = existing_parameters(model, paths, release)
        if parameters:
            faults.append(PossibleFault(name, paths, parameters))
    return faults


def second_end_paths(model: Model) -> list[str]:
    """Paths of the position of a fixed second end; empty for a free one."""
    point = model.geometry.held_points[-1]
    if model.both_ends_fixed:
        return [f"point.{point}.position.0", f"point.{point}.position.2"]
    return []


def existing_parameters(model: Model, paths: Sequence[str], release: Release | None = None) -> list[Parameter]:
    """The numbers at these paths; empty if the scene lacks one."""
    try:
        return list(resolve(model, paths, release=release))
    except SceneError:
        return []


#: Number of parameters whose derivatives are taken in one pass, together with those of the starts.
PARAMETERS_PER_PASS = 4
#: Multiple of the windows' steps and sample slots, and number of jumps of the clock, that programs have space for:
#: windows that contain a jump may be joined.
RESERVED_LENGTH = 2
RESERVED_JUMPS = 2


def candidate_simulator(prepared: Prepared, further: Sequence[Parameter] = ()) -> Simulator:
    """A simulator whose programs know the free parameters and those of all candidates, with space for lost frames.

    Args:
        further: other parameters that they know too.
    """
    own = prepared.simulator
    model = own.model
    more = {}
    for fault in possible_faults(model, own.release):
        more |= {p.name: p for p in fault.parameters}
    more |= {p.name: p for p in further}
    for name in prepared.names:
        more.pop(name, None)
    if own.knows([*prepared.parameters, *more.values()]):
        return own
    every = [p for p in prepared.parameters if not p.is_lost]
    for p in tested_parameters(model, every):
        more.setdefault(p.name, p)
    lost = [Parameter(f"{LOST}.-.{i}", LostTarget(-1, i), 0.0, unit="s") for i in range(RESERVED_JUMPS)]
    simulator = Simulator(
        model, [*every, *more.values(), *lost], own.stepper, own.release, tangents=own.freedoms + PARAMETERS_PER_PASS
    )
    simulator.capacity = RESERVED_LENGTH * prepared.windows.steps, RESERVED_LENGTH * prepared.windows.theta.shape[1]
    return simulator


def with_freed(prepared: Prepared, paths: Sequence[str], simulator: Simulator, value: float | None = None) -> Prepared:
    """The preparation with more free parameters, which start from `value` or from the scene's own."""
    more = resolve(prepared.simulator.model, paths, release=prepared.simulator.release)
    more = [p for p in at_frames(more, prepared.traces) if p.name not in prepared.names]
    own = [p.value for p in more]
    if value is not None:
        own = [value] * len(more)
    begin = np.append(prepared.values, own)
    return prepared.with_parameters([*prepared.parameters, *more], begin, simulator)
