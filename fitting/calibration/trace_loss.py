"""The loss of a trace as a JAX function of the parameters: `loss(params)`, `jax.grad(loss)`, for any optimizer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.modelling.build import SceneLike
from fitting.estimate.window_run import run_window
from fitting.estimate.windows import Starts
from fitting.parameters.parameter import with_parameter_values
from fitting.parameters.targets import LOST
from fitting.traces import planar
from fitting.windows.preparation import TracesLike, prepare
from fitting.windows.prepared import Prepared

#: Gauss-Newton steps of the windows for one value with optimal starts: from the first starts, four leave 0.01 of
#: chi-square per window on noisy traces of the lab dropper.
START_STEPS = 6


class Blocks(NamedTuple):
    """A window at its best start so far.

    Attributes:
        z: coordinates of the start (m2,).
        cost: half of chi-square.
        A, B, C: Gauss-Newton blocks by the start (m2, m2), by start and parameters (m2, k), by the parameters (k, k).
        gz, gp: gradients of the cost by the start (m2,) and by the parameters (k,).
    """

    z: Array
    cost: Array
    A: Array
    B: Array
    C: Array
    gz: Array
    gp: Array


#: The best blocks so far, the next start and its damping.
Trial = tuple[Blocks, Array, Array]


class GaussNewton(NamedTuple):
    """A loss at parameters (k,): value, gradient (k,) and information (k, k), the starts of the windows eliminated."""

    value: Array
    gradient: Array
    information: Array


#: Damping of the first step of a start.
FIRST_DAMPING = 1e-3


def differentiable(evaluate: Callable[..., tuple[Array, ...]]) -> Callable[..., Array]:
    """The value of a function that returns its value and its slopes by its first arguments, which become derivatives.

    The rule is linear in the tangents, so that JAX can transpose it.
    """
    value = jax.custom_jvp(lambda *at: evaluate(*at)[0])

    @value.defjvp
    def rule(at: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
        found, *slopes = evaluate(*at)
        return found, sum(map(jnp.vdot, slopes, tangents), jnp.zeros_like(found))

    return value


class TraceLoss:
    """Half of chi-square of a trace's windows, `1/2 sum (simulated - measured)^2/sigma^2`, and the priors.

    Windows are separate, each with a start of its own; noise and first starts come from the samples. The object itself
    is a function of the parameters (k,) alone, with the starts at their optimum:

        loss(params),  jax.grad(loss)(params),  loss.gauss_newton(params)

    `loss.loss(params, starts)` is the same at given starts. All are pure JAX and work with `jax.jit`, `jax.grad` and
    `jax.vmap`. They have derivative rules of their own: the few derivatives of each window are taken in forward mode,
    as in a fit, also under `jax.grad`.

    Attributes:
        names: of the parameters.
        params: their start (k,); `low` and `high` are their bounds, `scale` their sizes.
        starts: first starts of the windows, angles [rad] and rates [rad/s], each (windows, links).
        samples: total number of measured angles; the loss of a correct model is half of it.
        prepared: windows, noise and model as `fit` would use them.
    """

    def __init__(self, prepared: Prepared) -> None:
        self.prepared = prepared
        windows = prepared.windows
        self.names = tuple(prepared.names)
        self.params = jnp.asarray(prepared.values)
        self.low = jnp.array([p.low for p in prepared.parameters])
        self.high = jnp.array([p.high for p in prepared.parameters])
        self.scale = jnp.array([p.scale for p in prepared.parameters])
        self.starts = Starts(*map(jnp.asarray, prepared.starts))
        self.samples = windows.samples
        own = prepared.simulator
        self._window = partial(
            run_window,
            model=own.model,
            parameters=prepared.parameters,
            release=None,
            stepper=own.stepper,
            dt=windows.dt,
            capacity=windows.steps,
            on_grid=not windows.fraction.any(),
        )
        samples = (windows.theta, windows.weight, windows.index, windows.fraction, own.jumps(windows))
        self._samples = tuple(jnp.asarray(a) for a in (*samples, windows.step_counts.astype(np.int32)))
        self._basis = jnp.asarray(planar.chart(own.model_at(prepared.values), prepared.starts.theta))
        self._cost = differentiable(self._half_square)
        self.loss = jax.jit(self._loss)
        self.gauss_newton = jax.jit(self._gauss_newton)
        self._moved_starts = jax.jit(self._move_starts)
        self._value = differentiable(self.value_and_grad)

    def __call__(self, params: Array) -> Array:
        """The loss at parameters (k,) with the starts at their optimum; `jax.grad` gives its gradient."""
        return self._value(params)

    def _loss(self, params: Array, starts: Starts[Array]) -> Array:
        """Half of chi-square and the priors, at parameters (k,) and starts."""
        cost = jax.vmap(self._cost, in_axes=(None, *(0 for _ in range(8))))(params, *starts, *self._samples)
        return jnp.sum(cost) + self._prior(params)

    def _gauss_newton(self, params: Array, starts: Starts[Array] | None = None) -> GaussNewton:
        """The loss with the starts at their optimum, its gradient and information by the parameters (k,).

        The elimination is written in JAX: a `lax.scan` of `START_STEPS` damped Gauss-Newton steps of every window's
        start, from `starts` on. The gradient is the partial one at that optimum (the envelope theorem), corrected to
        first order for the remaining slope of the starts. Use it directly; do not differentiate it again.
        """
        best = self._best(params, starts)
        rows = jnp.concatenate([best.B, best.gz[..., None]], axis=-1)
        inner = jnp.linalg.solve(self._regular(best.A), rows)
        eliminated = jnp.einsum("kij,kil->jl", best.B, inner)
        prior, slope = jax.value_and_grad(self._prior)(params)
        gradient = jnp.sum(best.gp, axis=0) - eliminated[:, -1] + slope
        information = jnp.sum(best.C, axis=0) - eliminated[:, :-1] + jax.hessian(self._prior)(params)
        return GaussNewton(jnp.sum(best.cost) + prior, gradient, information)

    def value_and_grad(self, params: Array, starts: Starts[Array] | None = None) -> tuple[Array, Array]:
        """The loss with the starts at their optimum and its gradient (k,), as of `gauss_newton`."""
        found = self.gauss_newton(params, starts)
        return found.value, found.gradient

    def best_starts(self, params: Array, starts: Starts[Array] | None = None) -> Starts[Array]:
        """The starts at their optimum for these parameters, for example for the next call of `value_and_grad`."""
        return self._moved_starts(params, starts or self.starts)

    def _move_starts(self, params: Array, first: Starts[Array]) -> Starts[Array]:
        model = with_parameter_values(self.prepared.simulator.model, self.prepared.parameters, params)
        z = self._best(params, first).z
        moves = jnp.einsum("kij,ksj->ski", self._basis, z.reshape(len(z), 2, -1))  # of angles and of rates
        moved = (start + move for start, move in zip(first, moves, strict=True))
        return Starts(*jax.vmap(partial(planar.close_chain, model))(*moved))

    def _derivatives(
        self, params: Array, theta: Array, omega: Array, basis: Array, *samples: Array
    ) -> tuple[Array, Array]:
        """Residuals (r,) of one window, and their derivatives (r, 2 m + k) by its start along the basis (n, m) and by
        the parameters, as a fit computes them."""
        windows = self.prepared.windows
        seeds = jnp.eye(2 * basis.shape[1] + len(params), dtype=params.dtype)
        steps = jnp.int32(windows.substeps), jnp.int32(windows.steps)
        found = self._window(params, seeds, *steps, theta, omega, basis, *samples)
        return found[1].ravel(), found[2].reshape(-1, len(seeds))

    def _half_square(self, params: Array, theta: Array, omega: Array, *samples: Array) -> tuple[Array, ...]:
        """Half of chi-square of one window, and its slopes by the parameters, angles and rates."""
        r, slope = self._derivatives(params, theta, omega, jnp.eye(len(theta)), *samples)
        by_theta, by_omega, by_params = jnp.split(r @ slope, (len(theta), 2 * len(theta)))
        return 0.5 * jnp.sum(r**2), by_params, by_theta, by_omega

    def _prior(self, params: Array) -> Array:
        """Half of the squared distances from the priors."""
        total = jnp.zeros((), params.dtype)
        for i, p in enumerate(self.prepared.parameters):
            if p.prior is not None:
                mean, sigma = p.prior
                total += ((params[i] - mean) / sigma) ** 2
        for each in self.prepared.known.common:
            total += ((each.share @ params - 1) / each.sigma) ** 2
        return 0.5 * total

    def _best(self, params: Array, starts: Starts[Array] | None) -> Blocks:
        """Every window at the best start found, beginning at `starts`."""
        starts = starts or self.starts
        return jax.vmap(partial(self._best_start, params))(*starts, self._basis, *self._samples)

    def _best_start(self, params: Array, theta: Array, omega: Array, basis: Array, *measured: Array) -> Blocks:
        """Levenberg and Marquardt's method for the start of one window, in the chart around (theta, omega)."""
        m = basis.shape[1]

        def blocks(z: Array) -> Blocks:
            at = theta + basis @ z[:m], omega + basis @ z[m:]
            r, slope = self._derivatives(params, *at, basis, *measured)
            own = slope[:, : 2 * m]
            shared = slope[:, 2 * m :]
            cross = own.T @ shared
            return Blocks(z, 0.5 * r @ r, own.T @ own, cross, shared.T @ shared, own.T @ r, shared.T @ r)

        def trial(carry: Trial, _: None) -> tuple[Trial, None]:
            best, z, damping = carry
            found = blocks(z)
            better = found.cost < best.cost
            best = jax.tree.map(lambda new, old: jnp.where(better, new, old), found, best)
            damping = jnp.where(better, 0.1 * damping, 10.0 * damping)
            diagonal = jnp.diag(jnp.diag(best.A))
            step = jnp.linalg.solve(self._regular(best.A) + damping * diagonal, best.gz)
            return (best, best.z - step, damping), None

        z = jnp.zeros(2 * m, params.dtype)
        nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(blocks, z))._replace(cost=jnp.asarray(jnp.inf))
        return jax.lax.scan(trial, (nothing, z, jnp.asarray(10 * FIRST_DAMPING)), None, length=START_STEPS)[0][0]

    @staticmethod
    def _regular(A: Array) -> Array:
        """A matrix that can be inverted even if a direction of a start shows in no sample."""
        size = jnp.trace(A, axis1=-2, axis2=-1)[..., None, None]
        return A + (1e-12 * size + 1e-300) * jnp.eye(A.shape[-1], dtype=A.dtype)


def loss_of_trace(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    **options: Any,
) -> TraceLoss:
    """The loss of traces as a function of the parameters, in pure JAX: `loss(params)` and `jax.grad(loss)(params)`.

    Args:
        traces, scene, free: as of `fit`.
        **options: of `prepare`: `start`, `bounds`, `priors`, `until`, `held_out`, `settings`.

    Returns:
        The loss, with `params` and `scale` to start from.

    Raises:
        SceneError: what `prepare` rejects; parameters of a release or of lost frames, and a static start, whose windows
            have no start; poses at rest, which this loss does not have.
    """
    prepared = prepare(traces, scene, free, **options)
    for name in prepared.names:
        if name.startswith(("release.", LOST)):
            raise SceneError(f"free: {name!r} cannot be part of this loss. Use parameters of the model, or `fit`")
    if prepared.simulator.release is not None:
        raise SceneError("static_start: cannot be part of this loss. Leave it out, or use `fit`")
    if prepared.rest is not None:
        raise SceneError("rest: poses at rest cannot be part of this loss. Leave them out, or use `fit`")
    return TraceLoss(prepared)
