"""Whether damping, not the error, limits the steps of a run that follows an accuracy with an explicit scheme."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.numerics import local_jacobian
from dropper_jax.model import Model
from dropper_jax.model.slots import Force
from dropper_jax.residual import Embedded
from dropper_jax.run.row_store import Rows

#: Number of saved times whose damping rates are checked.
CHECKED_TIMES = 64
#: Fraction of the stability limit above which it counts as limiting the steps: the step error keeps them below it.
LIMITING = 0.6


def damping_warnings(scheme: Embedded, model: Model, r: Rows, v: Rows, t: np.ndarray, h: np.ndarray) -> tuple[str, ...]:
    """A warning if damping limits most steps h (k,) [s] of a run with states (k, ...) at its saved times."""
    if not len(t):
        return ()
    rows = np.unique(np.linspace(0, len(t) - 1, CHECKED_TIMES).round().astype(int))
    rates = _damping_rates(model, *(jnp.asarray(a[rows], model.dtype) for a in (r, v, t)))
    sizes = {name: float(np.median(h[rows] * np.asarray(rate))) for name, rate in rates.items()}
    name = max(sizes, key=lambda effect: sizes[effect], default=None)
    if name is None or sizes[name] < LIMITING * scheme.stable:
        return ()
    return (
        f"effects.{name}: h b/m is {sizes[name]:.2g} on average, and {scheme.name} is stable up to about "
        f"{scheme.stable:g}: damping, not the error, limits the steps. Use energy_momentum",
    )


@cached_jit()
def _damping_rates(model: Model, r: Array, v: Array, t: Array) -> dict[str, Array]:
    """Maximum damping rate (k,) [1/s] over the nodes of each damping effect, at instants (k, ...)."""
    found = {}
    for effect in model.effects_with(Force):
        if effect.constant:
            continue
        rates = jax.vmap(partial(_damping_rate, model, effect))(r, v, t)
        if effect.reach:
            # ratio of the damping rate of coupled nodes to that of a single node: a row of equal dampers between nodes
            # has eigenvalues up to twice its diagonal
            rates = 2.0 * rates
        found[effect.name] = rates
    return found


def _damping_rate(model: Model, effect: Force, r: Array, v: Array, t: Array) -> Array:
    """The maximum over the nodes of the eigenvalues of `-dF/dv/m` [1/s], symmetric part, at one instant."""
    k = model.instant(r, v, t)
    blocks = local_jacobian(lambda v: effect.force(k.with_velocity(v)), v)
    even = -0.5 * (blocks + jnp.swapaxes(blocks, 1, 2)) / model.node_mass[:, None, None]
    return jnp.maximum(jnp.max(jnp.linalg.eigvalsh(even)), 0.0)
