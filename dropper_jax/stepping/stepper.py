"""Static settings of the stepping, and the report of a step."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.backend.one_kernel import inside, is_inside
from dropper_jax.model import Model
from dropper_jax.residual import Integrator

#: Tolerance: maximum scaled residual row of a converged step. Rounding gives about 1e-14 (7 links) to
#: 1e-12 (1000 links, nodes far from the origin) in float64; in float32 about 1e-5.
TOLERANCE = {"float64": 1e-11, "float32": 1e-4}


#: Residual assigned to a step in which nodes moved farther than an effect can follow (`model.LimitsTimeStep`).
TOO_FAR = 1e30
FULL_STEP = -1  # level of a step that needed no retry


@dataclass(frozen=True)
class Stepper:
    """Static settings of the stepping.

    Attributes:
        integrator: the scheme.
        solver, fallback: names of the first and the last-resort linear solver.
        iterations: Newton iterations of every step.
        tolerance: maximum scaled residual of a converged step; None means `TOLERANCE` of the model's precision.
        extra: further iterations of the first solver before the fallback.
        halvings: maximum number of halvings of a step; 0 disables retries.
        track_work: count the work of each effect in `State.work`.
        until_converged: iterate each step until it has converged, at most `iterations` times, and halve it if it has
        not;
            for systems of lines.
        reverse: derivatives in both modes; False means forward mode only and leaves the transposed step out of all
        traces.
        batched: the step is in a batch, which is not compiled to one kernel: the library of the device solves its
        systems.
        one_kernel: whether tridiagonal systems are solved in the form that one kernel can contain; None: where the
            stepping is traced by `dj.one_kernel`.
    """

    integrator: Integrator
    solver: str
    fallback: str
    iterations: int
    tolerance: float | None = None
    extra: int = 48
    halvings: int = 6
    track_work: bool = True
    until_converged: bool = False
    reverse: bool = True
    batched: bool = False
    one_kernel: bool | None = None

    @property
    def plain(self) -> Stepper:
        """The same settings without fallback solvers: a quarter of the code to compile."""
        return replace(self, extra=0, halvings=0) if self.iterations else self

    @property
    def as_traced(self) -> Stepper:
        """The same settings with the choice of `one_kernel` for what is being traced, as part of all cached traces."""
        return self if self.one_kernel is not None else replace(self, one_kernel=is_inside())

    def solving(self) -> AbstractContextManager[None]:
        """Trace the systems of a step in the chosen form."""
        return inside(False if self.batched else self.one_kernel)

    def limit(self, model: Model) -> float:
        return TOLERANCE[str(jnp.dtype(model.dtype))] if self.tolerance is None else self.tolerance


class Report(NamedTuple):
    """Result of a step.

    Attributes:
        residual: maximum scaled row at its end (NaN if not finite).
        level: -1 if the step converged at once, k >= 0 if it needed 2^k substeps of the fallback solver.
    """

    residual: jax.Array
    level: jax.Array
