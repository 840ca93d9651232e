"""Sensitivity of a quantity to parameters: exact local derivatives, and their range of validity.

Local derivatives include the whole run and its static start, in forward and in reverse mode. In a chaotic motion they
grow like exp(lambda t) and soon do not predict the effect of a finite change. The horizon is the time until then.
Averages over windows shorter than the horizon remain meaningful beyond it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.numerics import safe_norm
from dropper_jax.cli.options import listing, table
from dropper_jax.model import Model, Parted, State, state
from dropper_jax.run.build import initial_state
from dropper_jax.run.storage import extra
from dropper_jax.study.reference import horizon, lyapunov
from fitting.parameters.parameter import apply
from fitting.sensitivity.problem import Plan, Study, linear_range

#: Growth of a small error up to which derivatives are valid: a change of 1 % has then become one of 100 %.
CHAOTIC_GROWTH = 100.0


@dataclasses.dataclass(frozen=True)
class Local:
    """Derivatives at the scene's values.

    Attributes:
        names, units, values: of the parameters.
        of, unit, value: the quantity.
        forward: dQ/dp (p,).
        horizon: time [s] up to which derivatives are valid; `duration` [s] of the run.
        reverse: dQ/dp by reverse mode (p,); None unless requested.
        exponent: growth rate of small errors [1/s]; None if it was not needed.
        window: length [s] of the windows of the means; None if derivatives are valid for the whole run.
        window_mean, window_error: mean derivative of the windows' values and its standard error (p,).
        linear_range, warnings: relative change of all parameters that the derivatives predict, at most 0.01, and a
            warning if it is less (see `problem.linear_range`).
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    of: str
    unit: str
    value: float
    forward: np.ndarray
    horizon: float
    duration: float
    reverse: np.ndarray | None = None
    exponent: float | None = None
    window: float | None = None
    window_mean: np.ndarray | None = None
    window_error: np.ndarray | None = None
    linear_range: float = 0.01
    warnings: list[str] = dataclasses.field(default_factory=list)

    @property
    def scaled(self) -> np.ndarray:
        """`p/Q dQ/dp` (p,): percentage change of the quantity for 1 % change of the parameter; NaN if Q is 0."""
        return self.forward * self.values / self.value if self.value else np.full(len(self.names), np.nan)

    @property
    def finite(self) -> bool:
        """Whether every step of the run was solved."""
        return bool(np.isfinite(self.value) and np.isfinite(self.forward).all())

    @property
    def trusted(self) -> bool:
        return self.window is None

    @property
    def mismatch(self) -> float | None:
        """Maximum difference of the two modes, relative to the maximum derivative; None without reverse mode."""
        if self.reverse is None:
            return None
        size = float(np.max(np.abs(self.forward), initial=0.0))
        return float(np.max(np.abs(self.forward - self.reverse), initial=0.0)) / size if size else 0.0

    def to_json(self) -> dict[str, Any]:
        """The fields and the properties derived from them."""
        return {**dataclasses.asdict(self), "scaled": self.scaled, "trusted": self.trusted}


@cached_jit(static=("plan",), brief=True)
def _forward(plan: Plan, model: Model, near: State, values: jax.Array) -> tuple[jax.Array, ...]:
    """Derivatives (p,) and value of the quantity; the displacement of nodes by each parameter, `max |dr/dp|` (p,), and
    the maximum extent of a node's motion."""

    def along(direction: jax.Array) -> tuple[jax.Array, ...]:
        at = partial(plan.evaluate, model, near)
        (value, run), (slope, moved) = jax.jvp(at, (values,), (direction,))
        return slope, jnp.max(safe_norm(moved.r)), value, jnp.max(safe_norm(run.r - run.r[0]))

    slopes, reach, value, extent = jax.vmap(along, out_axes=(0, 0, None, None))(jnp.eye(len(values)))
    return slopes, value, reach, extent


@cached_jit(static=("plan",), brief=True)
def _reverse(plan: Plan, model: Model, near: State, values: jax.Array) -> jax.Array:
    return jax.grad(lambda p: plan.evaluate(model, near, p, checkpoint=True)[0])(values)


