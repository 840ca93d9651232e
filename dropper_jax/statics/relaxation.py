"""Poses at rest by slow motion: a system that resists Newton falls through something viscous until it lies.

    c (r - r_0)/tau = F(r),    r_0 the pose before, c the weight of a mean link per its length

Each step is solved (implicit Euler), with the exact stiffness of all forces: drag and wetted shares turn with the
links, which couples neighbours and is left out of the network's matrix. tau grows where that is easy and falls where it
fails; as it grows a step becomes Newton's. Energy falls on the way, so that it ends in a stable pose. On the host, with
a sparse matrix from a handful of directional derivatives (nodes that no row has in common share one).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.programs import kept
from dropper_jax.model import Geometry, Graph, Model, State, state
from dropper_jax.statics.rest_problem import SMALLEST, force_scale
from dropper_jax.statics.system import REACH, unbalanced

if TYPE_CHECKING:
    from scipy.sparse import csc_array

#: Corrections until a pose counts as not found, and at most in a step.
CORRECTIONS, MOST = 3000, 8
#: Share of the forces at its beginning that a step may leave, and corrections of one that was easy.
LEFT, EASY = 1e-2, 3
#: Factors on tau after a step that was easy, one that was not, and one that failed.
LONGER, AS_LONG, SHORTER = 4.0, 1.5, 0.2
#: Least tau that is tried [s/s].
SHORTEST = 1e-8
#: Free nodes up to which stability is looked at, how negative a stiffness (over the weight of a link per its length)
#: may be for rounding, and the first displacement from an unstable pose, in lengths of a link.
FEW, ROUNDING, NUDGE = 200, 1e-6, 0.1


class Pattern(NamedTuple):
    """Which nodes' forces depend on which: entries (row, column), and a colour (free,) to each column."""

    row: np.ndarray
    column: np.ndarray
    colour: np.ndarray
    colours: int


@lru_cache(maxsize=64)
def pattern(geometry: Geometry, reach: int) -> Pattern:
    """Of forces that reach that many links far; columns that meet in no row share a colour."""
    from scipy.sparse import coo_array, eye_array  # noqa: PLC0415

    free = geometry.free
    if isinstance(geometry, Graph):
        first, last = geometry.first, geometry.last
    else:
        first, last = np.arange(free - 1), np.arange(1, free)
    inside = (first < free) & (last < free)
    first, last = first[inside], last[inside]
    beside = coo_array((np.ones(len(first)), (first, last)), shape=(free, free))
    near = (beside + beside.T + eye_array(free)).tocsr()
    far = near
    for _ in range(reach - 1):
        far = far @ near
    meeting = (far.T @ far).tocsr()
    colour = np.full(free, -1)
    for node in range(free):
        taken = colour[meeting.indices[meeting.indptr[node] : meeting.indptr[node + 1]]]
        colour[node] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    entries = far.tocoo()
    return Pattern(entries.row, entries.col, colour, int(colour.max(initial=0)) + 1)


@kept(brief=True)
def _columns(model: Model, s: State, loads: jax.Array, picked: jax.Array) -> jax.Array:
    """How unbalanced forces fall as nodes of one colour (colours, free) move along an axis (colours, 3, free, 3)."""

    def along(nodes: jax.Array, axis: jax.Array) -> jax.Array:
        force = lambda r: unbalanced(model, state(model, r, t=s.t), loads)[0]  # noqa: E731
        return jax.jvp(force, (s.r,), (nodes[:, None] * axis,))[1]

    axes = jnp.eye(3, dtype=model.dtype)
    return jax.vmap(lambda nodes: jax.vmap(lambda axis: along(nodes, axis))(axes))(picked)


