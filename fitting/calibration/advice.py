"""Score tests of numbers that were assumed known: which of them cause a systematic error of the fit.

A candidate c is tested at the end of the fit: lengths, positions of fixed points, the camera's roll, a marker, the
clock, inertias. Let f be the free numbers and S the information of all numbers together. Let g be the gradient, with
the starts of the windows eliminated; both include the gaps of joined windows, priors and poses at rest. Freeing c would
change its numbers by d and raise the log likelihood, to first order, by

    d = -A^-1 u,    gain = u' A^-1 u / 2,    A = S_cc - S_cf S_ff^-1 S_fc,    u = g_c - S_cf S_ff^-1 g_f

in units of the noise that the fit estimated, including its memory (Rao 1948). One more program is compiled; nothing is
fitted again. Candidates with different numbers of parameters are compared by their gain minus `log(N)/2` per parameter
(Schwarz 1978). Holm's correction accounts for the number of candidates. A candidate that the traces cannot distinguish
from the free parameters is not tested, which the report states. Example: the clock and a free inertia, for one link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.calibration.candidate import Candidate
from fitting.calibration.law_tests import holm
from fitting.calibration.laws import LAW_PARTS
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult
from fitting.estimate.factors import invert_spd, solve_spd
from fitting.estimate.least_squares import objective_at
from fitting.estimate.normal_equations import eliminate, prior_of
from fitting.estimate.release import RELEASE_TIME, Release
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.rig_priors import rig_priors
from fitting.parameters.targets import (
    CAMERA,
    CLOCK,
    LOST,
    MARKER,
    NODE,
    SCALE,
    CameraTarget,
    ClockTarget,
    LostTarget,
    ModelTarget,
)

#: Standard deviations of numbers without a prior. A fraction of the value for quantities measured on a bench or
#: computed from a drawing; angles [rad] for markers that are glued, and encoders set to zero, by eye; a fraction for
#: clocks.
PRIOR_FRACTION = 0.1
PRIOR_ANGLE = 0.05
PRIOR_CLOCK = 0.01

#: Parameters whose derivatives are taken together with those of the starts.
PARAMETERS_PER_PASS = 4
#: Windows, and lost stretches of frames, that programs reserve space for.
RESERVED_LENGTH = 2
RESERVED_JUMPS = 2


class PossibleFault(NamedTuple):
    """Numbers of the scene that may be wrong: a name, the paths that free them, and the numbers at these paths."""

    name: str
    paths: list[str]
    parameters: list[Parameter]


def candidates(model: Model, release: Release | None) -> list[PossibleFault]:
    """The candidates whose numbers the scene has."""
    links = model.line.links
    named = [
        ("lengths of links", ["line.0.length"]),
        ("position of the second end", _second_end(model)),
        ("roll of the camera", [CAMERA]),
    ]
    if links > 1:
        named += [(f"marker of link {j}", [f"{MARKER}.{j}"]) for j in range(links)]
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
        parameters = _existing(model, paths, release)
        if parameters:
            faults.append(PossibleFault(name, paths, parameters))
    return faults


def _second_end(model: Model) -> list[str]:
    """Paths of the position of a fixed second end; empty for a free one."""
    point = int(model.geometry.held_points[-1])
    if model.end_held:
        return [f"point.{point}.position.0", f"point.{point}.position.2"]
    return []


def candidate_simulator(prepared: Prepared, further: Sequence[Parameter] = ()) -> Simulator:
    """A simulator whose programs know the free parameters, those of all candidates and others, with space for lost
    frames."""
    own = prepared.simulator
    model = own.model
    more = {}
    for fault in candidates(model, own.release):
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


def advise(result: FitResult) -> list[Candidate]:
    """What else may be wrong, by score tests at the end of a fit: candidates in order of decreasing worth."""
    if result.tested or result.solution.status != "ok":
        return result.tested
    return score_candidates(result.prepared, result.solution)


def score_candidates(prepared: Prepared, solution: Solution, simulator: Simulator | None = None) -> list[Candidate]:
    """Candidates in order of decreasing worth; `simulator` must know their numbers."""
    problem = solution.problem
    asked = _not_free(prepared, problem.parameters)
    more = [p for one in asked for p in one.parameters]
    S, g, data = joint_information(prepared, solution, simulator or candidate_simulator(prepared), more)
    free = solution.free
    tested = []
    undistinguished = []
    for one in asked:
        change = score_change(S, g, data, free, one.rows)
        if change is None:
            undistinguished.append(Candidate(one.name, one.paths, p=1.0))
        else:
            tested.append((one, change))
    penalty = 0.5 * np.log(max(solution.windows.samples / problem.memory, 2.0))
    names = [problem.names[i] for i in free]
    # indistinguishable candidates keep the order of their probabilities
    tested.sort(key=lambda pair: pair[1].p)
    rows = []
    for (one, change), p in zip(tested, holm([change.p for _, change in tested]), strict=True):
        own = [parameter.name for parameter in one.parameters]
        changes = dict(zip(own, change.change.tolist(), strict=True))
        errors = dict(zip(own, change.error.tolist(), strict=True))
        moves = dict(zip(names, change.moves.tolist(), strict=True)) | changes
        worth = change.gain - penalty * len(own)
        row = Candidate(one.name, one.paths, changes, errors, change.gain, p, worth, moves=moves)
        if row.worth_naming:
            also_free = np.concatenate([free, one.rows])
            alike = []
            for other in asked:
                same_size = other is not one and len(other.rows) == len(one.rows)
                if same_size and score_change(S, g, data, also_free, other.rows) is None:
                    alike.append(other.name)
            row = replace(row, alike=tuple(alike))
        rows.append(row)
    return sorted(rows, key=lambda row: -round(row.worth, 1)) + undistinguished


@dataclass(frozen=True)
class UntestedCandidate:
    """A candidate to be tested: its name, the paths that free it, its numbers, and their rows in the information."""

    name: str
    paths: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    rows: np.ndarray


def _not_free(prepared: Prepared, parameters: Sequence[Parameter]) -> list[UntestedCandidate]:
    """The candidates whose numbers are not free yet; their rows follow those of the free parameters."""
    free = {p.name for p in parameters}
    found: list[UntestedCandidate] = []
    end = len(parameters)
    for name, paths, every in candidates(prepared.simulator.model, prepared.simulator.release):
        more = tuple(p for p in every if p.name not in free)
        if not more or any(known.startswith(tuple(paths)) for known in free):
            continue
        found.append(UntestedCandidate(name, tuple(paths), more, np.arange(end, end + len(more))))
        end += len(more)
    return found


def joint_information(
    prepared: Prepared, solution: Solution, simulator: Simulator, more: Sequence[Parameter]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Information and gradient of the free and further parameters, and the information from measurements alone."""
    problem = solution.problem
    every, known = rig_priors(prepared.scene, prepared.simulator.model, [*problem.parameters, *more])
    values = np.concatenate([solution.values, [p.value for p in more]])
    extended = replace(problem, simulator=simulator.view_of(every), parameters=every, frozen=None, known=known)
    evaluation = extended.evaluate(values, solution.starts)
    system = objective_at(extended, solution.gap_weight).system(evaluation, values)
    no_change = np.zeros(len(values))
    step = eliminate(system, 0.0, extended.prior(values), no_change, no_change)
    prior = prior_of(every, values, known.common)
    data = step.information - prior.curvature
    slope = step.gradient - prior.gradient
    return data / problem.memory + prior.curvature, slope / problem.memory + prior.gradient, data


