"""A plan of measurements: how accurately each would determine the parameters, before anything is measured.

    S(w) = sum over joined windows of J' J / sigma^2 + gaps/w^2 + priors,     errors = sqrt(diag(S^-1))

with the window starts and every other free parameter eliminated, at the scene's own values. The gap weight w expresses
how closely the rig follows its model. By default it is the weight that a fit of a trace with just this noise is
expected to choose; the caller may give the weight reported by fits of a real rig. With H(w) the curvature by all starts
and parameters, A(w) its block of the starts and G = 1/w^2 gaps, the fit's evidence (`shooting`) has the mean

    -g log w - log|A|/2 - tr(H^-1 G)/2 + const,      tr(H^-1 G) = -1/2 d log|H| / d log w
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.toml_text import Json, jsonable
from dropper_jax.load.scene import load_scene
from dropper_jax.run.build import SceneLike
from fitting.calibration.preparation import prepare
from fitting.estimate.factors import invert_spd
from fitting.estimate.least_squares import Objective, fit_windows
from fitting.estimate.normal_equations import Evaluation, Step
from fitting.estimate.residuals import Problem
from fitting.estimate.shooting import SAME_EVIDENCE, SCHEDULE
from fitting.estimate.windows import PER_WINDOW, Windows, pick
from fitting.parameters.names import full_names
from fitting.traces.synthetic import Camera, observe, simulate_truth

#: Relative change of a gap weight for a central difference of log|H|: its error is below 1e-4 of a gap.
NEAR = 0.01


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
        return jsonable(
            {
                "scene": self.scene,
                "duration_s": self.duration,
                "noise_rad": self.noise,
                "std_error": self.std_error,
                "score": self.score,
                "gap_weight": self.gap_weight,
            }
        )


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
    weights = [1.0] if gap_weight is None else [gap_weight]
    units = {"duration": " s", "noise": " rad", "gap_weight": "", "rate": " Hz"}
    for (key, unit), numbers in zip(units.items(), (durations, noises, weights, [rate]), strict=True):
        bad = [x for x in numbers if not (np.isfinite(x) and x > 0)]
        if bad or not len(numbers):
            raise SceneError(f"{key}: {bad[0] if bad else 'none'} is not positive; allowed: > 0{unit}")
    found = []
    for i, source in enumerate(scenes):
        scene = load_scene(source)
        names = full_names(scene, free, "free")
        if requested is None:
            asked = names
        else:
            asked = full_names(scene, requested, "for")
        foreign = [name for name in asked if name not in names]
        if foreign:
            raise SceneError(f"for: {foreign[0]!r} is not free; allowed: {', '.join(names)}")
        stems = tuple(f"{name}." for name in asked)
        motion = simulate_truth(scene, max(durations), rate)
        for noise in sorted(noises):
            progress((i + noise / max(noises) / 2) / len(scenes), f"{scene.name}, {noise:g} rad")
            trace = observe(motion, Camera(rate=rate), 0, scene.name)
            trace = replace(trace, se=np.full_like(trace.theta, noise))
            prepared = prepare([trace], scene, names)
            problem = prepared.problem()
            held = np.ones(len(prepared.values), bool)
            # rounds of the search for the windows' starts on a trace without noise
            there = fit_windows(
                replace(problem, frozen=held), prepared.values, prepared.starts, iterations=4, progress=silent
            )
            for duration in durations:
                errors, weight = _errors(problem, there.evaluation, prepared.values, duration, gap_weight)
                by_name = dict(zip(problem.names, map(float, errors), strict=True))
                mine = [e for name, e in by_name.items() if f"{name}.".startswith(stems)]
                score = float(np.mean(np.log(mine)))
                found.append(Planned(scene.name, duration, noise, by_name, score, weight))
    progress(1.0, "ok")
    return sorted(found, key=lambda row: row.score)


def _errors(
    problem: Problem, evaluation: Evaluation, values: np.ndarray, duration: float, gap_weight: float | None
) -> tuple[np.ndarray, float]:
    """Standard errors (k,) from the windows that end within the duration, and their gap weight."""
    windows = problem.windows
    count = int(np.sum(windows.ends <= duration * (1 + 1e-9)))
    if not count:
        raise SceneError(f"duration: {duration:g} s is shorter than a window; allowed: at least {windows.length:.3g} s")
    few = replace(problem, windows=first(windows, count))
    seen = pick(evaluation, np.arange(count))
    weight = gap_weight or _expected_weight(few, seen, values)
    step = at_weight(few, seen, values, weight)
    return np.sqrt(np.diag(invert_spd(step.information))), weight


def at_weight(problem: Problem, evaluation: Evaluation, values: np.ndarray, weight: float) -> Step:
    """The Gauss-Newton step of joined windows at one weight of the gaps; its information is the inverse covariance."""
    step = Objective(problem, weight).undamped_step(evaluation, values, 0.0)
    if step is None:
        raise SceneError("free: the parameters are not identifiable from these traces. Use fewer of them, or priors")
    return step


def _expected_weight(problem: Problem, evaluation: Evaluation, values: np.ndarray) -> float:
    """The gap weight that a fit chooses by the mean of its evidence if the model is right."""
    gaps = int(problem.windows.follows.sum()) * problem.freedoms

    def logs(weight: float) -> np.ndarray:
        """log|A| and log|H|."""
        step = at_weight(problem, evaluation, values, weight)
        return step.log_determinant + np.array([0.0, np.linalg.slogdet(step.information)[1]])

    nearby = np.array([[logs(weight * share) for share in (1 / (1 + NEAR), 1.0, 1 + NEAR)] for weight in SCHEDULE])
    slope = (nearby[:, 2, 1] - nearby[:, 0, 1]) / (2 * np.log(1 + NEAR))
    evidence = -gaps * np.log(SCHEDULE) - 0.5 * nearby[:, 1, 0] + 0.25 * slope
    return next(w for w, each in zip(SCHEDULE, evidence, strict=True) if each >= max(evidence) - SAME_EVIDENCE)


def first(windows: Windows, count: int) -> Windows:
    """The first windows, joined as before."""
    whole = (*PER_WINDOW, "follows")
    return replace(windows, **{key: getattr(windows, key)[:count] for key in whole})


def rows(found: Sequence[Planned]) -> list[tuple[str, ...]]:
    """The table as text, with a heading."""
    errors = {f"standard error of {name.removeprefix('effects.')}": name for name in found[0].std_error}
    table = []
    for row in found:
        table.append(
            (
                row.scene,
                f"{row.duration:g}",
                f"{row.noise:g}",
                *(f"{row.std_error[name]:.3g}" for name in errors.values()),
                f"{row.gap_weight:.2g}",
                f"{np.exp(row.score - found[0].score):.2f}",
            )
        )
    return [("release", "duration [s]", "noise [rad]", *errors, "gap weight", "times the best"), *table]
