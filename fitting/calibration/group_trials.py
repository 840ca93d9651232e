"""Groups of numbers that may be wrong together, tested by fits and scored on stretches that these fits do not use.

If the misfit is smooth and far above the noise everywhere, score tests find nothing: their gains are in units of the
misfit, and a single number reduces it only slightly. All groups are therefore freed at once: geometry, inertia,
markers, camera, clock and parts of the damping law. Their priors are as wide as the usual errors of such numbers, and
three fifths of every run are fitted. The score is the error on the other two fifths, with only their starts fitted.
Then one group after another is fixed again, and stays fixed unless this makes the score worse. Groups that were fixed
while the fit was still far from its minimum are tried once more at the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import ScenePath
from dropper_jax.modelling.build import build
from fitting.calibration.candidate import Candidate
from fitting.calibration.fault_groups import FaultGroup, fault_groups
from fitting.calibration.group_search import NEEDED_GROWTH, Search, effective, parameters_of
from fitting.calibration.held_out import window_length
from fitting.calibration.possible_faults import candidate_simulator
from fitting.calibration.result import chi2_per_dof
from fitting.calibration.trials import Trials
from fitting.estimate.loss import Loss
from fitting.estimate.neighbour_correlation import lag_one
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.solution import Solution
from fitting.estimate.windows import pick, with_rows
from fitting.laws.law_fits import substeps_of
from fitting.laws.law_scenes import scene_with_law, without_unused_parts
from fitting.laws.laws import JOINT_PARTS, LAW_PARTS
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.targets import all_joints
from fitting.windows.prepared import Prepared, program_space

#: Chi-square per degree of freedom from which a smooth misfit shows that the whole model is wrong: ten times the noise.
WRONG_CHI_SQUARE = 100.0
#: Correlation of neighbouring residuals above which a misfit is smooth: one at 6 Hz, sampled at 60 Hz, has 0.81.
SMOOTH_CORRELATION = 0.8


def is_model_wrong(prepared: Prepared, solution: Solution, limit: float = WRONG_CHI_SQUARE) -> bool:
    """Whether a fit leaves a smooth misfit far above the noise claimed by the traces."""
    expected = prepared.windows.weight
    if solution.windows.weight.shape != expected.shape or not np.isfinite(solution.cost):
        return False
    neighbours, _ = lag_one(solution.errors * expected, expected > 0)
    return chi2_per_dof(prepared, solution) > limit and neighbours > SMOOTH_CORRELATION


def with_full_law(prepared: Prepared, solution: Solution) -> tuple[Prepared, list[Parameter]]:
    """The preparation with every part of a damping law in the model, and friction of all joints as separate numbers.

    Dry friction needs another scheme, which costs many times as much. It is a candidate for rigs of rods or with
    friction in their joints, not for strings of point masses.
    """
    scene = prepared.scene
    own = prepared.simulator
    given = scene.effects.get("joint_friction", {})
    free = prepared.names
    zero = {part: 0.0 for part in JOINT_PARTS if LAW_PARTS[part] in free}
    dry = given.get("dry") is not None or own.model.line.compound
    scene = scene_with_law(scene, dry, zero, JOINT_PARTS)
    model, _ = build(scene)
    parameters = []
    shared = []
    for p in prepared.parameters:
        new = (p,)
        if not p.is_lost:
            new = resolve(model, [p.name], release=own.release)
        if new[0].name == p.name:
            parameters.append(replace(p, where=new[0].where))
        else:  # joints now have separate numbers
            parameters.append(replace(p, where=all_joints(model, ScenePath(p.name).key)))
            shared.append(parameters[-1])
    simulator = Simulator(model, parameters, choose_stepper(model), own.release)
    substeps = substeps_of(replace(prepared, windows=solution.windows), simulator)
    windows = replace(prepared.windows, substeps=substeps)
    return replace(prepared, scene=scene, parameters=tuple(parameters), simulator=simulator, windows=windows), shared


def free_groups(
    prepared: Prepared, solution: Solution, loss: Loss, progress: Progress = silent
) -> tuple[Prepared, Simulator, list[Candidate]] | None:
    """The preparation with the groups free that held-out stretches require; None if they require none.

    Args:
        solution: of the preparation.
    """
    before = prepared
    prepared, shared = with_full_law(prepared, solution)
    found = fault_groups(prepared.simulator.model, prepared.parameters, shared)
    zero = [replace(p, value=0.0) for p in shared]
    simulator = candidate_simulator(prepared, [*parameters_of(found), *zero])
    trials = Trials(replace(prepared, simulator=simulator), loss, solution, before.windows)
    if not (trials.spans and trials.used.any()):  # no windows to score, or none to fit
        return None
    # the programs also run the windows that score the stretches
    longest = max(window_length(prepared, (low, high)) for _, low, high in trials.spans)
    steps, slots = program_space(prepared.traces, longest, prepared.windows.dt)
    simulator.capacity = max(simulator.capacity[0], steps), max(simulator.capacity[1], slots)
    progress(0.5, "testing what may be wrong: unchanged model")
    base = trials.fit(prepared.parameters, solution.values, pick(solution.starts, trials.used))
    first = trials.score(base)
    search = Search(trials, effective(trials, base, found), base)
    progress(0.55, "testing what may be wrong: everything free")
    search.free_all()
    if not search.lowest < first - np.log1p(NEEDED_GROWTH):
        return None
    search.free_late(search.fix_needless(progress), progress)
    if not search.free:
        return None
    best = search.best
    at = trials.prepared.with_parameters(best.problem.parameters, best.values)
    scene = without_unused_parts(at.scene, before.scene, at.names)
    at = replace(
        at,
        scene=scene,
        traces=before.traces,
        held_out=before.held_out,
        noise=before.noise,
        starts=with_rows(solution.starts, trials.used, best.starts),
    )
    return at, simulator, [_candidate(group, search.needed[group.name], best) for group in search.free]


def _candidate(group: FaultGroup, factor: float, solution: Solution) -> Candidate:
    """A group that was freed, with the changes of its numbers."""
    variance = np.diag(np.linalg.pinv(solution.information, hermitian=True))
    error = dict(zip(solution.by_name, np.sqrt(np.maximum(variance, 0.0)), strict=True))
    changes = {p.name: solution.by_name[p.name] - p.value for p in group.parameters}
    errors = {name: float(max(error[name], 1e-300)) for name in changes}
    name = f"{group.name} (held-out error {factor:.2f} times larger without)"
    return Candidate(name, tuple(changes), changes, errors, float(np.log(factor)))
