"""What a fit to channels gives back: numbers with errors, what is not determined, the fitted scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dropper_jax.base.json_values import SCHEMA, jsonable
from dropper_jax.load.scene import Scene
from fitting.channels.between import Between
from fitting.channels.errors import Errors
from fitting.channels.free import placed
from fitting.estimate.problem import Solution
from fitting.parameters.fitted import fitted_scene
from fitting.parameters.parameter import Parameter


@dataclass
class ChannelFit:
    """A scene fitted to channels.

    Attributes:
        scene: as it was given.
        solution: where the fit ended.
        errors: of the parameters.
        between: parameters that each run has for itself, over the runs.
        seconds: wall time.
    """

    scene: Scene
    solution: Solution
    errors: Errors
    between: tuple[Between, ...] = ()
    seconds: float = 0.0
    warnings: list[str] = field(default_factory=list)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What was free."""
        return self.solution.problem.parameters

    @property
    def values(self) -> np.ndarray:
        """The estimates (p,)."""
        return self.solution.values

    @property
    def step_bias(self) -> np.ndarray | None:
        """How far the step moves the estimates (p,) [standard errors]; None where it was not looked at."""
        return self.solution.step_bias

    @property
    def status(self) -> str:
        """`ok` or `not_converged`."""
        return self.solution.status

    @property
    def message(self) -> str:
        return self.solution.message

    @property
    def outcome(self) -> str:
        """Status and message in one line."""
        return f"{self.status}: {self.message}" if self.message else self.status

    def __getitem__(self, name: str) -> float:
        """The estimate of a parameter by its path."""
        return float(self.values[[p.name for p in self.parameters].index(name)])

    def fitted_scene(self, run: int = 0) -> Scene:
        """The scene of a run with the fitted values in it; what runs have of their own is that run's."""
        problem = self.solution.problem
        mine = list(problem.of_run[run])
        at = placed(problem.scenes[run], problem.data, problem.plain[run], self.values[mine])
        return fitted_scene(problem.scenes[run], at.setup.model, problem.plain[run], self.values[mine])

    def channels(self) -> list[dict[str, Any]]:
        """Of every channel: kind, unit, samples, root mean square of the residuals, noise told, correlation left."""
        point, found = self.solution, []
        for c, sensor in enumerate(point.problem.data.sensors):
            runs = zip(point.problem.data.runs, point.evaluation.shown, strict=True)
            off = np.concatenate([(shown[c] - run.values[c]).ravel() for run, shown in runs])
            off = off[np.isfinite(off)]
            if sensor.channel.turns:
                off = off - 2 * np.pi * np.round(off / (2 * np.pi))
            interval = float(np.median(np.concatenate([np.diff(run.t[c]) for run in point.problem.data.runs])))
            found.append(
                {
                    "name": sensor.channel.name,
                    "kind": sensor.channel.kind,
                    "unit": sensor.channel.measures,
                    "samples": int(off.size),
                    "rms": float(np.sqrt(np.mean(off**2))),
                    "noise": float(point.problem.noise.size[c]),
                    "noise_unit": "-" if sensor.relative else sensor.channel.measures,
                    "noise_claimed": sensor.noise,
                    "kept": float(point.problem.noise.kept(np.full(len(point.problem.noise.size), interval))[c]),
                    "correlation": float(self.errors.correlation_1[c]),
                }
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON; what is not finite is None."""
        e, names = self.errors, [s.channel.name for s in self.solution.problem.data.sensors]
        table = {}
        for i, p in enumerate(self.parameters):
            table[p.name] = {
                "value": self.values[i],
                "std_error": e.std_error[i],
                "low": e.low[i],
                "high": e.high[i],
                "at_bound": bool(e.at_bound[i]),
                "unit": p.unit,
                "determined": e.determined[i],
                "why": e.why[i],
                "sensitivity": dict(zip(names, e.sensitivity[i], strict=True)),
            }
        found = {
            "schema": SCHEMA,
            "status": self.status,
            "method": "channels",
            "parameters": table,
            "correlation": e.correlation,
            "channels": self.channels(),
            "between": {
                b.name: {
                    "mean": b.mean,
                    "std_error": b.std_error,
                    "low": b.low,
                    "high": b.high,
                    "spread": b.spread,
                    "values": b.values,
                    "std_errors": b.errors,
                }
                for b in self.between
            },
            "iterations": self.solution.iterations,
            "seconds": self.seconds,
            "step_s": self.solution.problem.dt,
            "step_bias_std_errors": self.step_bias,
            "blocks": e.blocks,
            "warnings": self.warnings,
        }
        if self.status != "ok":
            found["error"] = f"{self.status}: {self.message}"
        return jsonable(found)
