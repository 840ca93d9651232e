"""Measured data: runs with the samples of every channel, their sensors, and the cameras."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fitting.channels.channel import Channel


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
class Run:
    """One run: times (k,) [s] and values (k, m) [SI] of every channel, NaN if missing, and its own scene values."""

    name: str
    t: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    own: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Data:
    """What was measured."""

    sensors: tuple[Sensor, ...]
    cameras: tuple[CameraSpec, ...]
    runs: tuple[Run, ...]
