"""Which damping law do the traces ask for? A ladder of laws, scored by BIC and on stretches that were not fitted.

Every law is a subset of one full set of coefficients, the others held at zero, so that all are fitted by the same
simulator on the same windows. BIC = `N_eff log(chi2/N) + k log N_eff` (Schwarz 1978), where N_eff counts the samples
by their correlation, N (1 - rho)/(1 + rho). Scores compare only with one N_eff for all laws: rho is taken from the law
that fits best, whose residuals are nearest to the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build
from fitting.calibration.heldout import fit_starts
from fitting.calibration.law import Law
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Problem, Solution
from fitting.estimate.simulator import Simulator
from fitting.estimate.uncertainty import lag_one
from fitting.estimate.windows import Starts, Windows, first_starts
from fitting.parameters.parameter import resolve, with_effects

#: Every damping coefficient that a law may use.
PARTS = {
    "linear": "effects.linear_damping.b_l",
    "quadratic": "effects.quadratic_damping.b_q",
    "joint viscous": "effects.joint_friction.viscous",
    "dry": "effects.joint_friction.dry",
}
#: The ladder: name and parts; from the simplest on.
LADDER = {
    "none": (),
    "linear": ("linear",),
    "joint viscous": ("joint viscous",),
    "linear + quadratic": ("linear", "quadratic"),
    "linear + dry": ("linear", "dry"),
    "joint viscous + dry": ("joint viscous", "dry"),
    "linear + quadratic + dry": ("linear", "quadratic", "dry"),
    "joint viscous + quadratic + dry": ("joint viscous", "quadratic", "dry"),
}
#: Windows kept for scoring where the caller holds nothing out: one in so many.
SCORED = 5
#: Largest correlation of neighbours believed [-]: beyond it a trace would hold next to no sample at all.
MOST_CORRELATED = 0.999


def compare(
    prepared: Prepared, laws: Sequence[str] = tuple(LADDER), iterations: int = 25, progress: Progress | None = None
) -> list[Law]:
    """Fit every law of the ladder to the same windows by `windows`.

    Scores on the caller's held-out spans, else on every fifth window, which is then not fitted. What else is free in
    the fit (inertias, camera) is free in every law.
    """
    say = progress or silent
    others = [p.name for p in prepared.parameters if not p.name.startswith(tuple(PARTS.values()))]
    fitted, scored = _split(prepared)
    rows, squares, residuals, starts = [], [], [], None
    groups = {dry: _family(prepared, others, dry) for dry in {("dry" in LADDER[law]) for law in laws}}
    for i, law in enumerate(laws):
        say(0.95, f"law {i + 1} of {len(laws)}: {law}")
        simulator, owner = groups["dry" in LADDER[law]]
        row, square, solution = _one(prepared, simulator, owner, law, fitted, scored, starts, iterations)
        starts = solution.starts  # the next law's begin there
        rows.append(row)
        squares.append(square)
        residuals.append(solution.evaluation.residual)
    return _mark(with_bic(rows, residuals, fitted), squares)


def _split(prepared: Prepared) -> tuple[Windows, Windows]:
    windows = prepared.windows
    if prepared.held_out:
        pieces = [
            (i, max(low, float(trace.t[0])), min(high, float(trace.t[-1]) + trace.interval))
            for i, trace in enumerate(prepared.traces)
            for low, high in prepared.held_out
            if min(high, float(trace.t[-1]) + trace.interval) - max(low, float(trace.t[0])) >= windows.length
        ]
        if pieces:
            return windows, prepared.cut(windows.length, pieces)
    # a released window is fitted: it alone tells when its run was let go, and its own start cannot be found again
    own = np.flatnonzero(~windows.released)
    kept = np.zeros(windows.count, bool)
    kept[own[SCORED - 1 :: SCORED]] = True
    if not kept.any():
        kept[own[-1:]] = windows.count > 1
    return windows.pick(~kept), windows.pick(kept if kept.any() else ~kept)


def _family(prepared: Prepared, others: list[str], dry: bool) -> tuple[Simulator, list[str | None]]:
    """A simulator with every coefficient of the laws with or without dry friction; and each parameter's part."""
    parts = [part for part in PARTS if dry or part != "dry"]
    names = [PARTS[part] for part in parts]
    table = prepared.scene.to_dict()
    friction = table["effects"].setdefault("joint_friction", {})
    links = len(prepared.scene.lines[0].length)
    friction["viscous"] = [0.0] * (links + 1) if links <= 2 else 0.0
    friction.setdefault("axis", [0.0, 1.0, 0.0])
    if dry:
        friction["dry"] = [0.0] * (links + 1) if links <= 2 else 0.0
    else:
        friction.pop("dry", None)
    model, _ = build(with_effects(Scene.from_dict(table), names))
    release = prepared.simulator.release
    release = None if release is None else replace(release)  # its poses are of one model
    same = {p.name: p for p in prepared.parameters if p.name in others}
    parameters = [same.get(p.name, p) for p in resolve(model, [*others, *names], release=release)]
    owner = [next((part for part in parts if p.name.startswith(PARTS[part])), None) for p in parameters]
    return Simulator(model, parameters, release=release), owner


