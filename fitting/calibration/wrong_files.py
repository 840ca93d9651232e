"""Files that do not belong to the scene, or count their angles in another way: the mistake is named with its fix.

Three looks, the cheap ones first:

1. Between fixed points every frame must close: the links at their measured angles end at the second hook, within
   what the noise allows. Each change that a file may need is tried, and the one that closes the frames is named.
2. Damping takes energy. Where the energy of the motion rises, rows are reversed in time or two runs are in one file.
3. After a fit that does not explain the trace, short windows are fitted as given and for each change, by the programs
   of that fit, with the damping held. A change that lowers chi-square ten times is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.calibration.balance import measured
from fitting.calibration.heldout import fit_starts
from fitting.calibration.prepared import Prepared
from fitting.estimate.problem import wrapped
from fitting.parameters.naming import DAMPING
from fitting.traces.conventions import resting_angles
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace

#: RMS change of every angle [rad] that closes the frames, above which a mistake is looked for, and above which frames
#: that no change closes are refused. Noise is 0.01, lengths that are off by 2 % make 0.02, a marker off by 1 degree
#: less: parameters that are freed explain these.
OPEN, TOO_OPEN = 0.05, 0.1
#: Part of the misfit, of closure or of chi-square, that a named change may leave.
CLOSES, LOWERS = 0.3, 0.1
#: Fewest complete frames that are judged, and most that are looked at.
FEWEST, MOST = 10, 400
#: Frames by which one column may be late; of those that short windows try, one is never off by more than a fifth.
LATE, SOME_LATE = 30, (1, 2, 3, 5, 8, 12, 18, 26)
#: Free parameters that move the hooks, the links or the measured angles: with these, frames need not close as given.
GEOMETRY = ("length", "position", "camera", "marker", "clock", "scale")
#: Stretches into which a run is averaged, the share of them in which the energy of a reversed run rises, and by which
#: factor in all. Kicks raise it once.
STRETCHES, RISING, RISE = 10, 0.75, 1.3
#: Half width of the smoother of the energy, as a part of the shortest link's period.
SMOOTH = 0.06
#: Times the fastest frame nearby by which angles move where another run begins.
JUMP = 4.0
#: Chi-square per degree of freedom above which short windows are tried, and per sample above which they are wrong.
SUSPECT, WRONG = 1000.0, 100.0
#: Short windows, as many as one program runs side by side; their length as a part of the shortest link's period, in
#: which a wrong acceleration moves a link by a radian; evaluations of each.
SHORT, PART, EVALUATIONS = 8, 0.5, 3


class Change(NamedTuple):
    """A mistake in words, its fix, and the change of the angles (k, n) [rad] as the file counts them that undoes it."""

    mistake: str
    fix: str
    apply: Callable[[np.ndarray], np.ndarray]


def refuse_wrong_file(trace: Trace, model: Model, asked: Convention, free: Sequence[str] = ()) -> list[str]:
    """Refuse a trace between fixed points whose frames do not close; warnings where they nearly do.

    Args:
        trace: as the file counts its angles.
        asked: the convention that the caller names.
        free: names of the parameters that a fit frees; those of the geometry may close the frames.

    Raises:
        SceneError: the change that closes the frames, or that none does.
    """
    frames = trace.theta[np.isfinite(trace.theta).all(axis=1)]
    if not model.end_held or len(frames) < FEWEST:
        return []
    named = asked.over(trace.convention)
    unit = np.pi / 180 if named.unit == "deg" else 1.0
    every = [Convention(zero, int(sign), "rad") for zero, sign in product(ZEROS, SIGNS)]
    allowed = [c for c in every if named.zero in (None, c.zero) and named.sign in (None, c.sign)]
    rows = unit * trace.theta
    own = min(allowed, key=lambda c: _opening(model, _in_model(rows, c)))
    given = _opening(model, _in_model(rows, own))
    if given <= OPEN:
        return []
    tried, late = [], list(_late_columns(trace.links, range(1, LATE + 1)))
    for at in allowed:
        for change in [*_changes(trace.links), *_closing_shifts(model, rows, at), *late, *_units(named)]:
            tried.append((_opening(model, _in_model(change.apply(rows), at)), change, at))
    for at in every:
        if at not in allowed:
            fix = f"--zero {at.zero} --sign={at.sign}"
            change = Change(f"angles count as zero={at.zero}, sign={at.sign}", fix, lambda theta: theta)
            tried.append((_opening(model, _in_model(rows, at)), change, at))
    best = min(left for left, _, _ in tried)
    apart = f"the links at their angles end {_distance(model, given)} m from the second hook"
    if best < min(OPEN, CLOSES * given):
        # of changes that close alike, the one with links that hang as at rest
        alike = [one for one in tried if one[0] < 1.5 * best + 1e-3]
        rest = resting_angles(model)
        left, change, _ = min(alike, key=lambda one: _off_rest(_in_model(one[1].apply(rows), one[2]), rest))
        raise SceneError(
            f"{trace.name}: {change.mistake}, as it seems: {apart} as given, {_distance(model, left)} m without this "
            f"mistake; allowed: {change.fix}"
        )
    if given > TOO_OPEN and not any(part in name for name in free for part in GEOMETRY):
        raise SceneError(
            f"{trace.name}: another rig, as it seems: {apart} in the median frame, and no single change of the file "
            "closes them; allowed: the file of this scene, or its lengths and hooks freed (--free)"
        )
    return [f"{trace.name}: {apart} in the median frame: check lengths, hooks and the zeros of the angles"]


def _in_model(theta: np.ndarray, at: Convention) -> np.ndarray:
    theta = at.sign * theta
    return np.pi / 2 - theta if at.zero == "down" else theta


def _opening(model: Model, theta: np.ndarray) -> float:
    """RMS change of every angle [rad] that closes the frames (k, n), by their median frame."""
    theta = theta[np.isfinite(theta).all(axis=1)]
    if len(theta) < FEWEST:
        return np.inf
    size = np.abs(_missing_reach(model, theta[:: max(1, len(theta) // MOST)]))
    # the median of a squared deviation in two directions is log(2) of its mean
    return float(np.median(size) / np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2)))


def _missing_reach(model: Model, theta: np.ndarray) -> np.ndarray:
    """From the end of the links to the second hook (k,) [m], x + i z with z downwards."""
    ends = model.ends(0.0)
    span = np.asarray(ends.end - ends.start)
    return span[0] - 1j * span[2] - np.exp(1j * theta) @ np.asarray(model.line.length)


def _distance(model: Model, opening: float) -> str:
    return f"{opening * np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2)):.2g}"


def _off_rest(theta: np.ndarray, rest: np.ndarray) -> float:
    """RMS departure [rad] of the links' mean directions from those at rest."""
    mean = np.angle(np.nanmean(np.exp(1j * theta), axis=0))
    return float(np.sqrt(np.mean(wrapped(mean - rest) ** 2)))