def local(problem: Study, say: Progress = silent, check: bool = False) -> Local:
    """Exact derivatives of the study at its values, and their range of validity.

    If no parameter's change of 1 % moves any node by more than 10 % of the motion's extent, the derivatives are valid
    for the whole run. Otherwise the growth of small errors is computed by a separate program.

    The same program runs once more with all parameters changed by 1 %, each in the direction that increases the
    quantity. If the derivatives do not predict this change within a third, such as after the snap of a slack rope,
    smaller changes find their linear range.

    Args:
        check: also compute the derivatives by reverse mode, and the growth rate in any case.
    """
    at = jnp.asarray(problem.values, problem.model.dtype)
    say(0.0, "forward derivatives")
    forward, value, reach, extent = map(np.asarray, _forward(problem.plan, problem.model, problem.start, at))
    if not (np.isfinite(value) or problem.retries or problem.of.at_rest):
        return local(dataclasses.replace(problem, retries=True), say, check)
    if np.isfinite(value):
        problem.check_derivatives(forward)
    run = problem.scene.run
    duration = 0.0 if problem.of.at_rest else run.steps * run.dt
    found = Local(
        names=problem.names,
        units=[p.unit for p in problem.parameters],
        values=problem.values,
        of=problem.of.name,
        unit=problem.of.unit,
        value=float(value),
        forward=forward,
        horizon=duration,
        duration=duration,
    )
    if found.finite:
        say(0.3, "linear range")
        changed = lambda p: _forward(problem.plan, problem.model, problem.start, p)[1]  # noqa: E731
        linear, notes = linear_range(problem, found.value, forward, changed)
        found = dataclasses.replace(found, linear_range=linear, warnings=notes)
    if check:
        say(0.4, "reverse derivatives")
        reverse = np.asarray(_reverse(problem.plan, problem.model, problem.start, at))
        if found.finite:
            problem.check_derivatives(reverse)
        found = dataclasses.replace(found, reverse=reverse)
    moved = reach * [p.scale for p in problem.parameters]
    far_from_chaos = bool(np.all(moved <= 0.1 * CHAOTIC_GROWTH * extent))
    if problem.of.at_rest or (far_from_chaos and not check):
        say(1.0, "ok")
        return found
    say(0.7, "trust horizon")
    growth = lyapunov(problem.model, problem.start, problem.stepper, run.dt, max(run.steps, 2))
    limit, exponent = horizon(growth, run.dt, CHAOTIC_GROWTH), float(growth.exponent)
    found = dataclasses.replace(found, horizon=limit, exponent=exponent)
    if limit >= (1 - 1e-9) * duration:
        say(1.0, "ok")
        return found
    mean, error, length = windows(problem, at, limit)
    say(1.0, "ok")
    return dataclasses.replace(found, window=length, window_mean=mean, window_error=error)


@cached_jit(static=("plan", "saves", "count"), brief=True)
def _window_slopes(plan: Plan, model: Model, near: State, values: jax.Array, saves: int, count: int) -> jax.Array:
    """Derivatives (count, p) of the quantity over each of `count` windows of `saves` saved times."""
    changed = apply(model, plan.parameters, values)
    s = initial_state(changed, plan.start, near=near)
    run = jax.lax.stop_gradient(plan.march(changed, s, plan.run.saves))
    pick = jnp.arange(count - 1) * saves + saves - 1
    first = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b[pick]]),
        (s.r, s.v, s.tension, s.parted),
        (run.r, run.v, run.tension, run.parted),
    )
    t = jnp.arange(count) * (saves * plan.run.save_every * plan.run.dt)

    def one(r: jax.Array, v: jax.Array, tension: jax.Array, parted: Parted, t: jax.Array) -> jax.Array:
        def value(p: jax.Array) -> jax.Array:
            model_p = apply(model, plan.parameters, p)
            now = dataclasses.replace(state(model_p, r, v, tension), t=t, parted=parted)
            return plan.measure(model_p, now, plan.march(model_p, now, saves))

        return jax.jacfwd(value)(values)

    return jax.vmap(one)(*jax.lax.stop_gradient(first), t)


