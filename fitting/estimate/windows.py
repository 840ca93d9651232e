"""Cutting traces into windows, and the start of each window.

A chaotic trace cannot be fitted as one run: its sensitivity to the start grows as exp(lambda t). Each window has a
start of its own (angles and rates, in a local chart, see `planar`), and only the parameters are shared. Their lengths
follow the growth of small errors (`error_growth`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from fitting.traces.trace import Trace

#: Deviation from whole steps [steps] below which samples count as lying on the time grid.
ON_GRID = 1e-6


#: Fields that every window has separately, in addition to `follows`.
WINDOW_FIELDS = ("begin", "run", "theta", "weight", "index", "fraction", "released", "step_counts")
#: Optional fields of the same kind.
NOISE_FIELDS = ("decay", "jitter")


class Span(NamedTuple):
    """From `low` to `high` [s] of a run."""

    run: int
    low: float
    high: float


class Piece(NamedTuple):
    """Specification of a window: its run, start [s], steps, and whether it starts at the end of the previous one."""

    run: int
    begin: float
    steps: int
    follows: bool


@dataclass(frozen=True)
class Windows:
    """K windows of S sample slots each, over any number of runs.

    Attributes:
        begin: start times (K,) [s].
        run: number of the trace of each window (K,).
        follows: whether a window starts where the previous one ends (K,).
        theta: measured angles (K, S, n) [rad], 0 if missing. Of R recordings of one motion (K, S, R n): each
            has slots and columns of its own.
        weight: 1/sigma (K, S, n) [1/rad], 0 where there is no sample.
        index, fraction: time of each slot in steps after the start, integer and fraction, (K, S).
        dt, steps: time step [s], and the step capacity of programs for these windows.
        released: whether the model determines the start of a window, see `release` (K,).
        step_counts: steps of each window (K,), at most `steps`.
        substeps: number of parts of every step.
        decay: decay rate of the noise's autocorrelation (K, n) [1/s]; None if it is white.
        jitter: ratio of the standard deviation by frames' common delays to that of the noise, with the sign of the
            rates (K, S, n); None: none.
    """

    begin: np.ndarray
    run: np.ndarray
    follows: np.ndarray
    theta: np.ndarray
    weight: np.ndarray
    index: np.ndarray
    fraction: np.ndarray
    dt: float
    steps: int
    released: np.ndarray
    step_counts: np.ndarray
    substeps: int = 1
    decay: np.ndarray | None = None
    jitter: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.begin)

    @property
    def known(self) -> np.ndarray:
        """Which samples exist (K, S, n) bool."""
        return self.weight > 0

    @property
    def source(self) -> np.ndarray:
        """Number of the run whose noise a window has (K,)."""
        return self.run

    @property
    def samples(self) -> int:
        """Total number of measured angles."""
        return int(self.known.sum())

    @property
    def lengths(self) -> np.ndarray:
        """Durations of the windows (K,) [s]."""
        return self.step_counts * self.dt

    @property
    def ends(self) -> np.ndarray:
        """Times at which the windows end (K,) [s]."""
        return self.begin + self.lengths

    @property
    def length(self) -> float:
        """Duration of the longest window [s]."""
        return self.lengths.max()

    def piece(self, k: int) -> Piece:
        """Window k without its samples."""
        return Piece(int(self.run[k]), float(self.begin[k]), int(self.step_counts[k]), bool(self.follows[k]))

    def pieces(self) -> list[Piece]:
        """All windows without their samples."""
        return [self.piece(k) for k in range(self.count)]

    def times(self) -> np.ndarray:
        """Times of all slots (K, S) [s]."""
        return self.begin[:, None] + (self.index + self.fraction) * self.dt

    def pad_to(self, steps: int, slots: int) -> Windows:
        """The same windows simulated for at least `steps` and with at least `slots` sample slots, the rest empty.

        Windows with the shapes of earlier ones need no compilation.
        """
        more = max(0, slots - self.theta.shape[1])
        padded = {}
        for f in ("theta", "weight", "index", "fraction", "jitter"):
            a = getattr(self, f)
            if a is not None:
                padded[f] = np.pad(a, [(0, 0), (0, more), *[(0, 0)] * (a.ndim - 2)])
        return replace(self, steps=max(steps, self.steps), **padded)

    @property
    def elapsed(self) -> np.ndarray:
        """Fraction of its window that has passed before each slot (K, S), in whole steps."""
        return self.index / self.step_counts[:, None]

    def early(self, part: float) -> Windows:
        """The same windows, of which only the first fraction (0 to 1) is fitted."""
        return self.with_slots(self.elapsed <= part)

    def with_slots(self, which: np.ndarray) -> Windows:
        """The same windows with samples in some slots (K, S) bool alone, or of some windows (K, 1)."""
        return replace(self, weight=np.where(which[..., None], self.weight, 0.0))

    def end_early(self, k: int, end: float) -> Windows:
        """The same windows, of which window k ends at a time [s]; its later slots are empty."""
        mine = np.arange(self.count) == k
        late = mine[:, None] & (self.times() > end - 0.5 * self.dt)
        counts = np.where(mine, round((end - self.begin[k]) / self.dt), self.step_counts)
        index = np.where(late, 0, self.index)
        fraction = np.where(late, 0, self.fraction)
        return replace(self.with_slots(~late), step_counts=counts, index=index, fraction=fraction)

    def without_samples(self, which: np.ndarray) -> Windows:
        """The same windows, of which some (K,) bool have no samples."""
        return self.with_slots(~which[:, None])

    def pick(self, which: np.ndarray) -> Windows:
        """Some of the windows, none of which follows another."""
        part = {f: getattr(self, f)[which] for f in (*WINDOW_FIELDS, *NOISE_FIELDS) if getattr(self, f) is not None}
        return replace(self, follows=np.zeros(len(part["begin"]), bool), **part)

    def exclude(self, which: np.ndarray) -> Windows:
        """The windows without some (K,) bool; those after them follow none."""
        follows = self.follows & ~np.concatenate([[False], which[:-1]])
        return replace(self.pick(~which), follows=follows[~which])


#: Minimum number of frames of a window: a start can fit fewer samples exactly.
FEWEST_FRAMES = 5


def fewest_frames(links: int, freedoms: int) -> int:
    """Minimum number of frames of a window: five, and twice as many samples as its start has numbers."""
    return max(FEWEST_FRAMES, -(-2 * freedoms // links))


def cut(
    traces: Sequence[Trace],
    length: float,
    dt: float,
    sigma: Sequence[np.ndarray],
    spans: Sequence[Span],
) -> Windows:
    """Windows of `length` [s], one after another.

    The rest of a span becomes a shorter window, if it has at least `FEWEST_FRAMES` frames. Windows in which a link has
    fewer than two samples are omitted.

    Args:
        traces: runs in the model's convention.
        sigma: noise of each run's links (n,) [rad], used if the trace has no standard errors.
        spans: to cut.
    """
    steps = max(1, int(length / dt + 1e-6))
    whole = steps * dt
    pieces = []
    for i, low, high in spans:
        count = int((high - low) / whole + 1e-6)
        pieces += [Piece(i, low + k * whole, steps, k > 0) for k in range(count)]
        rest = int((high - low - count * whole) / dt + 1e-6)
        if count and rest * dt >= FEWEST_FRAMES * traces[i].interval * (1 - 1e-6):
            pieces.append(Piece(i, low + count * whole, rest, True))
    if not pieces:
        longest = max((high - low for _, low, high in spans), default=0.0)
        raise SceneError(f"window: {length:g} s is longer than the trace; allowed: at most {longest:g} s")
    return fill(traces, pieces, dt, sigma)


def fill(traces: Sequence[Trace], pieces: Sequence[Piece], dt: float, sigma: Sequence[np.ndarray]) -> Windows:
    """Windows of these pieces with the samples that lie in them."""
    parts = [_all_samples(traces[p.run], p.begin, p.steps, dt, sigma[p.run]) for p in pieces]
    slots = max(len(part[0]) for part in parts)
    theta, weight, index, fraction = (_pad_rows(column, slots) for column in zip(*parts, strict=True))
    run, begin, steps, follows = (np.array(column) for column in zip(*pieces, strict=True))
    released = np.zeros(len(begin), bool)
    most = int(steps.max())
    found = Windows(begin, run, follows, theta, weight, index, fraction, dt, most, released, steps)
    # windows in which some link has too few samples to determine its start are dropped
    seen = found.known.sum(axis=1).reshape(len(begin), -1, traces[0].links)
    empty = seen.sum(axis=1).min(axis=1) < 2
    if empty.all():
        raise SceneError("window: no window has two samples of every link. Use longer windows or denser traces")
    if empty.any():
        return found.exclude(empty)
    return found


def _pad_rows(rows: Sequence[np.ndarray], slots: int) -> np.ndarray:
    """Arrays (S_k, ...) as rows (K, slots, ...) of one, the rest zero."""
    found = np.zeros((len(rows), slots, *rows[0].shape[1:]), rows[0].dtype)
    for row, values in zip(found, rows, strict=True):
        row[: len(values)] = values
    return found


def _all_samples(trace: Trace, begin: float, steps: int, dt: float, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
    """The samples of a trace, or of all recordings of its motion one after another, each in its own columns."""
    found = []
    recordings = trace.recordings or (trace,)
    count = len(recordings)
    for i, one in enumerate(recordings):
        mine = slice(i * trace.links, (i + 1) * trace.links)
        theta, weight, index, fraction = _samples(one, begin, steps, dt, sigma[mine])
        wide = np.zeros((2, len(theta), count * trace.links))
        wide[:, :, mine] = theta, weight
        found.append((*wide, index, fraction))
    return tuple(map(np.concatenate, zip(*found, strict=True)))


def _samples(trace: Trace, begin: float, steps: int, dt: float, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
    """Angles, weights, and positions in steps (integer, fraction) of the samples of a trace in a window."""
    step_position = (trace.t - begin) / dt
    keep = (step_position > -ON_GRID) & (step_position < steps - ON_GRID)
    step_position = step_position[keep]
    theta = trace.theta[keep]
    index = np.floor(step_position + ON_GRID).astype(np.int32)
    fraction = np.where(np.abs(step_position - index) < 10 * ON_GRID, 0.0, step_position - index)
    known = np.isfinite(theta)
    error = sigma
    if trace.se is not None:
        error = np.where(np.isfinite(trace.se[keep]), trace.se[keep], sigma)
    return np.where(known, theta, 0.0), np.where(known, 1.0 / error, 0.0), index, fraction


#: Arrays of NumPy or of JAX.
ArrayType = TypeVar("A", np.ndarray, Array)


class Starts(NamedTuple, Generic[ArrayType]):
    """Window starts: angles and rates, each (K, n), which close."""

    theta: ArrayType
    omega: ArrayType


#: A named tuple of arrays with a row for each window.
ByWindow = TypeVar("ByWindow", bound=tuple)


def pick(rows: ByWindow, which: np.ndarray) -> ByWindow:
    """The rows of some windows."""
    return type(rows)(*(part[which] for part in rows))


def with_rows(rows: ByWindow, which: np.ndarray, new: ByWindow) -> ByWindow:
    """A copy with new rows for some windows."""
    found = type(rows)(*(part.copy() for part in rows))
    for part, other in zip(found, new, strict=True):
        part[which] = other
    return found