def _changes(links: int) -> Iterator[Change]:
    """Changes that need no number: links mirrored, angles relative, columns in another order."""
    mirrors = (
        ("has the wrong sign", "turn the sign of", lambda theta: -theta),
        ("is measured from the link's other end", "add half a turn to", lambda theta: theta + np.pi),
        ("is mirrored", "take half a turn less the angles of", lambda theta: np.pi - theta),
    )
    for mistake, fix, mirror in mirrors:
        for j in range(links):
            name = f"theta_{j + 1}"
            yield Change(f"{name} {mistake}", f"{fix} {name}", _of_column(j, mirror))
    # a wrong sign of all is a matter of the convention
    yield Change("all links are mirrored (seen from behind)", "take half a turn less all angles", mirrors[2][2])
    if links > 1:
        total = lambda theta: np.cumsum(theta, axis=1)  # noqa: E731
        yield Change("angles are relative to the link before", "add up the angles from theta_1 on", total)
        reverse = lambda theta: theta[:, ::-1]  # noqa: E731
        fix = "name the columns from the first hook on"
        yield Change("columns are in the reverse order", fix, reverse)
        turned = lambda theta: theta[:, ::-1] + np.pi  # noqa: E731
        yield Change("columns are in the reverse order, and links measured from their other end", fix, turned)
    for j, k in combinations(range(links), 2):
        names = f"theta_{j + 1} and theta_{k + 1}"
        yield Change(f"{names} are swapped", f"swap {names}", _with_columns(_swapped(links, j, k)))
    for by in range(1, links if links > 2 else 0):
        order = np.roll(np.arange(links), by)
        fix = f"theta_1 belongs in column theta_{by + 1}"
        yield Change(f"columns are shifted by {by}", fix, _with_columns(order))


