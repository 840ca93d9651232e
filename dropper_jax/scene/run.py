"""`[run]` of a scene: step, duration and scheme."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    MOST,
    Plain,
    as_table,
    check_keys,
    count,
    field_keys,
    read_fields,
    read_number,
    read_table,
    refuse,
)

#: Linear solvers by name, as `dropper_jax.solvers` offers them; importing that would load scipy for every scene reader.
SOLVERS = ("auto", "dense", "banded", "condensed", "network")


@dataclasses.dataclass(frozen=True, eq=False)
class RunSpec:
    """`[run]`: how the scene is simulated unless the caller specifies otherwise."""

    dt: float = parameter("time step", unit="s", low=0.0, open_low=True)
    duration: float = parameter("simulated time", unit="s", low=0.0, open_low=True)
    integrator: str = option("integrator", type=str, default="energy_momentum")
    solver: str = option("linear solver", choices=SOLVERS, default="auto")
    dtype: str = option("precision", choices=("float64", "float32"), default="float64")
    save_every: int = count("steps between saved states", default=1)
    step_tolerance: float | None = parameter(
        "tolerance of the error indicator of adaptive steps", unit="m/s", low=0.0, open_low=True, optional=True
    )
    error_tolerance: float | None = parameter(
        "error per step of schemes with error control (tsit5, dop853): of positions [m] and velocities",
        unit="m/s",
        low=0.0,
        open_low=True,
        high=0.1,
        optional=True,
    )
    options: dict[str, float] = dataclasses.field(default_factory=dict)  # of the scheme, by name

    @property
    def saves(self) -> int:
        """Saved states after the start, which cover the duration; a remainder below 1e-9 steps is attributed to
        rounding."""
        return -(-math.ceil(self.duration / self.dt - 1e-9) // self.save_every)

    @property
    def steps(self) -> int:
        """Total number of steps, a multiple of `save_every`."""
        return self.saves * self.save_every

    @classmethod
    def read(cls, table: Plain, path: str, options: Mapping[str, Mapping[str, Any]] | None = None) -> RunSpec:
        """A checked `[run]`; `options` are the additional keys of schemes, name and range."""
        options = options or {}
        given = read_table(table, path)
        check_keys(given, [*field_keys(cls), *options], path)
        values = read_fields(cls, {key: value for key, value in given.items() if key not in options}, path, {})
        values["options"] = {
            key: read_number(given[key], f"{path}.{key}", declared) for key, declared in options.items() if key in given
        }
        if values["duration"] < values["dt"]:
            allowed = f"at least one step, {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], "is shorter than the step", allowed)
        if values["duration"] > MOST * values["dt"]:
            reason = f"takes {values['duration'] / values['dt']:.3g} steps of {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], reason, f"at most {MOST} steps")
        if values["step_tolerance"] is not None and values["save_every"] != 1:
            why = "cannot be combined with run.step_tolerance, which saves every dt"
            raise refuse(f"{path}.save_every", values["save_every"], why, "1")
        return cls(**values)

    def table(self) -> dict[str, Any]:
        """Plain values from which `read` recreates the section."""
        return {**as_table(self), **self.options}
