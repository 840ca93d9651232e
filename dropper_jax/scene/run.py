"""`[run]` of a scene: step, duration and scheme."""

from __future__ import annotations

import dataclasses
from typing import Any

from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import count, read_fields, refuse

#: Linear solvers by name, as `dropper_jax.solvers` offers them, which would bring scipy to every reader of a scene.
SOLVERS = ("auto", "dense", "banded", "condensed", "network")


@dataclasses.dataclass(frozen=True, eq=False)
class RunSpec:
    """`[run]`: how the scene is simulated unless the caller says otherwise."""

    dt: float = parameter("time step", unit="s", low=0.0, open_low=True)
    duration: float = parameter("simulated time", unit="s", low=0.0, open_low=True)
    integrator: str = option("integrator", type=str, default="energy_momentum")
    solver: str = option("linear solver", choices=SOLVERS, default="auto")
    dtype: str = option("precision", choices=("float64", "float32"), default="float64")
    gamma: float | None = parameter(
        "weight of the new time in the theta schemes", unit="-", low=0.0, high=1.0, optional=True
    )
    rho_infinity: float | None = parameter(
        "what a step of generalized_alpha leaves of the fastest vibrations", unit="-", low=0.0, high=1.0, optional=True
    )
    save_every: int = count("steps between saved states", default=1)

    @classmethod
    def read(cls, table: Any, path: str) -> RunSpec:
        values = read_fields(cls, table, path, {})
        if values["duration"] < values["dt"]:
            allowed = f"at least one step, {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], "is shorter than the step", allowed)
        return cls(**values)