def _of_column(j: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: np.where(np.arange(theta.shape[1]) == j, change(theta), theta)


def _with_columns(order: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: theta[:, order]


def _swapped(links: int, j: int, k: int) -> np.ndarray:
    order = np.arange(links)
    order[[j, k]] = k, j
    return order


def _shift(j: int | None, by: float) -> Change:
    name = "all columns" if j is None else f"theta_{j + 1}"
    mistake = f"the zero of {name} is shifted by {-by:.3g} rad"
    add = lambda theta: theta + by  # noqa: E731
    return Change(mistake, f"add {by:.3g} rad to {name}", add if j is None else _of_column(j, add))


def _closing_shifts(model: Model, theta: np.ndarray, at: Convention) -> Iterator[Change]:
    """Shifts of one column, or of all, that close the frames best."""
    angle = _in_model(theta, at)
    angle = angle[np.isfinite(angle).all(axis=1)]
    missing, length = _missing_reach(model, angle), np.asarray(model.line.length)
    turn = -at.sign if at.zero == "down" else at.sign
    for j in range(angle.shape[1]):
        own = length[j] * np.exp(1j * angle[:, j])
        yield _shift(j, turn * float(np.angle(np.sum((missing + own) * own.conj()))))
    reach = np.exp(1j * angle) @ length
    yield _shift(None, turn * float(np.angle(np.sum((missing + reach) * reach.conj()))))


def _late_columns(links: int, frames: Sequence[int]) -> Iterator[Change]:
    """One column some frames later or earlier than the others."""
    for j, by, sign in product(range(links), frames, (1, -1)):
        name, when, where = f"theta_{j + 1}", *(("late", "up") if sign > 0 else ("early", "down"))
        move = partial(_moved, by=by * sign)
        yield Change(f"{name} is {by} frames {when}", f"move {name} {where} by {by} rows", _of_column(j, move))


def _moved(theta: np.ndarray, by: int) -> np.ndarray:
    moved = np.full_like(theta, np.nan)
    if by > 0:
        moved[:-by] = theta[by:]
    else:
        moved[-by:] = theta[:by]
    return moved


def _units(named: Convention) -> Iterator[Change]:
    factor, unit = (180 / np.pi, "rad") if named.unit == "deg" else (np.pi / 180, "deg")
    yield Change(f"the unit is {unit}", f"--unit {unit}", lambda theta: factor * theta)


def refuse_rising_energy(trace: Trace, model: Model, spans: Sequence[tuple[float, float]], period: float) -> None:
    """Refuse a trace whose energy rises: two runs in one file, or rows reversed in time.

    Args:
        trace: in the model's convention.
        spans: from, to [s] of what is fitted.
        period: of the shortest link [s].

    Raises:
        SceneError: the time of the second run, or that the rows are reversed.
    """
    if any(e.name not in ("weight", *DAMPING) for e in model.effects):
        return  # water and springs have energies of their own
    low, high = spans[0][0], spans[-1][1]
    motion = measured(trace.between(low, high), (low, high), SMOOTH * period)
    if motion is None:
        return
    t, theta, omega = motion
    energy = _energy(model, theta, omega)
    inside = np.zeros(len(t), bool)
    for begin, end in spans:
        inside |= (t >= begin) & (t < end)
    t, energy = t[inside], energy[inside]
    for at in _breaks(trace):
        before, after = (energy[(t > a) & (t < b)] for a, b in ((at - period, at), (at, at + period)))
        # medians: the smoother turns a jump into a whip of a few frames
        if len(before) and len(after) and np.median(after) > RISE * np.median(before):
            raise SceneError(
                f"{trace.name}: two runs in one file, as it seems: the angles jump at {at:.4g} s, and their energy "
                f"rises from {np.median(before):.3g} to {np.median(after):.3g} J; allowed: one file per run, or "
                f"--until {at:.4g} for the first one"
            )
    parts = np.array([np.median(part) for part in np.array_split(energy, STRETCHES)])
    rising = float(np.mean(np.diff(parts) > 0))
    if rising >= RISING and parts[-2:].mean() > RISE * parts[:2].mean():
        raise SceneError(
            f"{trace.name}: time is reversed, as it seems: the energy of the motion rises from "
            f"{parts[:2].mean():.3g} to {parts[-2:].mean():.3g} J; allowed: the rows turned around"
        )


def _energy(model: Model, theta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Energy (k,) [J] of angles and rates (k, n) above that at rest."""
    line, length = model.line, np.asarray(model.line.length)
    weights = next((np.asarray(line.node_share(e.per_link(line))) for e in model.effects if e.name == "weight"), 0.0)
    free = len(np.asarray(line.node_mass))
    v = np.cumsum(1j * omega * length * np.exp(1j * theta), axis=1)
    if line.compound:
        near, both, far = (np.asarray(block) for block in line.blocks())
        first = np.concatenate([np.zeros_like(v[:, :1]), v[:, :-1]], axis=1)
        kinetic = near * np.abs(first) ** 2 + 2 * both * np.real(first * v.conj()) + far * np.abs(v) ** 2
    else:
        kinetic = np.asarray(line.node_mass) * np.abs(v[:, :free]) ** 2
    height = lambda angle: -np.cumsum(length * np.sin(angle), axis=-1)[..., :free] @ (weights + np.zeros(free))  # noqa: E731
    return 0.5 * kinetic.sum(axis=1) + height(theta) - height(resting_angles(model))


def _breaks(trace: Trace) -> Iterator[float]:
    """Times [s] at which most links jump, or frames pause."""
    step = np.diff(trace.t)
    move = np.abs(wrapped(np.diff(trace.theta, axis=0)))
    for i in range(5, len(move) - 5):
        if step[i] > 10 * trace.interval:
            yield float(trace.t[i + 1])
            continue
        near = np.nanmax(np.concatenate([move[i - 5 : i], move[i + 1 : i + 6]]), axis=0, initial=0.0)
        known = np.isfinite(move[i])
        if known.any() and np.median((move[i] - JUMP * near)[known]) > 0:
            yield float(trace.t[i + 1])


def name_wrong_file(prepared: Prepared) -> str:
    """The change of the traces that short windows ask for, in a line; empty where they fit as given.

    Only the starts of the windows are fitted, and the compiled programs of the fit are used again.
    """
    pieces = _moving_pieces(prepared)
    given = _misfit(prepared, prepared.traces, pieces)
    if not given > WRONG:
        return ""
    links = prepared.traces[0].links
    groups = [*_changes(links), *_resting_shifts(prepared), _reversed_in_time()], _late_columns(links, SOME_LATE)
    left, change = np.inf, None
    for group in groups:  # the second one is large and rare
        tried = [
            (_misfit(prepared, [_changed(trace, one) for trace in prepared.traces], pieces), i, one)
            for i, one in enumerate(group)
        ]
        left, _, change = min(tried, key=lambda one: one[:2])
        if left < LOWERS * given:
            break
    name = ", ".join(trace.name for trace in prepared.traces)
    size = f"short windows miss the angles by {np.sqrt(given):.0f} times their noise as given"
    if left < LOWERS * given:
        return (
            f"{name}: {change.mistake}, as it seems: {size}, {np.sqrt(left):.2g} times without this mistake; "
            f"allowed: {change.fix}"
        )
    return (
        f"{name}: another rig, as it seems: {size}, and no single change of the file lowers that much; "
        "check lengths, masses, gravity and the times of the frames"
    )


def _moving_pieces(prepared: Prepared) -> list[tuple[int, float, float]]:
    """Run, from and to of short windows, spread over those of the fit's that move more than the median."""
    windows = prepared.windows
    length = min(windows.length, max(PART * prepared.period, 2 * windows.dt))
    known = windows.weight > 0
    mean = np.sum(windows.theta * known, axis=1) / np.maximum(known.sum(axis=1), 1)
    moved = np.sum(known * (windows.theta - mean[:, None]) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    moving = np.flatnonzero(moved >= np.median(moved))
    some = moving[np.unique(np.linspace(0, len(moving) - 1, SHORT).round().astype(int))]
    return [(int(windows.run[k]), float(windows.begin[k]), float(windows.begin[k]) + length) for k in some]


def _misfit(prepared: Prepared, traces: list[Trace], pieces: Sequence[tuple[int, float, float]]) -> float:
    """Chi-square per sample of the median short window, by starts of its own; infinite where none can be run."""
    at = replace(prepared, traces=traces)
    windows = prepared.windows
    try:
        short = at.cut(min(end - begin for _, begin, end in pieces), pieces)
    except SceneError:
        return np.inf
    short = replace(short.padded(windows.steps, windows.theta.shape[1]), substeps=windows.substeps)
    solution = fit_starts(at, short, prepared.values, EVALUATIONS)
    known = short.weight > 0
    chi2 = np.sum((solution.errors * short.weight) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    return float(np.median(np.where(np.isfinite(chi2), chi2, np.inf)))


def _changed(trace: Trace, change: Change) -> Trace:
    """A trace in the model's convention, changed as its file counts the angles."""
    at = Convention(trace.convention.zero or "horizontal", trace.convention.sign or 1, "rad")
    raw = at.sign * _in_model(trace.theta, replace(at, sign=1))
    return replace(trace, theta=_in_model(change.apply(raw), at), se=None)


def _resting_shifts(prepared: Prepared) -> Iterator[Change]:
    """Shifts of one column, or of all, that bring the mean directions of a free line to those at rest."""
    model, trace = prepared.simulator.model, prepared.traces[0]
    if model.end_held:
        return  # frames that do not close were looked at before
    at = trace.convention
    mean = np.angle(np.nanmean(np.exp(1j * trace.theta), axis=0))
    off = wrapped(resting_angles(model) - mean) * (-at.sign if at.zero == "down" else at.sign or 1)
    for part in (0.7, 1.0, 1.3):  # the mean of a few swings is not that at rest
        for j, by in enumerate(off):
            yield _shift(j, part * float(by))
        yield _shift(None, part * float(np.mean(off)))


def _reversed_in_time() -> Change:
    return Change("time is reversed", "turn the rows around", lambda theta: theta[::-1])
