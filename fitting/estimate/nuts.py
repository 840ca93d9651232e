"""The posterior of parameters and window starts by Hamiltonian Monte Carlo (NUTS, Hoffman and Gelman 2014; blackjax).

    log pi(z, p) = -cost(z, p)/unit,      (z, p) = (z, p)_optimum + L'^-1 y,      L L' = H/unit

with H the Gauss-Newton matrix of the joined windows at the optimum, so that y is nearly standard normal. Unlike
importance sampling it does not assume that the motion is linear in its starts. Each leapfrog step costs an evaluation
of all windows.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular

from dropper_jax.base.errors import Progress, SceneError, silent
from fitting.estimate.gaps import GAP_SCALE, Joined
from fitting.estimate.loss import LEAST_SQUARES
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.posterior import Posterior
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import level_of
from fitting.estimate.uncertainty import degrees_of_freedom, uncertainty
from fitting.traces.planar import chart, wrap

#: Chains, and warm-up transitions of each that find the step size and are discarded: y is already nearly normal.
CHAINS, WARM_UP = 4, 60
#: Target acceptance rate, and first step size.
ACCEPTED, FIRST_LEAP = 0.95, 0.1
#: Ratio of the joint spread of the chains to that within each above which they do not agree.
AGREE = 1.01
#: Effective draws below which quantiles are unreliable.
ENOUGH = 400


@dataclass(frozen=True)
class Chains(Posterior):
    """Draws of several chains, one after another, all of equal weight.

    Attributes:
        rhat: R-hat of every parameter (k,).
        fewest_draws: minimum of the parameters' effective draws.
        divergent: transitions with divergent energy.
    """

    rhat: np.ndarray | None = None
    fewest_draws: float = 0.0
    divergent: int = 0

    @property
    def effective(self) -> float:
        return self.fewest_draws

    def to_json(self) -> dict[str, Any]:
        found = super().to_json()
        del found["pareto_k"]
        return found | {"r_hat": float(np.max(self.rhat)), "divergent": self.divergent, "chains": CHAINS}

    @property
    def warnings(self) -> list[str]:
        found = []
        if not np.max(self.rhat) <= AGREE:
            found.append(f"posterior: R-hat is {np.max(self.rhat):.3g}, the chains do not agree; allowed: {AGREE}")
        if self.divergent:
            found.append(f"posterior: {self.divergent} divergent transitions; its tails may be undersampled")
        if self.fewest_draws < ENOUGH:
            found.append(f"posterior: {self.fewest_draws:.0f} effective draws; quantiles unreliable below {ENOUGH}")
        return found


def nuts(solution: Solution, draws: int = 200, seed: int = 0, progress: Progress = silent) -> Chains:
    """Sample parameters and starts around a converged solution; returns `draws` of each of four chains.

    Raises:
        SceneError: blackjax is not installed, nothing is free, or the noise or the starts are of a kind that only
            importance sampling supports.
    """
    try:
        import blackjax
        from blackjax.adaptation.step_size import dual_averaging_adaptation
        from blackjax.diagnostics import effective_sample_size, potential_scale_reduction
    except ImportError:
        raise SceneError("sampler: 'nuts' needs blackjax. Use pip install 'dropper-jax[posterior]'") from None
    problem, free = solution.problem, np.flatnonzero(~solution.problem.held_mask)
    if not len(free):
        raise SceneError("posterior: no parameter is free; allowed: at least one")
    if (problem.noise is not None and problem.noise.kind != "white") or problem.loss != LEAST_SQUARES:
        raise SceneError("sampler: 'nuts' needs white noise and least squares. Use importance")
    if problem.simulator.release is not None:
        raise SceneError("sampler: 'nuts' needs runs with starts of their own. Use importance")
    target = Density(solution, free)
    to_moves, density = target.to_moves, target.function()

    kernel, unit = blackjax.nuts.build_kernel(), jnp.ones(len(to_moves))
    begin, learn, learnt = dual_averaging_adaptation(ACCEPTED)

    @jax.jit
    def chain(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        first, warm, run = jax.random.split(key, 3)
        state = blackjax.nuts.init(0.5 * jax.random.normal(first, (len(to_moves),)), density)

        def find(carry: Any, key: jax.Array) -> tuple[Any, None]:
            state, leap = carry
            state, info = kernel(key, state, density, jnp.exp(leap.log_step_size), unit)
            return (state, learn(leap, info.acceptance_rate)), None

        (state, leap), _ = jax.lax.scan(find, (state, begin(FIRST_LEAP)), jax.random.split(warm, WARM_UP))
        length = learnt(leap)

        def once(state: Any, key: jax.Array) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            state, info = kernel(key, state, density, length, unit)
            return state, (state.position @ jnp.asarray(to_moves[:, -len(free) :]), info.is_divergent)

        _, (found, divergent) = jax.lax.scan(once, state, jax.random.split(run, draws))
        return found, divergent

    keys = list(jax.random.split(jax.random.key(seed), CHAINS))
    progress(0.0, "posterior: compilation")
    run = chain.lower(keys[0]).compile()
    parts = []
    with ThreadPoolExecutor(min(CHAINS, os.cpu_count() or 1)) as side_by_side:
        for i, part in enumerate(side_by_side.map(lambda key: jax.block_until_ready(run(key)), keys)):
            progress((i + 1) / CHAINS, f"posterior: {i + 1} of {CHAINS} chains")
            parts.append(part)
    several, divergent = (np.stack(column) for column in zip(*parts, strict=True))
    points = solution.values[free] + several.reshape(-1, len(free))
    return Chains(
        tuple(solution.problem.parameters[i].name for i in free),
        points,
        np.full(len(points), 1 / len(points)),
        0.0,
        rhat=np.atleast_1d(np.asarray(potential_scale_reduction(several))),
        fewest_draws=float(np.min(np.asarray(effective_sample_size(several)))),
        divergent=int(np.sum(divergent)),
    )


def hessian(solution: Solution, free: np.ndarray) -> np.ndarray:
    """The Gauss-Newton matrix (K m2 + f, K m2 + f) of starts and free parameters."""
    problem = solution.problem
    system = level_of(problem, solution.gap_weight).system(solution.evaluation, solution.values)
    normal, below = system if isinstance(system, Joined) else (system, [])
    blocks = block_diag(*normal.A)
    m2 = normal.A.shape[1]
    for k, block in enumerate(below, start=1):
        here, before = slice(k * m2, (k + 1) * m2), slice((k - 1) * m2, k * m2)
        blocks[here, before], blocks[before, here] = block, block.T
    border = normal.B[..., free].reshape(-1, len(free))
    corner = (normal.C + problem.prior(solution.values).curvature)[np.ix_(free, free)]
    return np.block([[blocks, border], [border.T, corner]])


class Density:
    """The log density of y, with its gradient from the windows' own derivatives.

    Attributes:
        to_moves: (d, d), y @ to_moves are the moves of starts and free parameters.
    """

    def __init__(self, solution: Solution, free: np.ndarray) -> None:
        windows, problem, simulator = solution.windows, solution.problem, solution.problem.simulator
        self.problem, self.free, self.values = problem, free, solution.values
        self.unit = solution.chi2 / degrees_of_freedom(solution) * max(uncertainty(solution).inflation, 1.0) ** 2
        lower = cholesky(hessian(solution, free) / self.unit, lower=True)
        self.to_moves = solve_triangular(lower, np.eye(len(lower)), lower=True)
        self.start = tuple(map(jnp.asarray, solution.starts))
        self.basis = jnp.asarray(chart(simulator.model_at(solution.values), solution.starts.theta))
        self.follows = np.flatnonzero(windows.follows & (solution.gap_weight is not None))
        # the gap weight is 1 if windows are separate
        weight = level_of(self.problem, solution.gap_weight).weight
        scale = np.repeat(GAP_SCALE, self.basis.shape[2]) * weight
        self.scale = windows.gap_shares[:, None] * scale if len(self.follows) else scale[None]
        counts = windows.step_counts.astype(np.int32)
        inputs = (windows.theta, windows.weight, windows.index, windows.fraction, simulator.jumps(windows), counts)
        self.inputs = tuple(jnp.asarray(a) for a in inputs)
        # the programs may know more parameters than these
        self.all_values, self.where = simulator.all_values(solution.values)
        columns = np.concatenate([np.arange(simulator.freedoms), simulator.freedoms + self.where])
        self.seeds = jnp.asarray(np.eye(simulator.freedoms + len(self.all_values))[columns])
        self.counts = jnp.int32(windows.substeps), jnp.int32(windows.steps)
        on_grid = not windows.fraction.any()
        settings = {"stepper": simulator.stepper.plain, "dt": windows.dt, "capacity": windows.steps, "on_grid": on_grid}
        self.window = partial(simulator.window, **settings)

    def function(self) -> Callable[[jax.Array], jax.Array]:
        """y (d,) -> log pi, with its gradient as JAX's derivative."""

        @jax.custom_vjp
        def density(y: jax.Array) -> jax.Array:
            return self.value_and_gradient(y)[0]

        density.defvjp(self.value_and_gradient, lambda gradient, ct: (ct * gradient,))
        return density

    def value_and_gradient(self, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """log pi and its slope (d,); minus infinity if a step fails or a parameter is outside its bounds."""
        count, m = self.basis.shape[0], self.basis.shape[2]
        x = y @ jnp.asarray(self.to_moves)
        z, dp = x[: 2 * m * count].reshape(count, 2 * m), x[2 * m * count :]
        values = jnp.asarray(self.values).at[self.free].add(dp)
        turned = (jnp.einsum("kij,kj->ki", self.basis, part) for part in (z[:, :m], z[:, m:]))
        starts = tuple(a + b for a, b in zip(self.start, turned, strict=True))
        known = jnp.asarray(self.all_values).at[self.where].set(values)
        run = lambda window: self.window(known, self.seeds, *self.counts, *window)  # noqa: E731
        # number of windows in one batched evaluation
        found = Evaluation(*jax.lax.map(run, (*starts, self.basis, *self.inputs), batch_size=8))
        residual, jacobian = found.residual, found.jacobian
        cost, slope = 0.5 * jnp.sum(residual**2), jnp.einsum("ksni,ksn->ki", jacobian, residual)
        if len(self.follows):
            cost, slope = self._with_gaps(cost, slope, found)
        moved, prior = values - self.values, self.problem.prior(self.values)
        gradient = prior.gradient + prior.curvature @ moved
        more = prior.cost + 0.5 * (prior.gradient + gradient) @ moved
        slope = jnp.concatenate([slope[:, : 2 * m].ravel(), (slope[:, 2 * m :].sum(0) + gradient)[self.free]])
        low, high = self.problem.bounds(self.values)
        fine = jnp.isfinite(cost) & (found.failed.sum() == 0) & jnp.all((values >= low) & (values <= high))
        uphill = -(jnp.asarray(self.to_moves) @ slope) / self.unit
        return jnp.where(fine, -(cost + more) / self.unit, -jnp.inf), jnp.where(fine, uphill, 0.0)

    def _with_gaps(self, cost: jax.Array, slope: jax.Array, found: Evaluation) -> tuple[jax.Array, jax.Array]:
        right, left, n = self.follows, self.follows - 1, self.basis.shape[1]
        turn = jnp.swapaxes(self.basis[right], 1, 2)

        def to_chart(a: jax.Array | np.ndarray) -> jax.Array:
            return jnp.concatenate([turn @ a[:, :n], turn @ a[:, n:]], axis=1) / self.scale[..., None]

        off = found.end[left] - found.start[right]
        gap = to_chart(off.at[:, :n].set(wrap(off[:, :n]))[..., None])[..., 0]
        before, after = to_chart(found.end_jacobian[left]), to_chart(found.start_jacobian[right])
        slope = slope.at[left].add(jnp.einsum("gij,gi->gj", before, gap))
        slope = slope.at[right].add(-jnp.einsum("gij,gi->gj", after, gap))
        return cost + 0.5 * jnp.sum(gap**2), slope
