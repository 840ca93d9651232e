"""A plan of measurements: how accurately each would determine the parameters, before anything is measured.

    S(w) = sum over joined windows of J' J / sigma^2 + gaps/w^2 + priors,     errors = sqrt(diag(S^-1))

with the window starts and every other free parameter eliminated, at the scene's own values. The gap weight w expresses
how closely the rig follows its model. By default it is the weight that a fit of a trace with just this noise is
expected to choose; the caller may give the weight reported by fits of a real rig. With H(w) the curvature by all starts
and parameters, A(w) its block of the starts and G = 1/w^2 gaps, the fit's evidence (`shooting`) has the mean

    -g log w - log|A|/2 - tr(H^-1 G)/2 + const,      tr(H^-1 G) = -1/2 d log|H| / d log w
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError, require_positive
from dropper_jax.base.json_values import Json
from dropper_jax.base.markdown import Rows, cells, text_row
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import SceneLike
from fitting.estimate.factors import invert_spd
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.normal_equations import Step
from fitting.estimate.objective import Objective
from fitting.estimate.shooting import GAP_WEIGHTS, loosest_of
from fitting.estimate.solution import Solution
from fitting.estimate.windows import pick
from fitting.parameters.names import full_names
from fitting.traces.synthetic import Camera, observe, simulate_truth
from fitting.traces.trace import FEWEST_SAMPLES, Trace
from fitting.windows.preparation import prepare

#: Rounds of the search for the windows' starts on a trace without noise.
START_ROUNDS = 4
#: Relative change of a gap weight for a central difference of log|H|: its error is below 1e-4 of a gap.
WEIGHT_STEP = 0.01


@dataclass(frozen=True)
class Planned:
    """One measurement and the accuracy that it would give.

    Attributes:
        scene: its name, which implies how it is released.
        duration: [s].
        noise: of the angles [rad].
        std_error: by parameter.
        score: mean log of the requested errors; the smallest is the best.
        gap_weight: weight of the gaps for which the errors hold.
    """

    scene: str
    duration: float
    noise: float
    std_error: dict[str, float]
    score: float
    gap_weight: float

    def to_json(self) -> Json:
        """Plain values."""
        units = {"duration": "duration_s", "noise": "noise_rad"}
        return {units.get(key, key): value for key, value in vars(self).items()}


def plan(
    scenes: Sequence[SceneLike],
    free: Sequence[str],
    *,
    durations: Sequence[float],
    noises: Sequence[float] = (0.005,),
    requested: Sequence[str] | None = None,
    gap_weight: float | None = None,
    rate: float = 60.0,
    progress: Progress = silent,
) -> list[Planned]:
    """Rank measurements by the parameter errors that they would give, the best first.

    Args:
        scenes: released in different ways; each one's own values are taken as the truth.
        free: parameters that a fit would free, nuisance parameters included.
        durations: of the traces [s].
        noises: of the angles [rad], such as of two cameras.
        requested: those of `free` to rank by; default all.
        gap_weight: as reported by joined fits of the rig; default: the value expected if the model is right. A film of
            a real rig gives a value ten to a hundred times higher.
        rate: frames per second [Hz].

    Raises:
        SceneError: for any invalid input, in one line.
    """
    _check_positive("duration", durations, " s")
    _check_positive("noise", noises, " rad")
    if gap_weight is not None:
        require_positive("gap_weight", gap_weight, "")
    require_positive("rate", rate, " Hz")
    if min(durations) * rate < FEWEST_SAMPLES:
        raise SceneError(
            f"duration: {min(durations):g} s has too few frames at {rate:g} Hz; allowed: at least "
            f"{FEWEST_SAMPLES / rate:.2g} s"
        )
    plans = []
    for i, source in enumerate(scenes):
        scene = load_scene(source)
        names = full_names(scene, free, "free")
        ranked = names
        if requested is not None:
            ranked = full_names(scene, requested, "for")
        foreign = [name for name in ranked if name not in names]
        if foreign:
            raise SceneError(f"for: {foreign[0]!r} is not free; allowed: {', '.join(names)}")
        motion = simulate_truth(scene, max(durations), rate)
        for noise in sorted(noises):
            progress((i + noise / max(noises) / 2) / len(scenes), f"{scene.name}, {noise:g} rad")
            trace = observe(motion, Camera(rate=rate), 0, scene.name)
            solution = _along_truth(replace(trace, se=np.full_like(trace.theta, noise)), scene, names)
            for duration in durations:
                errors, weight = _errors(solution, duration, gap_weight)
                by_name = dict(zip(solution.by_name, errors.tolist(), strict=True))
                score = _mean_log(by_name, ranked)
                plans.append(Planned(scene.name, duration, noise, by_name, score, weight))
    progress(1.0, "ok")
    return sorted(plans, key=lambda row: row.score)


def _along_truth(trace: Trace, scene: Scene, names: Sequence[str]) -> Solution:
    """Windows of a trace without noise at the scene's own values, with their starts on the motion."""
    prepared = prepare([trace], scene, names)
    held = prepared.problem(frozen=np.ones(len(prepared.values), bool))
    solution = fit_windows(held, prepared.values, prepared.starts, iterations=START_ROUNDS)
    return replace(solution, problem=prepared.problem())


