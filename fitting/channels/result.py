"""Result of a fit to channels: numbers with their errors, the fitted scene, and the noise of each channel."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, TypedDict

import numpy as np

from dropper_jax.base.json_values import jsonable
from dropper_jax.load.scene import Scene
from fitting.channels.between_runs import Between
from fitting.channels.errors import VERDICTS, Errors
from fitting.channels.problem import ChannelSolution, Evaluation, Problem
from fitting.channels.setup import setup_with_directions
from fitting.estimate.noise import Noise
from fitting.estimate.scene_fit import SceneFit
from fitting.parameters.fitted_scene import fitted_scene


class ChannelSummary(TypedDict):
    """A channel of a fit.

    Attributes:
        name, kind: of the channel; unit: SI, of its values.
        samples: their number over all runs.
        rms: of the residuals [unit].
        noise: estimated standard deviation [noise_unit]; noise_unit: `unit`, or `-` for a fraction of the value.
        noise_claimed: that of the data's file [noise_unit], None if it gives none.
        kept: share of the noise that remains in the next sample; 0 of white noise.
        correlation: of neighbouring residuals, what the noise explains removed.
    """

    name: str
    kind: str
    unit: str
    samples: int
    rms: float
    noise: float
    noise_unit: str
    noise_claimed: float | None
    kept: float
    correlation: float


@dataclass(kw_only=True)
class ChannelFit(SceneFit[Problem, Evaluation]):
    """A scene fitted to channels: the content of every fit (`SceneFit`), and that of channels.

    Attributes:
        between: parameters that each run has separately, over the runs.
    """

    solution: ChannelSolution
    uncertainty: Errors
    between: tuple[Between, ...] = ()

    @property
    def errors(self) -> Errors:
        """Estimates of the parameters, and what determines them."""
        return self.uncertainty

    def note(self, i: int) -> str:
        """Remark on a parameter, by its number."""
        return ", ".join(filter(None, (VERDICTS[self.errors.determined[i]], super().note(i))))

    def fitted_scene(self, run: int = 0) -> Scene:
        """The scene of a run with the fitted values, including the run's own ones."""
        problem = self.solution.problem
        scene = problem.scenes[run]
        values = self.values[list(problem.of_run[run])]
        at = setup_with_directions(scene, problem.data, problem.plain, values)
        return fitted_scene(scene, at.setup.model, problem.plain, values)

    def channels(self) -> list[ChannelSummary]:
        """A summary of every channel."""
        problem = self.solution.problem
        deviations = problem.data.deviations(self.solution.evaluation.shown)
        known = problem.windows.weight[..., 0] > 0
        noise = problem.noise or Noise.as_claimed(len(problem.data.sensors), 1)
        found = []
        for c, sensor in enumerate(problem.data.sensors):
            off = deviations[known & (problem.windows.source == c)[:, None]]
            interval = np.median(np.concatenate([np.diff(run.t[c]) for run in problem.data.runs]))
            summary = ChannelSummary(
                name=sensor.channel.name,
                kind=sensor.channel.kind,
                unit=sensor.channel.measures,
                samples=off.size,
                rms=np.sqrt(np.mean(off**2)),
                noise=problem.noise_size[c],
                noise_unit="-" if sensor.relative else sensor.channel.measures,
                noise_claimed=sensor.noise,
                kept=np.exp(-noise.decay[c, 0] * interval),
                correlation=self.errors.correlation_1[c],
            )
            found.append(summary)
        return found

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON; values that are not finite become null."""
        e = self.errors
        names = [s.channel.name for s in self.solution.problem.data.sensors]
        table = self.estimates()
        for row, determined, why, felt in zip(table.values(), e.determined, e.why, e.sensitivity, strict=True):
            row |= {"determined": determined, "why": why, "sensitivity": dict(zip(names, felt, strict=True))}
        between = {row.pop("name"): row for row in map(asdict, self.between)}
        found = {"parameters": table, "channels": self.channels(), "between": between}
        return jsonable(self.common_json("channels", self.solution.problem.dt) | found)