def _one(
    prepared: Prepared,
    simulator: Simulator,
    owner: list[str | None],
    law: str,
    fitted: Windows,
    scored: Windows,
    starts: Starts | None,
    iterations: int,
) -> tuple[Law, np.ndarray, Solution]:
    """A law fitted, its mean squared error on each scored window, and its solution."""
    used = np.array([part is None or part in LADDER[law] for part in owner])
    known = {p.name: p.value for p in prepared.parameters}
    parameters = simulator.parameters
    first = [p.value if part is None else p.scale for p, part in zip(parameters, owner, strict=True)]
    values = np.where(used, [known.get(p.name, value) for p, value in zip(parameters, first, strict=True)], 0.0)
    starts = starts or first_starts(simulator.model_at(values), prepared.traces, fitted, prepared.smooth)
    problem = Problem(simulator, fitted, parameters, frozen=~used)
    solution = fit_windows(problem, values, starts, iterations=iterations)
    judged = fit_starts(replace(prepared, simulator=simulator, parameters=parameters), scored, solution.values)
    square = _window_squares(judged)
    row = Law(
        name=law,
        coefficients=int(sum(on and part is not None for on, part in zip(used, owner, strict=True))),
        rms=float(np.sqrt(np.mean(_window_squares(solution)))),
        held_out=float(np.sqrt(np.mean(square))),
        held_out_error=0.0,
        free=int(used.sum()),
        status=solution.status,
        values={p.name: float(v) for p, v, on in zip(parameters, solution.values, used, strict=True) if on},
    )
    return row, square, solution


def _window_squares(solution: Solution) -> np.ndarray:
    """Mean squared angle error of each window (K,) [rad^2]."""
    known = (solution.windows.weight > 0).sum(axis=(1, 2))
    return np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(known, 1)


def with_bic(rows: list[Law], residuals: list[np.ndarray], windows: Windows) -> list[Law]:
    """The laws with their BIC, all by the effective number of samples of the one with the least chi-square."""
    chi2, samples = np.array([np.sum(r**2) for r in residuals]), windows.samples
    rho = lag_one(residuals[int(np.argmin(chi2))], windows.weight > 0)[0]
    rho = np.clip(rho, 0.0, MOST_CORRELATED)
    effective = samples * (1 - rho) / (1 + rho)
    scores = effective * np.log(chi2 / samples) + np.array([row.free for row in rows]) * np.log(effective)
    return [replace(row, bic=float(score)) for row, score in zip(rows, scores, strict=True)]


def _mark(rows: list[Law], squares: list[np.ndarray]) -> list[Law]:
    """Standard errors of the difference to the best law, window by window, and the simplest law within one of them."""
    best = int(np.argmin([row.held_out for row in rows]))
    marked, candidates = [], []
    for i, row in enumerate(rows):
        difference = squares[i] - squares[best]
        error = float(np.std(difference, ddof=1) / np.sqrt(len(difference))) if len(difference) > 1 else 0.0
        marked.append(replace(row, held_out_error=error / max(2 * rows[best].held_out, 1e-300)))
        if float(np.mean(difference)) <= error:
            candidates.append(i)
    simplest = min(candidates, key=lambda i: (rows[i].coefficients, rows[i].held_out))
    return [replace(row, chosen=i == simplest) for i, row in enumerate(marked)]
