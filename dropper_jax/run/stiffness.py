"""Whether damping holds the steps of an explicit scheme: `h b/m`, b/m the rate at which an effect stops a node."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.programs import kept
from dropper_jax.integrators.projected import ProjectedRungeKutta
from dropper_jax.model import Model
from dropper_jax.model.slots import Force
from dropper_jax.residual import node_blocks

#: Saved times looked at.
INSTANTS = 64
#: Share of the bound of stability from which steps are held by it: the error of the step keeps them below it.
HELD = 0.6
#: Rates of what couples neighbours over those of a node alone: a row of equal dampers between nodes has eigenvalues up
#: to twice its diagonal.
COUPLED = 2.0


def damping_rates(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> dict[str, jax.Array]:
    """Rate (k,) [1/s] at which each effect that damps would stop the node it stops first, at instants (k, ...)."""
    found = {}
    for effect in model.having(Force):
        if not effect.constant:
            rates = jax.vmap(lambda r, v, t, e=effect: _rate(model, e, r, v, t))(r, v, t)
            found[effect.name] = (COUPLED if effect.reach else 1.0) * rates
    return found


def _rate(model: Model, effect: Force, r: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
    k = model.instant(r, v, t)
    blocks = node_blocks(lambda x: effect.force(k.with_velocity(v + x)), model.free_nodes, v.dtype)
    even = -0.5 * (blocks + jnp.swapaxes(blocks, 1, 2)) / model.node_mass[:, None, None]
    return jnp.maximum(jnp.max(jnp.linalg.eigvalsh(even)), 0.0)


_rates = kept(brief=True)(damping_rates)


def stiffness_remarks(
    scheme: ProjectedRungeKutta, model: Model, r: np.ndarray, v: np.ndarray, t: np.ndarray, h: np.ndarray
) -> tuple[str, ...]:
    """A remark where damping holds most steps h (k,) [s] of a run with states (k, ...) at its saved times."""
    if not len(t):
        return ()
    rows = np.unique(np.linspace(0, len(t) - 1, INSTANTS).round().astype(int))
    rates = _rates(model, *(jnp.asarray(a[rows], model.dtype) for a in (r, v, t)))
    sizes = {name: float(np.median(h[rows] * np.asarray(rate))) for name, rate in rates.items()}
    name = max(sizes, key=sizes.get, default=None)
    if name is None or sizes[name] < HELD * scheme.stable:
        return ()
    return (
        f"effects.{name}: h b/m is {sizes[name]:.2g} in the mean, and {scheme.name} is stable to about "
        f"{scheme.stable:g}: damping, not the error, holds its steps; take energy_momentum",
    )