def _mean_log(errors: Mapping[str, float], ranked: Sequence[str]) -> float:
    """Mean log of the errors of the parameters at these paths."""
    stems = tuple(f"{name}." for name in ranked)
    return float(np.mean(np.log([error for name, error in errors.items() if f"{name}.".startswith(stems)])))


def _check_positive(key: str, numbers: Sequence[float], unit: str) -> None:
    """Reject an empty list, and numbers that are not positive and finite."""
    if not len(numbers):
        raise SceneError(f"{key}: none is given; allowed: > 0{unit}")
    for number in numbers:
        require_positive(key, number, unit)


def _errors(solution: Solution, duration: float, gap_weight: float | None) -> tuple[np.ndarray, float]:
    """Standard errors (k,) from the windows that end within the duration, and their gap weight."""
    windows = solution.windows
    late = windows.ends > duration * (1 + 1e-9)
    if late.all():
        raise SceneError(f"duration: {duration:g} s is shorter than a window; allowed: at least {windows.length:.3g} s")
    problem = replace(solution.problem, windows=windows.exclude(late))
    early = replace(solution, problem=problem, evaluation=pick(solution.evaluation, ~late))
    weight = gap_weight or _expected_weight(early)
    return np.sqrt(np.diag(invert_spd(at_weight(early, weight).information))), weight


def at_weight(solution: Solution, weight: float) -> Step:
    """The Gauss-Newton step of joined windows at one weight of the gaps; its information is the inverse covariance."""
    step = Objective(solution.problem, weight).undamped_step(solution.evaluation, solution.values, 0.0)
    if step is None:
        raise SceneError("free: the parameters are not identifiable from these traces. Use fewer of them, or priors")
    return step


def _expected_weight(solution: Solution) -> float:
    """The gap weight that a fit chooses by the mean of its evidence if the model is right."""
    gaps = solution.windows.follows.sum() * solution.problem.freedoms

    def log_curvature(weight: float) -> float:
        """log|H|."""
        step = at_weight(solution, weight)
        return step.log_determinant + np.linalg.slogdet(step.information)[1]

    evidence = []
    for weight in GAP_WEIGHTS:
        change = log_curvature(weight * (1 + WEIGHT_STEP)) - log_curvature(weight / (1 + WEIGHT_STEP))
        slope = change / (2 * np.log(1 + WEIGHT_STEP))
        starts = at_weight(solution, weight).log_determinant
        evidence.append(-gaps * np.log(weight) - 0.5 * starts + 0.25 * slope)
    return GAP_WEIGHTS[loosest_of(evidence)]


def rows(plans: Sequence[Planned]) -> Rows:
    """The table as text, with a heading."""
    head = [f"standard error of {name.removeprefix('effects.')}" for name in plans[0].std_error]
    table = [("release", "duration [s]", "noise [rad]", *head, "gap weight", "times the best")]
    for row in plans:
        errors = cells(row.std_error.values(), ".3g")
        times = np.exp(row.score - plans[0].score)
        first = text_row("{0.scene}|{0.duration:g}|{0.noise:g}", row)
        table.append((*first, *errors, *text_row("{0.gap_weight:.2g}|{1:.2f}", row, times)))
    return table