def stiffness(model: Model, s: State, loads: jax.Array) -> csc_array:
    """How all forces fall as all places change (3 free, 3 free) [N/m], drag and contact included."""
    from scipy.sparse import csc_array  # noqa: PLC0415

    row, column, colour, colours = pattern(model.geometry, max(model.reach, 1))
    picked = (colour == np.arange(colours)[:, None]).astype(float)
    blocks = np.asarray(_columns(model, s, loads, jnp.asarray(picked, model.dtype)))[colour[column], :, row, :]
    axis = np.arange(3)
    rows = np.broadcast_to(3 * row[:, None, None] + axis, blocks.shape)
    columns = np.broadcast_to(3 * column[:, None, None] + axis[:, None], blocks.shape)
    return csc_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * len(colour),) * 2)


def relax(model: Model, s: State, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """The stable pose into which a system moves slowly from `s`, and its largest scaled unbalanced force."""
    scale, length = float(force_scale(model, np)), float(np.mean(np.asarray(model.line.length)))
    enough, tau, count = tolerance * scale, 1.0, 0
    s, force = _placed(model, s, np.asarray(s.r), loads)
    best = s, float(np.max(np.abs(force)))
    while count < CORRECTIONS and tau > SHORTEST and best[1] > enough:
        kappa = max(1.0 / tau, SMALLEST) * scale / length
        found, left, used = _moved(model, s, force, loads, kappa, REACH * length, enough)
        count += used
        if found is None:
            tau *= SHORTER
            continue
        s, force = found, left
        tau *= LONGER if used <= EASY else AS_LONG
        size = float(np.max(np.abs(force)))
        best = (s, size) if size < best[1] else best
    return best[0], best[1] / scale


def steadied(model: Model, s: State, residual: float, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """From a pose that is not stable to a stable one beside it, where slow motion finds one; else the pose as it is.

    A rope laid out along a current may rest in line with it, and drift aside at the least push.
    """
    way = parting(model, s, loads)
    if way is None:
        return s, residual
    nudge = NUDGE * float(np.mean(np.asarray(model.line.length))) * way
    for start in (s.r + nudge, s.r - nudge):
        found, size = relax(model, state(model, start, t=s.t), loads, tolerance)
        if size <= tolerance and parting(model, found, loads) is None:
            return found, size
    return s, residual


def parting(model: Model, s: State, loads: jax.Array) -> np.ndarray | None:
    """How a slow motion leaves a pose (free, 3), at most 1; None where it returns, or where nodes are many."""
    if model.free_nodes > FEW:
        return None
    values, vectors = np.linalg.eig(stiffness(model, s, loads).toarray())
    least = int(np.argmin(values.real))
    if values[least].real >= -ROUNDING * float(force_scale(model, np)) / float(np.mean(np.asarray(model.line.length))):
        return None
    way = vectors[:, least].real.reshape(s.r.shape)
    return way / np.max(np.abs(way))


def _moved(
    model: Model, s: State, force: np.ndarray, loads: jax.Array, kappa: float, reach: float, enough: float
) -> tuple[State | None, np.ndarray, int]:
    """The pose after one step (None: not solved), its forces (free, 3) [N], and the corrections that it took."""
    from scipy.sparse import eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    before, rows = np.asarray(s.r), -force
    limit = max(LEFT * float(np.max(np.abs(rows))), enough)
    last = np.inf
    for used in range(1, MOST + 1):
        matrix = stiffness(model, s, loads) + kappa * eye_array(rows.size)
        try:
            r = np.asarray(s.r) - splu(matrix.tocsc()).solve(rows.ravel()).reshape(rows.shape)
        except RuntimeError:  # singular
            return None, force, used
        if not np.max(np.abs(r - before)) <= reach:
            return None, force, used
        s, force = _placed(model, s, r, loads)
        rows = kappa * (r - before) - force
        size = float(np.max(np.abs(rows)))
        if size <= limit:
            return s, force, used
        if not size < 10.0 * last:
            return None, force, used
        last = size
    return None, force, MOST


def _placed(model: Model, s: State, r: np.ndarray, loads: jax.Array) -> tuple[State, np.ndarray]:
    """The state at places r (free, 3) with its tensions, and the unbalanced forces there."""
    s = state(model, jnp.asarray(r, model.dtype), t=s.t)
    rows, tension = unbalanced(model, s, loads)
    return state(model, s.r, tension=tension, t=s.t), -np.asarray(rows)
