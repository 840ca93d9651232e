"""Files that do not belong to the scene, or use another angle convention: the mistake is reported with its fix.

There are three checks, the cheap ones first:

1. Between fixed points every frame must close: the links at their measured angles end at the second hook, within the
   noise. Each change that a file may need is tried, and the one that closes the frames is reported.
2. Damping dissipates energy. If the energy of the motion rises, rows are reversed in time or two runs are in one file.
   Short windows do not detect this: without damping a motion also runs backwards.
3. After a fit that does not explain the trace, short windows are fitted as given and for each change. They use the
   programs of that fit, with only starts and damping free. A change that lowers chi-square by a factor ten is reported.
   If none does, the file is from another rig, provided that short windows miss the angles by more than right models do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.calibration.decision import smooth_stretch
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.windows import first_starts
from fitting.parameters.of_scene import DAMPING
from fitting.traces.conventions import (
    Change,
    changes,
    in_model,
    late_columns,
    missing_reach,
    off_rest,
    resting_angles,
    shift,
    units,
)
from fitting.traces.planar import wrap
from fitting.traces.trace import SIGNS, ZEROS, Convention, Trace, without_spikes

#: RMS change of every angle [rad] that closes the frames, above which a mistake is searched for, and above which frames
#: that no change closes are rejected. Noise is 0.01, lengths wrong by 2 % give 0.02, a marker off by 1 degree less;
#: free parameters explain these.
OPEN, TOO_OPEN = 0.05, 0.1
#: Fraction of the misfit, of closure or of chi-square, that a reported change may leave.
CLOSES, LOWERS = 0.3, 0.1
#: Minimum number of complete frames for the check, and maximum number that are used.
FEWEST, MOST = 10, 400
#: Frames by which one column may be late; those that short windows try are within 20 % of the true one.
LATE, SOME_LATE = 30, (1, 2, 3, 5, 8, 12, 18, 26)
#: Free parameters that move the hooks, the links or the measured angles: with these, frames need not close as given.
GEOMETRY = ("length", "position", "camera", "marker", "clock", "scale")
#: Stretches over which a run is averaged, the fraction of them in which the energy of a reversed run rises, and its
#: total growth factor. Kicks raise it once.
STRETCHES, RISING, RISE = 10, 0.75, 1.3
#: Chi-square per degree of freedom above which short windows are tried, and per sample above which they are wrong.
SUSPECT, WRONG = 1000.0, 25.0
#: Fraction of their motion by which short windows miss another rig. Low noise shows the errors of any model: those of a
#: measured double pendulum are 8 times its noise, 0.05 % of the motion.
OTHER_RIG = 3e-3
#: Short windows, as many as one program runs in parallel; their length as a fraction of the shortest link's period and
#: in frames, and evaluations of each. An acceleration that is wrong by g moves a link by a radian in that time.
SHORT, PART, FRAMES, EVALUATIONS = 8, 0.35, 6, 4


def refuse_wrong_file(trace: Trace, model: Model, requested: Convention, free: Sequence[str] = ()) -> list[str]:
    """Reject a trace between fixed points whose frames do not close; warn if they nearly do.

    Args:
        trace: in the convention of the file.
        requested: the convention given by the caller.
        free: names of the parameters that a fit frees; those of the geometry may close the frames.

    Raises:
        SceneError: the change that closes the frames, or that none does.
    """
    frames = trace.theta[np.isfinite(trace.theta).all(axis=1)]
    if not model.end_held or len(frames) < FEWEST:
        return []
    named = requested.over(trace.convention)
    unit = np.pi / 180 if named.unit == "deg" else 1.0
    every = [Convention(zero, int(sign), "rad") for zero, sign in product(ZEROS, SIGNS)]
    allowed = [c for c in every if named.zero in (None, c.zero) and named.sign in (None, c.sign)]
    rows = unit * trace.theta
    own = min(allowed, key=lambda c: _opening(model, in_model(rows, c)))
    given = _opening(model, in_model(rows, own))
    if given <= OPEN:
        return []
    moves = any(part in name for name in free for part in GEOMETRY)
    plain = [*changes(trace.links), *late_columns(trace.links, range(1, LATE + 1)), *units(named)]
    tried = [(change, at) for at in allowed for change in plain]
    if not moves:  # free parameters may cause the shift of the angles
        tried += [(change, at) for at in allowed for change in _closing_shifts(model, rows, at)]
    for at in (at for at in every if at not in allowed):
        words = f"angles count as zero={at.zero}, sign={at.sign}"
        tried.append((Change(words, f"--zero {at.zero} --sign={at.sign}", lambda theta: theta), at))
    tried = [(_opening(model, in_model(change.apply(rows), at)), change, at) for change, at in tried]
    best = min(left for left, _, _ in tried)
    apart = f"the links at their angles end {_distance(model, given)} m from the second hook"
    if best < min(OPEN, CLOSES * given):
        # of changes that close equally well, the one with links that hang as at rest
        alike = [one for one in tried if one[0] < 1.5 * best + 1e-3]
        rest = resting_angles(model)
        off = [round(off_rest(in_model(change.apply(rows), at), rest), 2) for _, change, at in alike]
        left, change, _ = alike[int(np.argmin(off))]
        words = f"{change.mistake}, as it seems: {apart} as given, {_distance(model, left)} m without this mistake"
        if given <= TOO_OPEN:  # a camera rolled by 2 degrees opens them as far, and a fit may free its roll
            return [f"{trace.name}: {words}: {change.fix}, or free what opens them (--auto-free)"]
        raise SceneError(f"{trace.name}: {words}. To correct it: {change.fix}")
    if given > TOO_OPEN and not moves:
        raise SceneError(
            f"{trace.name}: another rig, as it seems: {apart} in the median frame, and no single change of the file "
            "closes them. Use the file of this scene, or free its lengths and hooks (--free)"
        )
    return [f"{trace.name}: {apart} in the median frame: check lengths, hooks and the zeros of the angles"]


def _opening(model: Model, theta: np.ndarray) -> float:
    """RMS change of every angle [rad] that closes the frames (k, n), by their median frame."""
    theta = theta[np.isfinite(theta).all(axis=1)]
    if len(theta) < FEWEST:
        return np.inf
    size = np.abs(missing_reach(model, theta[:: max(1, len(theta) // MOST)]))
    # the median of a squared deviation in two directions is log(2) of its mean
    return float(np.median(size) / np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2)))


def _distance(model: Model, opening: float) -> str:
    return f"{opening * np.sqrt(np.log(2) * np.sum(np.asarray(model.line.length) ** 2)):.2g}"


def _closing_shifts(model: Model, theta: np.ndarray, at: Convention) -> Iterator[Change]:
    """Shifts of one column, or of all, that close the frames best."""
    angle = in_model(theta, at)
    angle = angle[np.isfinite(angle).all(axis=1)]
    missing, link = missing_reach(model, angle), np.asarray(model.line.length) * np.exp(1j * angle)
    turn = -at.sign if at.zero == "down" else at.sign
    for j, reach in [*enumerate(link.T), (None, link.sum(axis=1))]:
        yield shift(j, turn * float(np.angle(np.sum((missing + reach) * reach.conj()))))


def refuse_rising_energy(trace: Trace, model: Model, spans: Sequence[tuple[float, float]], period: float) -> None:
    """Reject a trace whose energy rises: two runs in one file, or rows reversed in time.

    Args:
        trace: in the model's convention.
        spans: from, to [s] of the fitted samples.
        period: of the shortest link [s].

    Raises:
        SceneError: the time of the second run, or that the rows are reversed.
    """
    if any(e.name not in ("weight", *DAMPING) for e in model.effects):
        return  # water and springs have energies of their own
    low, high = spans[0][0], spans[-1][1]
    # half width of the smoother of the energy, as a fraction of the shortest link's period
    motion = smooth_stretch(trace.between(low, high), (low, high), 0.06 * period)
    if motion is None:
        return
    t, energy = motion[0], _energy(model, *motion[1:])
    inside = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    t, energy = t[inside], energy[inside]
    for at in _breaks(trace):
        before, after = (energy[(t > a) & (t < b)] for a, b in ((at - period, at), (at, at + period)))
        # medians: the smoother turns a jump into a transient of a few frames
        if len(before) and len(after) and np.median(after) > RISE * np.median(before):
            raise SceneError(
                f"{trace.name}: two runs in one file, as it seems: the angles jump at {at:.4g} s, and their energy "
                f"rises from {np.median(before):.3g} to {np.median(after):.3g} J. Use one file per run, or "
                f"--until {at:.4g} for the first one"
            )
    parts = np.array([np.median(part) for part in np.array_split(energy, STRETCHES)])
    rising = float(np.mean(np.diff(parts) > 0))
    if rising >= RISING and parts[-2:].mean() > RISE * parts[:2].mean():
        raise SceneError(
            f"{trace.name}: time is reversed, as it seems: the energy of the motion rises from "
            f"{parts[:2].mean():.3g} to {parts[-2:].mean():.3g} J. Reverse the rows"
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
    """Times [s] at which most links jump, or where frames are missing."""
    step = np.diff(trace.t)
    move = np.abs(wrap(np.diff(trace.theta, axis=0)))
    for i in range(5, len(move) - 5):
        if step[i] > 10 * trace.interval:
            yield float(trace.t[i + 1])
            continue
        near = np.nanmax(np.concatenate([move[i - 5 : i], move[i + 1 : i + 6]]), axis=0, initial=0.0)
        known = np.isfinite(move[i])
        # multiple of the fastest nearby motion per frame by which angles move where another run starts
        if known.any() and np.median((move[i] - 4.0 * near)[known]) > 0:
            yield float(trace.t[i + 1])


def name_wrong_file(prepared: Prepared) -> str:
    """The change of the traces that short windows suggest, in a line; empty if they fit as given.

    The compiled programs of the fit are used again. Of its parameters only the damping is fitted, starting from zero: a
    wrong file makes all parameters of a fit arbitrary.
    """
    pieces, links = _moving_pieces(prepared), prepared.traces[0].links
    given, part = _misfit(prepared, prepared.traces, pieces)
    if not given > WRONG:
        return ""
    name = ", ".join(trace.name for trace in prepared.traces)
    size = f"short windows miss the angles by {np.sqrt(given):.0f} times their noise as given"
    groups = [*changes(links), *_resting_shifts(prepared)], [*late_columns(links, SOME_LATE)]
    for group in groups:  # the second one is large, and its mistakes are rare
        changed = ([_apply_change(trace, change) for trace in prepared.traces] for change in group)
        tried = [_misfit(prepared, traces, pieces)[0] for traces in changed]
        left, change = min(tried), group[int(np.argmin(tried))]
        # maximum chi-square per sample of a reported change: right ones give 0.5 to 4
        if left < min(LOWERS * given, 9.0):
            return (
                f"{name}: {change.mistake}, as it seems: {size}, {np.sqrt(left):.2g} times without this mistake; "
                f"to correct it: {change.fix}"
            )
    if not part > OTHER_RIG:
        return ""
    return (
        f"{name}: another rig, as it seems: {size}, and no single change of the file reduces this much. "
        "Check lengths, masses, gravity and the times of the frames"
    )


def _moving_pieces(prepared: Prepared) -> list[tuple[int, float, float]]:
    """Run, start and end of short windows, spread over those of the fit's that move more than the median."""
    windows = prepared.windows
    interval = max(trace.interval for trace in prepared.traces)
    length = min(windows.length, max(PART * prepared.period, FRAMES * interval))
    known = windows.weight > 0
    mean = np.sum(windows.theta * known, axis=1) / np.maximum(known.sum(axis=1), 1)
    moved = np.sum(known * (windows.theta - mean[:, None]) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    moved = np.where(windows.lengths > length * (1 - 1e-6), moved, -1.0)  # the rest of a window is too short
    moving = np.flatnonzero((moved >= np.median(moved[moved >= 0])) & (moved >= 0))
    some = moving[np.unique(np.linspace(0, len(moving) - 1, SHORT).round().astype(int))]
    return [(int(windows.run[k]), float(windows.begin[k]), float(windows.begin[k]) + length) for k in some]


def _misfit(prepared: Prepared, traces: list[Trace], pieces: Sequence[tuple[int, float, float]]) -> tuple[float, float]:
    """Chi-square per sample of the median short window, by its own start, and its root relative to the motion's size;
    infinite if none can be run."""
    at = replace(prepared, traces=[without_spikes(trace) for trace in traces])
    try:
        windows = at.cut(min(end - begin for _, begin, end in pieces), pieces)
    except SceneError:
        return np.inf, np.inf
    damping = np.array([any(f".{part}." in p.name for part in DAMPING) for p in prepared.parameters])
    values = np.where(damping, [p.low for p in prepared.parameters], prepared.values)
    starts = first_starts(prepared.simulator.model_at(values), at.traces, windows, at.sigma)
    problem = replace(at.problem(frozen=~damping), windows=windows)
    solution = fit_windows(problem, values, starts, iterations=EVALUATIONS)
    weight = windows.weight
    mean = np.sum(weight * windows.theta, axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    samples = [
        [np.sort(one[w > 0] ** 2) for one, w in zip(size * weight, weight, strict=True)]
        for size in (solution.errors, windows.theta - mean[:, None])
    ]
    # fraction of a window's samples that count; the others have the largest residuals and may be outliers
    chi2, moved = np.array([[x[: int(np.ceil(0.95 * len(x)))].mean() for x in row] for row in samples])
    chi2 = np.where(np.isfinite(chi2), chi2, np.inf)
    return float(np.median(chi2)), float(np.median(np.sqrt(chi2 / np.maximum(moved, 1e-300))))


def _apply_change(trace: Trace, change: Change) -> Trace:
    """A trace in the model's convention, changed in the convention of its file."""
    at = Convention(trace.convention.zero or "horizontal", trace.convention.sign or 1, "rad")
    raw = at.sign * in_model(trace.theta, replace(at, sign=1))
    return replace(trace, theta=in_model(change.apply(raw), at), se=None)


def _resting_shifts(prepared: Prepared) -> Iterator[Change]:
    """Shifts of one column, or of all, that bring the mean directions of a free line to those at rest."""
    model, trace = prepared.simulator.model, prepared.traces[0]
    if model.end_held:
        return  # open frames were handled before
    at = trace.convention
    mean = np.angle(np.nanmean(np.exp(1j * trace.theta), axis=0))
    off = wrap(resting_angles(model) - mean) * (-at.sign if at.zero == "down" else at.sign or 1)
    for part in (0.7, 1.0, 1.3):  # the mean of a few swings differs from the angle at rest
        for j, by in enumerate(off):
            yield shift(j, part * float(by))
        yield shift(None, part * float(np.mean(off)))
