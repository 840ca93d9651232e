"""Least-squares problem of a fit to channels: runs, free parameters, and residuals with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import State
from dropper_jax.modelling.build import build_model, stepper_of
from fitting.channels.data import ByChannel, ChannelData, MeasuredRun, Series
from fitting.channels.observe import RunPlan, differentiate_channels
from fitting.channels.setup import setup_with_directions
from fitting.estimate.neighbour_correlation import is_correlated, lag_one_by_source
from fitting.estimate.residuals import Residuals, Timing
from fitting.estimate.solution import Solution
from fitting.estimate.whitening import whiten
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import SetupTarget

#: Maximum factor by which one step may change a number of fixed sign.
STEP_FACTOR = 3.0
#: Maximum number of halvings of the step for its bias.
MOST_HALVED = 2
#: Relative extension of the duration: the last sample belongs to the previous piece.
DURATION_MARGIN = 1e-6
#: Derivatives beyond this have squares that overflow in a sum.
LARGEST_SLOPE = 1e100
#: Why a run with such derivatives cannot be used.
CHAOTIC = "derivatives grow without bound, the motion is chaotic"


def is_axial_stiffness(p: Parameter) -> bool:
    """Whether the motion depends on the inverse of a parameter: an axial stiffness acts through the stretch."""
    return p.name.split("@")[0].rstrip(".0123456789").endswith(".EA") and p.low >= 0


class Evaluation(NamedTuple):
    """Predictions of every run and channel (k, m) [SI], and their derivatives by all parameters (k, m, p).

    `starts` are the runs' starts, from which the next ones are solved. `failed` describes a step that did not solve,
    or, if `unstable`, derivatives that overflow. Residuals (K, S, 1) and their derivatives (K, S, 1, p) are in units of
    independent noise; the residuals are infinite if a run failed.
    """

    shown: ByChannel
    slopes: ByChannel
    starts: tuple[State, ...]
    failed: str = ""
    unstable: bool = False
    residual: np.ndarray = np.full((1, 1, 1), np.inf)
    jacobian: np.ndarray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(Residuals):
    """Whole runs and their channels: blocks of residuals (`Series`) without unknowns of their own.

    Attributes:
        data: the measured data.
        scenes: of each run, with its own values.
        parameters: all of them, shared ones and those of single runs.
        of_run: numbers of the parameters of each run, in the order of `plain`: the same with their names in any run.
        near: a start of each run from which the next one is solved.
        halved: number of halvings of the scene's step.
        retries: whether steps that do not converge are halved and tried again.
        windows: the samples; None: with the claimed noise. Their noise is constant while the parameters change, because
            otherwise large values would be avoided.
    """

    freedoms: ClassVar[int] = 0
    least_variance: ClassVar[float] = 1.0

    data: ChannelData
    scenes: tuple[Scene, ...]
    of_run: tuple[tuple[int, ...], ...]
    plain: tuple[Parameter, ...]
    near: tuple[State, ...]
    halved: int = 0
    retries: bool = False
    windows: Series = None

    def __post_init__(self) -> None:
        if self.windows is None:
            measured = [run.values for run in self.data.runs]
            object.__setattr__(self, "windows", self.data.series(self.claimed_noise, measured))

    @property
    def dt(self) -> float:
        """The step [s]."""
        return self.scenes[0].run.step * 0.5**self.halved

    @cached_property
    def floor(self) -> np.ndarray:
        """Minimum noise of each channel (c,): the rounding of its sensor, `resolution/sqrt(12)`."""
        fit = self.scenes[0].fit
        least = np.full(len(self.data.sensors), 1e-15)
        for c, sensor in enumerate(self.data.sensors):
            if fit is not None and not sensor.relative:
                least[c] = max(fit.resolution(sensor.channel.kind) / np.sqrt(12), least[c])
        return least

    @cached_property
    def claimed_noise(self) -> np.ndarray:
        """Noise of each channel (c,) [SI, or fractions of the value], before any is estimated."""
        return np.maximum(self.data.first_noise(), self.floor)

    @property
    def noise_size(self) -> np.ndarray:
        """The estimated noise of each channel (c,)."""
        if self.noise is None:
            return self.claimed_noise
        return self.claimed_noise * self.noise.factor[:, 0]

    @property
    def order(self) -> int:
        """Order of the scene's scheme."""
        return self.plan(0).stepper.integrator.order

    @property
    def finest(self) -> bool:
        """Whether the step is halved more than `MOST_HALVED` times."""
        return self.halved > MOST_HALVED

    @property
    def held_mask(self) -> np.ndarray:
        """Which parameters are fixed, or have an empty interval (p,)."""
        return super().held_mask | np.array([not p.low < p.high for p in self.parameters], bool)

    def step_bounds(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Maximum change of the parameters in one step (p,), in both directions: by a factor if the sign is fixed."""
        low, high = super().step_bounds(values)
        for i in np.flatnonzero(~self.held_mask):
            p = self.parameters[i]
            value = values[i]
            if is_axial_stiffness(p) and value > 0:
                low[i] = value * (1 - value / max(p.low, value / STEP_FACTOR))
                high[i] = value * (1 - value / min(p.high, value * STEP_FACTOR))
            elif p.low >= 0 and value > 0:
                if p.low > 0:  # otherwise it may become 0
                    low[i] = max(low[i], (1 / STEP_FACTOR - 1) * value)
                high[i] = min(high[i], (STEP_FACTOR - 1) * max(value, 0.1 * p.scale))
        return low, high

    def after_step(self, values: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """The parameters (p,) after a step: `p + dp`, and for stiffnesses the same step of their inverse.

        A stiffness with little effect is far from linear: Newton's step from 1e8 N would end below zero, while that of
        the compliance, `p/(1 - dp/p)`, ends at the required stretch.
        """
        found = values + dp
        for i, p in enumerate(self.parameters):
            if is_axial_stiffness(p) and values[i] > 0:
                found[i] = values[i] / (1 - dp[i] / values[i])
        return np.clip(found, *self.bounds(values))

    def move_starts(self, starts: tuple[State, ...], values: np.ndarray, dz: np.ndarray) -> tuple[State, ...]:
        """The runs' starts, which follow the parameters."""
        return starts

    def timing(self) -> Timing:
        """Times of the samples of all channels."""
        starts = []
        duration = 0.0
        for run in self.data.runs:
            times = np.concatenate(run.t)
            starts.append(times.min())
            duration += np.ptp(times)
        number = np.broadcast_to(self.windows.run[:, None], self.windows.t.shape)
        duration *= 1 + DURATION_MARGIN
        return Timing(self.windows.t, number, self.sample_mask[..., 0], np.array(starts), duration, len(starts))

    def correlation(self, point: ChannelSolution) -> tuple[float | np.ndarray, bool]:
        """Correlation of neighbours in each channel (c,); whether any of them is significant."""
        residual = point.weights * point.evaluation.residual
        rho, sure = (a[:, 0] for a in lag_one_by_source(self.windows, residual, len(self.data.sensors)))
        return rho, is_correlated(np.abs(rho), sure)

    def failure(self, evaluation: Evaluation) -> str:
        """The step that did not converge."""
        return evaluation.failed

    def raw_evaluation(self, point: ChannelSolution, claimed: Series) -> Evaluation:
        """The evaluation in units of the claimed noise."""
        return self._residuals(point.evaluation, claimed)

    def _residuals(self, e: Evaluation, windows: Series) -> Evaluation:
        """The evaluation with its residuals in units of the samples' noise, not whitened."""
        slopes = self.data.in_blocks(e.slopes)[:, :, None] * windows.weight[..., None]
        return e._replace(residual=self.data.deviations(e.shown)[..., None] * windows.weight, jacobian=slopes)

    def whiten_residuals(self, e: Evaluation) -> Evaluation:
        """The evaluation with its residuals in units of independent noise."""
        if e.failed:
            return e
        return whiten(self.windows, self._residuals(e, self.windows))

    @property
    def values(self) -> np.ndarray:
        """Start of the parameters (p,)."""
        return np.array([p.value for p in self.parameters])

    def plan(self, run: int) -> RunPlan:
        """Static settings of a run, the same for all, so that runs of one kind share a program."""
        scene = self.scenes[run]
        settings = {}
        if not self.retries:
            settings["halvings"] = 0
        return RunPlan(
            stepper_of(build_model(scene), scene.run, track_work=False, **settings),
            scene.start.kind,
            scene.start.zero,
            scene.start.release_nodes,
            tuple(sensor.channel for sensor in self.data.sensors),
            self._saves(),
            scene.run.save_every * 2**self.halved,
        )

    def _saves(self) -> int:
        """Number of saved states beyond the last sample of the longest run, with delays and rates at their bounds."""
        free = [(p, p.where) for p in self.parameters if isinstance(p.where, SetupTarget)]
        rates = [p.high for p, where in free if where.field == "rate"]
        rate = max([1.0, *rates, *(camera.rate for camera in self.data.cameras)])
        late = max(t[-1] for run in self.data.runs for t in run.t) * rate
        # delays of a camera and of a channel add up
        for section, given in (("readings", self.data.sensors), ("clocks", self.data.cameras)):
            lowest = [p.low for p, where in free if (where.section, where.field) == (section, "delay")]
            late -= min([0.0, *(one.delay for one in given), *filter(np.isfinite, lowest)])
        spacing = self.scenes[0].run.step * self.scenes[0].run.save_every
        margin = max(sensor.channel.margin for sensor in self.data.sensors)
        # cubics through four rows need three saved states after the last sample, and four without both margins
        return max(int(np.ceil(late / spacing - 1e-9)) + 3, 5, 3 + 2 * margin)

    def evaluate(self, values: np.ndarray, starts: Sequence[State] | None = None) -> Evaluation:
        """Predictions of all runs at these values (p,), with derivatives."""
        near = self.near if starts is None else starts
        shown = []
        slopes = []
        started = []
        failed = ""
        unstable = False
        for number, (scene, run) in enumerate(zip(self.scenes, self.data.runs, strict=True)):
            mine = list(self.of_run[number])
            try:
                at = setup_with_directions(scene, self.data, self.plain, values[mine])
            except SceneError as error:  # such as a static pose that does not exist
                return Evaluation((), (), tuple(near), f"{run.name}: {error}")
            dt = jnp.asarray(self.dt, at.setup.model.dtype)
            stamps = self._pad_stamps(run, dt.dtype)
            plan = self.plan(number)
            motion, slope, start, bad = differentiate_channels(plan, at.setup, at.tangents, near[number], dt, stamps)
            reason = self._why_failed(int(bad), start, motion, slope, run)
            unstable = unstable or reason == CHAOTIC
            if reason and not failed:
                failed = f"{run.name}: {reason}"
            counts = list(map(len, run.t))
            shown.append([np.asarray(y)[:count] for y, count in zip(motion, counts, strict=True)])
            slopes.append([self._spread(s, count, mine) for s, count in zip(slope, counts, strict=True)])
            started.append(start)
        return self.whiten_residuals(Evaluation(shown, slopes, tuple(started), failed, unstable))

    def _why_failed(
        self, bad: int, start: State, motion: Sequence[Array], slopes: Sequence[Array], run: MeasuredRun
    ) -> str:
        """Why a run cannot be used, of which step number `bad` is the first that failed, -1 without any; empty if it
        can."""
        if bad >= 0:
            return f"step {bad + 1} at {(bad + 1) * self.dt:g} s did not solve"
        for sensor, t, y in zip(self.data.sensors, run.t, motion, strict=True):
            missing = ~np.isfinite(y[: len(t)]).all(axis=1)
            if not missing.any():
                continue
            if sensor.channel.without_value and np.isfinite(start.r).all():
                return f"channel {sensor.channel.name!r} at {t[missing][0]:g} s: {sensor.channel.without_value}"
            return "the start did not solve"
        if not all(np.abs(s).max(initial=0.0) < LARGEST_SLOPE for s in slopes):
            return CHAOTIC
        return ""

    def _pad_stamps(self, run: MeasuredRun, dtype: jnp.dtype) -> tuple[Array, ...]:
        """Stamps of a run's channels, the last one repeated up to the longest run's count: runs share a program."""
        padded = []
        for channel, t in enumerate(run.t):
            most = max(len(other.t[channel]) for other in self.data.runs)
            padded.append(jnp.asarray(np.pad(t, (0, most - len(t)), mode="edge"), dtype))
        return tuple(padded)

    def _spread(self, slope: Array, count: int, mine: list[int]) -> np.ndarray:
        """Derivatives by all parameters of the first `count` samples, from those by a run's own parameters."""
        full = np.zeros((count, slope.shape[1], len(self.parameters)))
        full[..., mine] = np.asarray(slope)[:count]
        return full

    def finer(self) -> Problem:
        """The same with half the step."""
        return replace(self, halved=self.halved + 1)


#: End of a fit to channels.
ChannelSolution: TypeAlias = "Solution[Problem, Evaluation]"
