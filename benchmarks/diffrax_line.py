"""The line as an ordinary differential equation for diffrax, in two formulations.

`angles`: minimal coordinates of a planar line, one angle per link, `d = L (cos a, 0, sin a)`, dense mass matrix
bordered by the two rows that close the loop (index reduced). What one writes first:

    [M  -C'] [a'']   [-h - g]          M_ij = mu_ij L_i L_j cos(a_i - a_j),  mu_ij = mass beyond links i and j
    [C   0 ] [ l ] = [ turn ]          C: derivative of the fixed end by the angles; rows only if an end is fixed

`tridiagonal`: the equations of this package, state (r,
v). The tensions follow from "no link's length accelerates", one scalar
tridiagonal system per evaluation, so that no algebraic equation is left (index reduction; link lengths drift by the
integration error, which is small over the spans compared). Forces are those of the effects of this package.

`cyclic`: the same with the cyclic reduction of this package instead of LAPACK, so that runs of diffrax are also
compiled to one kernel.
"""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import tridiagonal_solve
from peer_row import peer_row, time_runs

from dropper_jax.integrators.projected_runge_kutta import solve_motion
from dropper_jax.model import Model, State
from dropper_jax.study.march import link_vectors
from dropper_jax.study.reference import Reference

NAME = "diffrax"
SOLVERS = ("Tsit5", "Dopri5", "Dopri8", "Kvaerno5")
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)


def refuse(model: Model, s: State) -> str | None:
    """Why this model cannot be written as such an equation, or None."""
    try:
        import diffrax  # noqa: F401
    except ImportError:
        return "diffrax is not installed (extra `peers`)"
    if model.line.compound or model.line.axial.elastic or model.laws or model.has_moving_ends:
        return "only rigid links with point masses, still ends and smooth forces are written for diffrax"
    return None


def derivative(t: jax.Array, y: tuple[jax.Array, jax.Array], model: Model) -> tuple[jax.Array, jax.Array]:
    """(r', v') of free nodes (nodes, 3): `m a = F + G' T`, with T from `d . d'' + |d'|^2 = 0`."""
    r, v = y
    k = model.instant(r, v, t)
    inverse = 1.0 / model.line.mass[: model.free_nodes]
    unit = k.links / model.line.length[:, None]
    free = model.force(k) * inverse[:, None]
    zero = jnp.zeros_like(free[:1])
    bend = jnp.diff(jnp.concatenate([zero, free, zero] if model.both_ends_fixed else [zero, free]), axis=0)
    rate = k.link_velocities
    rhs = jnp.sum(unit * bend, axis=-1) + jnp.sum(rate * rate, axis=-1) / model.line.length
    near = jnp.concatenate([jnp.zeros(1), inverse])[: model.line.links]
    far = jnp.concatenate([inverse, jnp.zeros(1)])[: model.line.links]
    off = -jnp.sum(unit[:-1] * unit[1:], axis=-1) * near[1:]
    none = jnp.zeros(1)
    tension = tridiagonal_solve(jnp.concatenate([none, off]), near + far, jnp.concatenate([off, none]), rhs[:, None])[
        :, 0
    ]
    return v, free + model.tension_force(tension, unit) * inverse[:, None]


def with_ours(t: jax.Array, y: tuple[jax.Array, jax.Array], model: Model) -> tuple[jax.Array, jax.Array]:
    """The same with the tensions by cyclic reduction."""
    return y[1], solve_motion(model, *y, t, False).acceleration


def rows(model: Model, s: State, target: Reference) -> list[dict[str, Any]]:
    """One row per formulation, solver and tolerance (relative and absolute alike)."""
    kinds = ["tridiagonal"] + (["angles"] if refuse_angles(model, s) is None else [])
    cases = [*itertools.product(kinds, SOLVERS, TOLERANCES)]
    # an implicit solver factors dense matrices by LAPACK in any case
    cases += itertools.product(["cyclic"], SOLVERS[:3], TOLERANCES)
    return [_row(model, s, target, *case) for case in cases]