def windows(problem: Study, at: jax.Array, length: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean derivative of the quantity over windows of about `length` [s] that start on the motion itself.

    Each window's start is fixed, so that derivatives only accumulate within the window. The result is the effect of a
    parameter on the quantity within one horizon, averaged over the states of the motion.

    Returns:
        mean and standard error (p,), and the windows' length [s].
    """
    every = problem.scene.run.dt * problem.scene.run.save_every
    saves = min(max(2, int(length / every)), problem.scene.run.saves)
    count = problem.scene.run.saves // saves

    found = np.asarray(_window_slopes(problem.plan, problem.model, problem.start, at, saves, count))
    error = found.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(found.shape[1], np.nan)
    return found.mean(axis=0), error, saves * every


# Global sensitivity: Sobol indices and Morris screening of a function over a box of parameters (SALib)

METHODS = ("sobol", "morris")


@dataclasses.dataclass(frozen=True)
class Global:
    """Indices over a box of parameters.

    Attributes:
        method: `sobol` (first: fraction of the variance by the parameter alone; total: with its interactions) or
            `morris` (first: mean |elementary effect| [unit of the quantity per range]; total: their standard
            deviation).
        names, ranges: of the parameters.
        first, first_error, total, total_error: (p,), errors at 95 % (NaN if not available).
        runs, mean, std: number of runs, mean and standard deviation of the quantity over them.
    """

    method: str
    names: list[str]
    ranges: list[tuple[float, float]]
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    runs: int
    mean: float
    std: float

    #: Cases that fail are rejected before indices are computed.
    finite: ClassVar[bool] = True
    warnings: ClassVar[Sequence[str]] = ()

    def to_json(self) -> dict[str, Any]:
        """The fields."""
        return dataclasses.asdict(self)


def global_indices(
    function: Callable[[np.ndarray], np.ndarray],
    names: Sequence[str],
    box: Sequence[tuple[float, float]],
    method: str = "sobol",
    samples: int = 256,
    seed: int = 0,
) -> Global:
    """Sobol indices or Morris screening of a function of (cases, p) -> (cases,) over a box.

    Sobol takes `samples (p + 2)` runs (samples a power of 2), Morris `samples (p + 1)`.

    Raises:
        SceneError: an unknown method, or cases that failed.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270; Morris, Technometrics 33 (1991) 161-174.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r}; allowed: {', '.join(METHODS)}")
    problem = {"num_vars": len(names), "names": list(names), "bounds": [list(pair) for pair in box]}
    sobol = method == "sobol"
    if sobol and samples & (samples - 1):
        raise SceneError(f"samples: {samples}; allowed: a power of 2, such as {2 ** round(np.log2(samples))}")
    sampler, analyser = (extra(f"SALib.{part}.{method}", "sensitivity") for part in ("sample", "analyze"))
    more = {"calc_second_order": False} if sobol else {}
    points = sampler.sample(problem, samples, seed=seed, **more)
    values = np.asarray(function(points), float)
    bad = int(np.sum(~np.isfinite(values)))
    if bad:
        raise SceneError(f"samples: {bad} of {len(values)} cases failed. Use ranges in which every case runs")
    columns = [np.zeros(len(names))] * 4
    if np.ptp(values) <= 1e-12 * np.max(np.abs(values)):
        values = np.full_like(values, values.mean())
    elif sobol:
        found = analyser.analyze(problem, values, seed=seed, **more)
        columns = [np.asarray(found[key], float) for key in ("S1", "S1_conf", "ST", "ST_conf")]
    else:
        found = analyser.analyze(problem, points, values, seed=seed)
        columns = [np.asarray(found[key], float) for key in ("mu_star", "mu_star_conf", "sigma")]
        columns.append(np.full(len(names), np.nan))
    return Global(method, list(names), list(box), *columns, len(values), float(values.mean()), float(values.std()))


# Sensitivities as text for the terminal


def local_text(found: Local) -> str:
    """Derivatives as text, the largest first, and their range of validity."""
    order = np.argsort(-np.abs(found.scaled if np.isfinite(found.scaled).all() else found.forward))
    columns = {
        "parameter p": found.names,
        "value": [f"{x:.5g} {unit}" for x, unit in zip(found.values, found.units, strict=True)],
        f"dQ/dp [{found.unit} per unit of p]": [f"{x:.6g}" for x in found.forward],
        "p/Q dQ/dp [% per %]": [f"{x:.4g}" for x in found.scaled],
    }
    if not found.trusted:
        columns["window mean"] = [f"{x:.5g}" for x in found.window_mean]
        columns["std error"] = [f"{x:.2g}" for x in found.window_error]
    rows = [list(columns), *([column[i] for column in columns.values()] for i in order)]
    trust = (
        "over the whole run"
        if found.trusted
        else f"up to {found.horizon:.3g} s only: beyond, small changes grow more than 100 times"
    )
    rate = "" if found.exponent is None else f" (growth rate {found.exponent:.2g} per s)"
    pairs = [
        ("quantity Q", f"{found.of} = {found.value:.6g} {found.unit} over {found.duration:g} s"),
        ("derivatives valid", f"{trust}{rate}"),
    ]
    if found.mismatch is not None:
        pairs.append(("modes", f"forward and reverse differ by {found.mismatch:.1e}"))
    if not found.trusted:
        pairs.append(("windows", f"of {found.window:.3g} s: the quantity of each, averaged over the motion"))
    return f"{listing(pairs)}\n\n{table(rows)}"


def global_text(found: Global, of: str) -> str:
    """Indices as text, the largest first."""
    sobol = found.method == "sobol"
    rows = [
        [
            "parameter",
            "from",
            "to",
            *(("first", "+-", "total", "+-") if sobol else ("mean |effect|", "+-", "spread", "")),
        ]
    ]
    for i in np.argsort(-found.total if sobol else -found.first):
        numbers = (found.first[i], found.first_error[i], found.total[i], found.total_error[i])
        cells = ["" if np.isnan(x) else f"{x:.3g}" for x in numbers]
        rows.append([found.names[i], *(f"{x:.4g}" for x in found.ranges[i]), *cells])
    text = f"{of}: {found.runs} runs, mean {found.mean:.5g}, standard deviation {found.std:.3g}\n\n{table(rows)}"
    if sobol and np.max(found.total_error) > 0.2:  # of the variance: ranks are then chance
        more = 4 * found.runs // (len(found.names) + 2)
        text += f"\n\nintervals of +-{np.max(found.total_error):.2g} are wide; --samples {more} halves them"
    return text
