"""`[run]` of a scene: step, duration and scheme."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import count, read_fields, refuse


@dataclasses.dataclass(frozen=True, eq=False)
class RunSpec:
    """`[run]`: how the scene is simulated unless the caller says otherwise."""

    dt: float = parameter("time step", unit="s", low=0.0, open_low=True)
    duration: float = parameter("simulated time", unit="s", low=0.0, open_low=True)
    integrator: str = option("integrator", type=str, default="energy_momentum")
    solver: str = option("linear solver", type=str, default="auto")
    dtype: str = option("precision", choices=("float64", "float32"), default="float64")
    gamma: float | None = parameter(
        "weight of the new time in the theta schemes", unit="-", low=0.0, high=1.0, optional=True
    )
    rho_infinity: float | None = parameter(
        "what a step of generalized_alpha leaves of the fastest vibrations", unit="-", low=0.0, high=1.0, optional=True
    )
    save_every: int = count("steps between saved states", default=1)

    @property
    def saves(self) -> int:
        """Saved states after the start, which cover the duration; a remainder below 1e-9 steps is rounding."""
        return -(-math.ceil(self.duration / self.dt - 1e-9) // self.save_every)

    @property
    def steps(self) -> int:
        """Steps in all, a multiple of `save_every`."""
        return self.saves * self.save_every

    @classmethod
    def read(cls, table: Any, path: str) -> RunSpec:
        values = read_fields(cls, table, path, {})
        if values["duration"] < values["dt"]:
            allowed = f"at least one step, {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], "is shorter than the step", allowed)
        return cls(**values)
