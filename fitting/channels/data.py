"""Measured data: runs with the samples of every channel, their sensors, and the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.channels.channel import Channel
from fitting.traces.noise import noise_by_differences


@dataclass(frozen=True)
class CameraSpec:
    """`[[camera]]`: its projection (3, 4) and its clock: stamp t is taken at `rate t - delay` of the scene's time."""

    name: str
    matrix: tuple[tuple[float, ...], ...]
    delay: float = 0.0
    rate: float = 1.0


@dataclass(frozen=True)
class Sensor:
    """A channel and its assumed sensor: `measured(t) = offset + gain * true(t - delay)` [SI].

    Attributes:
        noise: standard deviation [SI], or a fraction of the value if `relative`; None: estimated from the samples.
    """

    channel: Channel
    noise: float | None = None
    relative: bool = False
    offset: float = 0.0
    gain: float = 1.0
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One run: times (k,) [s] and values (k, m) [SI] of every channel, NaN if missing, and its own scene values."""

    name: str
    t: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    own: dict[str, Any] = field(default_factory=dict)


#: Minimum number of samples of a channel in a run.
FEWEST_READINGS = 3
#: Noise of a channel with too few samples for differences, as a fraction of its standard deviation.
UNKNOWN_NOISE_SHARE = 0.1
#: Minimum noise as a fraction of the largest value.
LEAST_NOISE_SHARE = 1e-6
#: Minimum size of a reading for its relative noise, as a fraction of the channel's RMS: a reading of 0 is not exact.
LEAST_READING = 0.05
#: Values (k, m) of every run and channel, or (k, m, ...) of derivatives.
ByChannel = Sequence[Sequence[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Series:
    """Samples in blocks, one for every column of every channel of every run; empty slots are at a block's end.

    Attributes:
        run, source: number of the run, and of the sensor, whose noise is the same in all runs (K,).
        t: times (K, S) [s].
        weight: 1/sigma (K, S, 1), 0 in empty slots.
        decay: decay rate of the noise's autocorrelation (K, 1) [1/s]; None if it is white.
        follows: no block continues another one (K,).
    """

    run: np.ndarray
    source: np.ndarray
    t: np.ndarray
    weight: np.ndarray
    follows: np.ndarray
    decay: np.ndarray | None = None
    jitter: ClassVar[None] = None

    def times(self) -> np.ndarray:
        """Times of all slots (K, S) [s]."""
        return self.t


@dataclass(frozen=True)
class ChannelData:
    """What was measured: the sensors, the cameras that time some of them, and the runs.

    Raises:
        SceneError: a channel with fewer samples than `FEWEST_READINGS` in a run, or an infinite one.
    """

    sensors: tuple[Sensor, ...]
    cameras: tuple[CameraSpec, ...]
    runs: tuple[MeasuredRun, ...]

    def __post_init__(self) -> None:
        for i, run in enumerate(self.runs):
            for sensor, y in zip(self.sensors, run.values, strict=True):
                what = f"run.{i}: channel {sensor.channel.name!r}"
                if np.isinf(y).any():
                    raise SceneError(f"{what} has an infinite sample; allowed: numbers, or nan for a missing one")
                if (np.isfinite(y).sum(axis=0) < FEWEST_READINGS).any():
                    raise SceneError(f"{what} has fewer than {FEWEST_READINGS} samples; allowed: more")

    def columns(self) -> list[tuple[int, int, np.ndarray, int]]:
        """Run, channel, existing samples (k,) and column of every block."""
        found = []
        for r, run in enumerate(self.runs):
            for c, y in enumerate(run.values):
                found += [(r, c, known, j) for j, known in enumerate(np.isfinite(y).T)]
        return found

    def in_blocks(self, values: ByChannel) -> np.ndarray:
        """The values where there are samples (K, S, ...), 0 in empty slots."""
        parts = [values[r][c][known, j] for r, c, known, j in self.columns()]
        blocks = np.zeros((len(parts), max(map(len, parts)), *parts[0].shape[1:]))
        for block, samples in zip(blocks, parts, strict=True):
            block[: len(samples)] = samples
        return blocks

    def deviations(self, shown: ByChannel) -> np.ndarray:
        """Predicted minus measured values (K, S) [SI]."""
        found = self.in_blocks(shown) - self.in_blocks([run.values for run in self.runs])
        turns = np.array([self.sensors[c].channel.turns for _, c, *_ in self.columns()])
        return found - 2 * np.pi * np.round(found / (2 * np.pi)) * turns[:, None]

    def series(self, sizes: np.ndarray, shown: ByChannel) -> Series:
        """The samples with white noise of these sizes (c,) [SI], relative ones as fractions of predicted values."""
        run, source = np.array([(r, c) for r, c, *_ in self.columns()]).T
        times = []
        scales = []
        for one, predicted in zip(self.runs, shown, strict=True):
            times.append([np.tile(t[:, None], y.shape[1]) for t, y in zip(one.t, one.values, strict=True)])
            scales.append(list(map(_scale, self.sensors, predicted)))
        scale = self.in_blocks(scales) * sizes[source, None]
        weight = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
        return Series(run, source, self.in_blocks(times), weight[..., None], np.zeros(len(run), bool))

    def first_noise(self) -> np.ndarray:
        """Noise of each channel (c,) from the data's file, otherwise from differences of high order."""
        return np.array([s.noise or self._difference_noise(c) for c, s in enumerate(self.sensors)])

    def _difference_noise(self, channel: int) -> float:
        """Standard deviation of white noise on a smooth motion, by differences of high order; of a relative sensor as a
        fraction of its RMS value.

        Raises:
            SceneError: a sensor that shows the same value all the time, such as a dead one: nothing gives the size of
                its noise.
        """
        values = [run.values[channel] for run in self.runs]
        sensor = self.sensors[channel]
        level = max(np.nanmax(np.abs(y)) for y in values)
        if all((np.nanmax(y, axis=0) == np.nanmin(y, axis=0)).all() for y in values):
            raise SceneError(
                f"channel {sensor.channel.name!r}: is constant in all samples, which shows no noise; needed: its "
                "`noise`, or data without this channel"
            )
        sizes = np.concatenate([noise_by_differences(y) for y in values])
        spread = max(np.nanstd(y, axis=0).max() for y in values)
        size = UNKNOWN_NOISE_SHARE * spread
        if np.isfinite(sizes).any():
            size = np.nanmedian(sizes)
        size = max(size, LEAST_NOISE_SHARE * level)
        if sensor.relative:
            size /= np.sqrt(np.nanmean(np.concatenate(values) ** 2))
        return size


def _scale(sensor: Sensor, values: np.ndarray) -> np.ndarray:
    """Scale of a sensor's noise at these values (k, m): 1, or the value if the noise is a fraction of it."""
    if not sensor.relative:
        return np.ones_like(values)
    return np.maximum(np.abs(values), LEAST_READING * np.sqrt(np.nanmean(values**2)))