class ScoreChange(NamedTuple):
    """First-order changes of a candidate's numbers, their errors, moves of free parameters, gain and probability."""

    change: np.ndarray
    error: np.ndarray
    moves: np.ndarray
    gain: float
    p: float


#: Fraction of a candidate's information that must remain once the free parameters are accounted for.
LEAST_OWN_INFORMATION = 1e-7


def score_change(
    S: np.ndarray, g: np.ndarray, data: np.ndarray, free: np.ndarray, mine: np.ndarray
) -> ScoreChange | None:
    """The change that freeing the numbers `mine` would make; None if the traces carry no information on them."""
    size = np.diag(data)[mine]
    if not (size > 0).all():
        return None
    A = S[np.ix_(mine, mine)]
    u = g[mine]
    inner = np.zeros((0, len(mine) + 1))
    if len(free):
        inner = solve_spd(S[np.ix_(free, free)], np.column_stack([S[np.ix_(free, mine)], g[free]]))
        A = A - S[np.ix_(mine, free)] @ inner[:, :-1]
        u = u - S[np.ix_(mine, free)] @ inner[:, -1]
    scale = 1 / np.sqrt(np.diag(S)[mine])
    if np.linalg.eigvalsh(A * np.outer(scale, scale))[0] < LEAST_OWN_INFORMATION:
        return None
    change = -solve_spd(A, u)
    gain = float(-0.5 * u @ change)
    error = np.sqrt(np.diag(invert_spd(A)))
    p = float(chdtrc(len(A), max(2 * gain, 0.0)))
    return ScoreChange(change, error, -inner @ np.append(change, 1.0), gain, p)


@dataclass(frozen=True)
class Group:
    """Numbers that are freed together, and those that replace them when they are fixed again."""

    name: str
    parameters: tuple[Parameter, ...]
    instead: tuple[Parameter, ...] = ()


def groups(model: Model, free: Sequence[Parameter], shared: Sequence[Parameter]) -> list[Group]:
    """What may be wrong in a model; groups that others are more likely to replace come first and are fixed first.

    Args:
        free: parameters that are already free.
        shared: friction that was free as one number for all joints; separate joints replace it.
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
        ("position of the second end", _second_end(model)),
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
            own += [q for q in _existing(model, [path]) if q.name not in known]
        instead = tuple(p for p in shared if p.name in paths)
        if own and (len(own) > 1 or not instead):
            found.append(Group(name, tuple(_with_width(model, q) for q in own), instead))
    return found


def _existing(model: Model, paths: Sequence[str], release: Release | None = None) -> list[Parameter]:
    """The numbers at these paths; empty if the scene lacks one."""
    try:
        return list(resolve(model, paths, release=release))
    except SceneError:
        return []


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
        width = PRIOR_FRACTION * float(np.mean(np.asarray(model.line.length)))
    if width > 0:
        return replace(p, prior=(p.value, width))
    return p
