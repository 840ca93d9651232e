"""Angle traces in memory: the convention of their angles, their samples, and checks of both.

Internally, angles are from the horizontal, positive downwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.traces.csv_table import check_times, placeholder

ZEROS = ("horizontal", "down")
SIGNS = ("1", "-1")
UNITS = ("rad", "deg")
#: Radians per unit of angle.
RADIANS = {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3}
#: Minimum number of samples of a trace that can be windowed.
FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class Convention:
    """Convention of angles: direction of zero, sign and unit; None if not specified."""

    zero: str | None = None
    sign: int | None = None
    unit: str | None = None

    @property
    def turn(self) -> int:
        """1 if angles grow as those of the model do, otherwise -1."""
        sign = self.sign or 1
        if self.zero == "down":
            return -sign
        return sign

    @property
    def radians(self) -> float:
        """Radians per unit of the angles; without a unit they are in radians."""
        return RADIANS[self.unit or "rad"]

    def in_model(self, theta: np.ndarray) -> np.ndarray:
        """Angles [rad] of this convention, from the horizontal and positive downwards."""
        if self.zero == "down":
            return np.pi / 2 + self.turn * theta
        return self.turn * theta

    def over(self, other: Convention) -> Convention:
        """This convention, completed by another."""
        return replace(other, **{key: value for key, value in vars(self).items() if value is not None})


@dataclass(frozen=True)
class Trace:
    """One run: the angles of its links over time.

    Attributes:
        name: of the file.
        t: (k,) [s], increasing.
        theta: (k, n) as measured, or [rad] from the horizontal once `in_model_convention` was used; NaN is missing.
        se: standard errors (k, n), in the unit of `theta`, or None.
        convention: how the angles are counted in the file.
        warnings: remarks of the trace's author, which a fit repeats.
        model_error: angle by which the trace deviates from any model, in the unit of `theta`.
        recordings: what recorded this one motion, if several (`parameters.recordings`); empty: the trace itself.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    se: np.ndarray | None = None
    convention: Convention = Convention()
    warnings: tuple[str, ...] = ()
    model_error: float = 0.0
    recordings: tuple[Trace, ...] = ()

    @property
    def links(self) -> int:
        return self.theta.shape[1]

    @property
    def interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def total_error(self) -> np.ndarray | None:
        """Standard errors of the samples, model error included (k, n); None if the trace states none."""
        if self.se is None:
            return None
        return np.hypot(self.se, self.model_error)

    def column_name(self, column: int) -> str:
        """Recording and link, from 1, of a column of its windows."""
        if not self.recordings:
            return f"{self.name} link {column + 1}"
        number, link = divmod(column, self.links)
        return f"{self.recordings[number].name} link {link + 1}"

    def with_missing(self, time: float, column: int) -> Trace:
        """The trace with the sample nearest to a time [s] marked as missing in a column of its windows."""
        if self.recordings:
            number, link = divmod(column, self.links)
            recordings = list(self.recordings)
            recordings[number] = recordings[number].with_missing(time, link)
            return replace(self, recordings=tuple(recordings))
        theta = self.theta.copy()
        theta[np.argmin(np.abs(self.t - time)), column] = np.nan
        return replace(self, theta=theta)

    def between(self, low: float, high: float) -> Trace:
        """The samples with low <= t < high."""
        keep = (self.t >= low - 1e-9) & (self.t < high - 1e-9)
        se = None if self.se is None else self.se[keep]
        recordings = tuple(one.between(low, high) for one in self.recordings)
        return replace(self, t=self.t[keep], theta=self.theta[keep], se=se, recordings=recordings)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Angles (len(times), n) interpolated linearly between the known samples, of which every link has some."""
        found = np.empty((len(times), self.links))
        for j, column in enumerate(self.theta.T):
            known = np.isfinite(column)
            found[:, j] = np.interp(times, self.t[known], column[known])
        return found

    def across_gaps(self, longest: float) -> np.ndarray:
        """Angles (k, n), between known samples at most `longest` [s] apart interpolated linearly; NaN is missing."""
        found = self.theta.copy()
        for column in found.T:
            known = np.isfinite(column)
            if not known.any():
                continue
            times = self.t[known]
            before = np.maximum(np.searchsorted(times, self.t, side="right") - 1, 0)
            after = np.minimum(np.searchsorted(times, self.t), len(times) - 1)
            near = times[after] - times[before] <= longest
            column[near] = np.interp(self.t, times, column[known], left=np.nan, right=np.nan)[near]
        return found

    def in_model_convention(self, convention: Convention) -> Trace:
        """Angles [rad] from the horizontal, positive downwards, continuous in time."""
        unit = convention.radians
        se = None if self.se is None else unit * self.se
        theta = unwrap(convention.in_model(unit * self.theta))
        return replace(self, theta=theta, se=se, convention=convention, model_error=unit * self.model_error)


def unwrap(theta: np.ndarray, turn: float = 2 * np.pi) -> np.ndarray:
    """Angles (k, n) without jumps of a full turn, by default in radians; missing samples stay."""
    theta = np.array(theta, float)
    for column in theta.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known], period=turn)
    return theta


def convention(zero: str | None, sign: str | int | None, unit: str | None, where: str = "traces") -> Convention:
    """A checked convention; None stays None."""
    if sign is not None:
        sign = str(sign).lstrip("+")
    for key, value, allowed in (("zero", zero, ZEROS), ("sign", sign, SIGNS), ("unit", unit, UNITS)):
        if value is not None and value not in allowed:
            raise SceneError(f"{where}: {key} = {value!r} is unknown; allowed: {', '.join(allowed)}")
    if sign is not None:
        sign = int(sign)
    return Convention(zero, sign, unit)


def check_shapes(trace: Trace) -> None:
    """Reject arrays of a trace that do not fit together.

    Raises:
        SceneError: with the trace and the shapes.
    """
    count = np.size(trace.t)
    if np.shape(trace.t) != (count,) or np.ndim(trace.theta) != 2 or len(trace.theta) != count:
        raise SceneError(f"{trace.name}: theta has shape {np.shape(trace.theta)}; allowed: ({count}, links), as t has")
    if not np.shape(trace.theta)[1]:
        raise SceneError(f"{trace.name}: theta has no columns; allowed: one for each link")
    if trace.se is not None and np.shape(trace.se) != np.shape(trace.theta):
        raise SceneError(f"{trace.name}: se has shape {np.shape(trace.se)}; allowed: {np.shape(trace.theta)}, as theta")


def check_trace(trace: Trace, partial: bool = False) -> None:
    """Reject times and values that cannot be fitted.

    Args:
        partial: whether links without any sample are ignored.

    Raises:
        SceneError: with the trace and the first error.
    """
    theta = trace.theta
    check_shapes(trace)
    check_times(trace.name, trace.t)
    known = np.isfinite(theta).sum(axis=0)
    links = np.arange(trace.links)
    if partial and known.any():
        links = np.flatnonzero(known)
    fewest = links[np.argmin(known[links])]
    if known[fewest] < FEWEST_SAMPLES:
        text = f"{known[fewest]} samples; allowed: at least {FEWEST_SAMPLES}"
        if not known[fewest]:
            text = "every sample is missing; needed: numbers"
        raise SceneError(f"{trace.name}: theta_{fewest + 1}: {text}")
    for j in links:
        column = theta[:, j]
        if (mark := placeholder(column)) is not None:
            raise SceneError(
                f"{trace.name}: theta_{j + 1}: {mark:g} in {int((column == mark).sum())} rows, far from the rows "
                "before and after them, seems to mark missing samples; allowed: empty cells for missing samples"
            )
    moving = theta[:, links]
    if np.max(np.nanmax(moving, axis=0) - np.nanmin(moving, axis=0)) < 1e-9:
        raise SceneError(f"{trace.name}: theta: is constant, nothing moves. Use a trace with motion")
    if trace.se is not None:
        smallest = np.min(trace.se, initial=np.inf, where=~np.isnan(trace.se))
        if not 0 < smallest < np.inf:
            raise SceneError(f"{trace.name}: se: {smallest:g} is not positive; allowed: standard errors > 0")
