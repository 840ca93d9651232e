"""Angles of the line at rest as functions of the parameters, with derivatives by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax import statics
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.traces import planar


class StaticPoses:
    """Static poses of a model with these parameters, each solved from the last one.

    Args:
        refusal: message if there is no pose at the first values, with `{}` for the reason.
        loads: forces [N] on the nodes by the model, the values (k,) and the number of a run; None: none.
        view: the angles as they are seen, by the model, the values and the angles (n,).
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        refusal: str,
        loads: Callable[[Model, Array, int], Array | None] = lambda model, values, run: None,
        view: Callable[[Model, Array, Array], Array] = lambda model, values, theta: theta,
    ) -> None:
        self.model = model
        self.refusal = refusal
        self._near: dict[int, State] = {}

        def loaded(values: Array, run: int) -> tuple[Model, Array | None]:
            changed = with_parameter_values(model, parameters, values)
            return changed, loads(changed, values, run)

        def angles(values: Array, near: State, run: int) -> tuple[Array, tuple[Array, State]]:
            changed, forces = loaded(values, run)
            s = statics.settle(changed, near, forces)
            theta = view(changed, values, planar.from_nodes(changed, s.r, jnp.zeros_like(s.r))[0])
            return theta, (theta, s)

        self._loaded = loaded
        self._solve = jax.jit(jax.jacfwd(angles, has_aux=True), static_argnums=2)

    def pose(self, values: np.ndarray, run: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Angles (n,) and their derivatives (n, k) at these values (k,).

        Raises:
            SceneError: no static pose at the first values.
        """
        at = jnp.asarray(values)
        if run not in self._near:
            found = statics.equilibrium(*self._loaded(at, run))
            if found.status != "ok" or found.state is None:
                raise SceneError(self.refusal.format(found.message))
            self._near[run] = found.state
        slope, (theta, state) = self._solve(at, self._near[run], run)
        if np.isfinite(theta).all():
            self._near[run] = state
        return np.asarray(theta), np.asarray(slope)
