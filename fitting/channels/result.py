"""Result of a fit to channels: numbers with errors, undetermined parameters, the fitted scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropper_jax.base.toml_text import SCHEMA, jsonable
from dropper_jax.load.scene import Scene
from fitting.channels.between import Between
from fitting.channels.errors import Errors
from fitting.channels.free import setup_with_directions
from fitting.estimate.problem import Solution
from fitting.estimate.scene_fit import SceneFit
from fitting.parameters.fitted import fitted_scene

#: Remark for each way in which a parameter is determined.
VERDICTS = {"yes": "", "no": "not determined", "prior": "by its prior alone", "upper bound": "upper bound"}


@dataclass(kw_only=True)
class ChannelFit(SceneFit):
    """A scene fitted to channels: the content of every fit (`SceneFit`), and that of channels.

    Attributes:
        between: parameters that each run has separately, over the runs.
        seconds: wall time.
    """

    uncertainty: Errors
    between: tuple[Between, ...] = ()
    seconds: float = 0.0

    @property
    def errors(self) -> Errors:
        """Estimates of the parameters, and what determines them."""
        return self.uncertainty

    @property
    def point(self) -> Solution:
        """`solution` by its former name."""
        return self.solution

    def note(self, i: int) -> str:
        """Remark on a parameter, by its number."""
        return ", ".join(filter(None, (VERDICTS[self.errors.determined[i]], super().note(i))))

    def fitted_scene(self, run: int = 0) -> Scene:
        """The scene of a run with the fitted values, including the run's own ones."""
        problem = self.solution.problem
        mine = list(problem.of_run[run])
        at = setup_with_directions(problem.scenes[run], problem.data, problem.plain[run], self.values[mine])
        return fitted_scene(problem.scenes[run], at.setup.model, problem.plain[run], self.values[mine])

    def channels(self) -> list[dict[str, Any]]:
        """Of every channel: kind, unit, samples, RMS of the residuals, estimated noise, remaining correlation."""
        point, found = self.solution, []
        noise = point.problem.noise
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
                    "noise": float(noise.size[c]),
                    "noise_unit": "-" if sensor.relative else sensor.channel.measures,
                    "noise_claimed": sensor.noise,
                    "kept": float(
                        point.problem.noise.lag_correlation(np.full(len(point.problem.noise.size), interval))[c]
                    ),
                    "correlation": float(self.errors.correlation_1[c]),
                }
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON; values that are not finite become null."""
        e, names = self.errors, [s.channel.name for s in self.solution.problem.data.sensors]
        table = self.estimates()
        for row, determined, why, felt in zip(table.values(), e.determined, e.why, e.sensitivity, strict=True):
            row |= {"determined": determined, "why": why, "sensitivity": dict(zip(names, felt, strict=True))}
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
            "iterations": self.iterations,
            "seconds": self.seconds,
            "step_s": self.solution.problem.dt,
            "step_bias_std_errors": self.step_bias,
            "blocks": e.blocks,
            "warnings": self.warnings,
            **self.intervals(),
        }
        if self.status != "ok":
            found["error"] = f"{self.status}: {self.message}"
        return jsonable(found)
