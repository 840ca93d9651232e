"""The result of a search for an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State, state


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["positions", "tension", "residual", "state"],
    meta_fields=["status", "message"],
)
@dataclass(frozen=True)
class Equilibrium:
    """A static equilibrium; a traced one contains traced arrays.

    Attributes:
        positions: nodes (n + 1, 3) [m]; of a system those of all lines, line after line.
        tension: links (n,) [N].
        residual: maximum scaled row.
        status: `ok` or `not_converged`; `traced` inside JAX's transformations, in which a failed search gives NaN.
        message: the reason of a failure, else empty.
        state: the equilibrium as a `State` at rest.
    """

    positions: np.ndarray
    tension: np.ndarray
    residual: float
    status: str
    message: str
    state: State = field(repr=False)


@cached_jit()
def node_positions(model: Model, s: State) -> Array:
    """Positions of all nodes (n + 1, 3) [m]."""
    return model.nodes(s.r, model.ends(s.t))


def equilibrium_at(model: Model, s: State, residual: float, message: str) -> Equilibrium:
    """The equilibrium; a `message` is the reason of a failure."""
    s = state(model, s.r, tension=s.tension, t=s.t)
    return Equilibrium(
        positions=np.asarray(node_positions(model, s)),
        tension=np.asarray(s.tension),
        residual=residual,
        status="not_converged" if message else "ok",
        message=message,
        state=s,
    )