def refuse_angles(model: Model, s: State) -> str | None:
    """Why the model cannot be written so, or None."""
    if [e.name for e in model.effects] != ["weight"] or model.effects[0].wet_weight is not None:
        return "only weight in air is written in angles"
    links = link_vectors(model, np.asarray(s.r)[None], np.zeros(1))
    flat = np.max(np.abs(links[..., 1])) == 0 and np.max(np.abs(np.asarray(s.v))) == 0
    if flat:
        return None
    return "only planar starts at rest are written in angles"


def angles_at_start(model: Model, s: State) -> tuple[jax.Array, jax.Array]:
    """Angles and rates (n,) [rad], [rad/s]."""
    links = model.links(s.r, model.ends(s.t))
    angles = jnp.arctan2(links[:, 2], links[:, 0])
    return angles, jnp.zeros_like(angles)


def positions_of_angles(model: Model, angles: jax.Array) -> jax.Array:
    """Free nodes (nodes, 3) [m]."""
    unit = jnp.stack([jnp.cos(angles), jnp.zeros_like(angles), jnp.sin(angles)], axis=-1)
    return (model.ends(0.0).start + jnp.cumsum(model.line.length[:, None] * unit, axis=0))[: model.free_nodes]


def angle_derivative(t: jax.Array, y: tuple[jax.Array, jax.Array], model: Model) -> tuple[jax.Array, jax.Array]:
    """(a', a'')."""
    angles, rates = y
    n = model.line.links
    length = model.line.length
    mass = jnp.where(jnp.arange(n) < model.free_nodes, model.line.mass, 0.0)
    beyond = jnp.cumsum(mass[::-1])[::-1]
    shared = jnp.minimum(beyond[:, None], beyond[None, :]) * length[:, None] * length[None, :]
    turn = angles[:, None] - angles[None, :]
    matrix = shared * jnp.cos(turn)
    load = -(shared * jnp.sin(turn)) @ rates**2 - model.effects[0].gravity * beyond * length * jnp.cos(angles)
    if not model.both_ends_fixed:
        return rates, jnp.linalg.solve(matrix, load)
    close = length * jnp.stack([-jnp.sin(angles), jnp.cos(angles)])
    bend = (length * jnp.stack([jnp.cos(angles), jnp.sin(angles)])) @ rates**2
    whole = jnp.block([[matrix, -close.T], [close, jnp.zeros((2, 2))]])
    return rates, jnp.linalg.solve(whole, jnp.concatenate([load, bend]))[:n]


DERIVATIVES = {"tridiagonal": derivative, "cyclic": with_ours, "angles": angle_derivative}


@partial(jax.jit, static_argnums=(0, 1))
def _solve(kind: str, solver: str, model: Model, s: State, t: jax.Array, tolerance: jax.Array) -> tuple[Any, Any, Any]:
    import diffrax

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(DERIVATIVES[kind]),
        getattr(diffrax, solver)(),
        t0=0.0,
        t1=t[-1],
        dt0=None,
        y0=angles_at_start(model, s) if kind == "angles" else (s.r, s.v),
        args=model,
        saveat=diffrax.SaveAt(ts=t),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        max_steps=40_000,
        throw=False,
    )
    if kind == "angles":
        r = jax.vmap(partial(positions_of_angles, model))(solution.ys[0])
    else:
        r = solution.ys[0]
    return r, solution.stats["num_steps"], solution.result == diffrax.RESULTS.successful


def _row(model: Model, s: State, target: Reference, kind: str, solver: str, tolerance: float) -> dict[str, Any]:
    run = lambda: jax.block_until_ready(_solve(kind, solver, model, s, jnp.asarray(target.t), tolerance))  # noqa: E731
    run()
    (r, steps, fine), wall = time_runs(run)
    return peer_row(model, f"diffrax {kind} {solver}", kind, np.asarray(r), int(steps), wall, target, bool(fine))
