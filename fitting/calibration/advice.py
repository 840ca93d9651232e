"""What spoils a fit, by name: score tests of numbers that were taken for known.

A candidate c (lengths, the places of held points, the camera's roll, a marker, the clock, inertias) is looked at where
the fit ended. With Q the derivatives of the residuals r by a number, those by the windows' starts and by the free
parameters taken out of them, freeing c would to first order change its numbers by d and gain in log likelihood

    d = -S^-1 u,    gain = u' S^-1 u / 2,    S = Q' Q + prior,    u = Q' r

in units of the noise that the fit found, over its memory (Rao 1948). One more program is compiled, none is fitted.
Candidates are compared with Holm's correction for their number. Those that the traces cannot tell from what is free
already (the clock from an inertia that is free, of one link) are not tested, and said to be so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import chi2

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.calibration.prepared import Prepared
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.problem import Solution
from fitting.estimate.simulator import Simulator
from fitting.estimate.whitening import whitened
from fitting.parameters.parameter import Parameter, resolve
from fitting.parameters.place import CAMERA, CLOCK, MARKER
from fitting.parameters.priors import rig_priors

#: Gain in log likelihood below which nothing is advised.
WORTH = 6.0
#: Probability, over all candidates, below which one is named.
NAMED = 0.01
#: Share of a candidate's information that must be left beside what is free.
LEFT = 1e-6


@dataclass(frozen=True)
class Candidate:
    """What may be wrong; without changes where the traces cannot tell it from what is free.

    Attributes:
        name: in words.
        free: names that free it.
        changes: by parameter, the change that the traces ask for.
        errors: their standard errors.
        gain: in log likelihood.
        p: probability of such a gain where nothing is wrong, over all candidates.
    """

    name: str
    free: tuple[str, ...]
    changes: dict[str, float]
    errors: dict[str, float]
    gain: float
    p: float

    @property
    def named(self) -> bool:
        """Whether it is worth a name."""
        return self.gain > WORTH and self.p < NAMED

    @property
    def told(self) -> bool:
        """Whether the traces tell it from what is free."""
        return bool(self.changes)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {key: getattr(self, key) for key in ("name", "free", "changes", "errors", "gain", "p", "named", "told")}

    def __str__(self) -> str:
        largest = max(self.changes, key=lambda name: abs(self.changes[name] / self.errors[name]))
        change = f"{largest} by {self.changes[largest]:+.3g} +- {self.errors[largest]:.2g}"
        return f"{self.name}: --free ...,{','.join(self.free)} would gain {self.gain:.0f} in log likelihood ({change})"


def kinds(model: Model) -> Iterator[tuple[str, list[str]]]:
    """Candidates of a model: what they are called and which paths free them."""
    line = model.line
    yield "lengths of links", ["line.0.length"]
    if model.end_held:
        index = int(model.geometry.held_points[-1])
        yield "place of the second end", [f"point.{index}.position.0", f"point.{index}.position.2"]
    yield "roll of the camera", [CAMERA]
    if line.links > 1:
        for j in range(line.links):
            yield f"marker of link {j}", [f"{MARKER}.{j}"]
    yield "rate of the clock", [CLOCK]
    if line.compound:
        yield "centres of mass", ["line.0.centre_of_mass"]
        yield "moments of inertia", ["line.0.inertia"]
    elif line.links > 1:
        yield "masses", ["line.0.mass"]


def advise(prepared: Prepared, solution: Solution) -> list[Candidate]:
    """Candidates by their gain, the largest first."""
    problem, model = solution.problem, prepared.simulator.model
    free = {p.name for p in problem.parameters}
    asked: list[tuple[str, list[str], list[Parameter]]] = []
    for name, paths in kinds(model):
        try:
            found = [p for p in resolve(model, paths) if p.name not in free]
        except SceneError:
            continue  # a scene that has no such number
        if found and not any(known.startswith(tuple(paths)) for known in free):
            asked.append((name, paths, found))
    more = [p for _, _, found in asked for p in found]
    known, _ = rig_priors(prepared.scene, model, more)
    own = problem.simulator
    simulator = Simulator(model, [*own.parameters, *known], own.stepper, own.release)
    values = np.concatenate([solution.values, [p.value for p in more]])
    e = whitened(solution.windows, simulator(values, solution.starts, solution.windows))
    columns, residual = _projected(e.jacobian, e.residual, solution, len(more))
    tests, untold, at = [], [], 0
    for name, paths, found in asked:
        mine = slice(at, at + len(found))
        at += len(found)
        test = _tested(columns[:, mine], residual, known[mine], problem.memory)
        if test is None:
            untold.append(Candidate(name, tuple(paths), {}, {}, 0.0, 1.0))
        else:
            tests.append((name, paths, found, *test))
    order = sorted(tests, key=lambda t: t[-1])  # by p, for Holm
    rows = []
    worst = 0.0
    for i, (name, paths, found, change, error, gain, p) in enumerate(order):
        worst = max(worst, min(1.0, p * (len(order) - i)))
        names = [parameter.name for parameter in found]
        changes, errors = (dict(zip(names, map(float, x), strict=True)) for x in (change, error))
        rows.append(Candidate(name, tuple(paths), changes, errors, gain, worst))
    return sorted(rows, key=lambda row: -row.gain) + untold


def _projected(
    jacobian: np.ndarray, residual: np.ndarray, solution: Solution, more: int
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (N, more) by the candidates and residuals (N,), without what starts and free parameters explain."""
    m2 = solution.problem.freedoms
    root = np.sqrt(solution.weights)
    count = len(residual)
    J = (root[..., None] * jacobian).reshape(count, -1, jacobian.shape[-1])
    r = (root * residual).reshape(count, -1)
    Z, P = J[..., :m2], J[..., m2:]
    square = np.einsum("kai,kaj->kij", Z, Z)
    held = ~Z.any(axis=1)
    square += (held + 1e-12 * np.maximum(np.einsum("kii->ki", square), 1e-300))[:, :, None] * np.eye(m2)
    both = np.concatenate([P, r[..., None]], axis=2)
    both = both - Z @ np.linalg.solve(square, np.einsum("kai,kaj->kij", Z, both))
    flat = both.reshape(-1, both.shape[-1])
    taken, left = flat[:, : -more - 1][:, ~solution.problem.held], flat[:, -more - 1 :]
    if taken.shape[1]:
        size = np.maximum(np.sqrt(np.sum(taken**2, axis=0)), 1e-300)
        left = left - (taken / size) @ np.linalg.lstsq(taken / size, left, rcond=1e-10)[0]
    before = np.sqrt(np.sum(flat[:, -more - 1 : -1] ** 2, axis=0))
    after = np.sqrt(np.sum(left[:, :-1] ** 2, axis=0))
    return np.where(after > LEFT * before, left[:, :-1], 0.0), left[:, -1]


def _tested(
    columns: np.ndarray, residual: np.ndarray, parameters: tuple[Parameter, ...], memory: float
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """Changes, their errors, gain and probability; None where the traces tell nothing of it."""
    if not columns.any(axis=0).all():
        return None
    prior = block_diag(*[[[0.0 if p.prior is None else p.prior[1] ** -2]] for p in parameters])
    S = columns.T @ columns / memory + prior
    u = columns.T @ residual / memory
    change = -solve_spd(S, u)
    gain = float(-0.5 * u @ change)
    error = np.sqrt(np.diag(solve_spd(S, np.eye(len(S)))))
    return change, error, gain, float(chi2.sf(2 * gain, len(S)))
