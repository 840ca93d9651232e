"""Files that do not belong to the scene, found after a fit that does not explain the trace.

Short windows are fitted as given and for each change that a file may need. They use the programs of that fit, with only
starts and damping free. A change that lowers chi-square by a factor ten is reported. If none does, the likeliest cause
is reported (`likely_cause`), provided that short windows miss the angles by more than right models do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.calibration.likely_cause import Misfit, likely_cause
from fitting.calibration.preparation import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.windows import first_starts
from fitting.parameters.of_scene import DAMPING
from fitting.traces.conventions import Change, changes, in_model, late_columns, resting_angles, shift
from fitting.traces.planar import wrap
from fitting.traces.trace import Convention, Trace, without_spikes

#: Fraction of chi-square that a reported change may leave.
LOWERS = 0.1
#: Frames by which one column may be late that short windows try: within 20 % of the true one.
SOME_LATE = (1, 2, 3, 5, 8, 12, 18, 26)
#: Chi-square per degree of freedom above which short windows are tried, and per sample above which they are wrong.
SUSPECT = 1000.0
WRONG = 25.0
#: Fraction of their motion by which short windows miss another rig. Low noise shows the errors of any model: those of a
#: measured double pendulum are 8 times its noise, 0.05 % of the motion.
OTHER_RIG = 3e-3
#: Short windows, as many as one program runs in parallel; their length as a fraction of the shortest link's period and
#: in frames, and evaluations of each. An acceleration that is wrong by g moves a link by a radian in that time.
SHORT = 8
PART = 0.35
FRAMES = 6
EVALUATIONS = 4


def name_wrong_file(prepared: Prepared) -> str:
    """The change of the traces that short windows suggest, in a line; empty if they fit as given.

    The compiled programs of the fit are used again. Of its parameters only the damping is fitted, starting from zero: a
    wrong file makes all parameters of a fit arbitrary.
    """
    pieces = _moving_pieces(prepared)
    links = prepared.traces[0].links
    given, part = _misfit(prepared, prepared.traces, pieces)
    if not given > WRONG:
        return ""
    name = ", ".join(trace.name for trace in prepared.traces)
    size = f"short windows miss the angles by {np.sqrt(given):.0f} times their noise as given"
    groups = [*changes(links), *_resting_shifts(prepared)], [*late_columns(links, SOME_LATE)]
    for group in groups:  # the second one is large, and its mistakes are rare
        changed = ([_apply_change(trace, change) for trace in prepared.traces] for change in group)
        tried = [_misfit(prepared, traces, pieces)[0] for traces in changed]
        left = min(tried)
        change = group[int(np.argmin(tried))]
        # maximum chi-square per sample of a reported change: right ones give 0.5 to 4
        if left < min(LOWERS * given, 9.0):
            return (
                f"{name}: {change.mistake}, as it seems: {size}, {np.sqrt(left):.2g} times without this mistake; "
                f"to correct it: {change.fix}"
            )
    if not part > OTHER_RIG:
        return ""

    def misfit(prepared: Prepared, pieces: Sequence[tuple[int, float, float]], paths: Sequence[str] = ()) -> Misfit:
        return _misfits(prepared, prepared.traces, pieces, paths)

    cause = likely_cause(prepared, pieces, misfit)
    return f"{name}: {size}; likeliest cause: {cause.words}; {cause.remedy}"


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
    found = _misfits(prepared, traces, pieces)
    return float(np.median(found.chi2)), found.part


def _misfits(
    prepared: Prepared,
    traces: list[Trace],
    pieces: Sequence[tuple[int, float, float]],
    paths: Sequence[str] = (),
) -> Misfit:
    """The same for every short window; the parameters at `paths` are free too."""
    at = replace(prepared, traces=[without_spikes(trace) for trace in traces])
    try:
        windows = at.cut(min(end - begin for _, begin, end in pieces), pieces)
    except SceneError:
        return Misfit(np.array([np.inf]), np.inf, prepared.values)
    names = [p.name for p in prepared.parameters]
    damping = np.array([any(f".{part}." in name for part in DAMPING) for name in names])
    free = damping | [name.startswith(tuple(paths)) for name in names]
    values = np.where(damping, [p.low for p in prepared.parameters], prepared.values)
    starts = first_starts(prepared.simulator.model_at(values), at.traces, windows, at.sigma)
    problem = replace(at.problem(frozen=~free), windows=windows)
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
    part = float(np.median(np.sqrt(chi2 / np.maximum(moved, 1e-300))))
    return Misfit(chi2, part, solution.values)


def _apply_change(trace: Trace, change: Change) -> Trace:
    """A trace in the model's convention, changed in the convention of its file."""
    at = Convention(trace.convention.zero or "horizontal", trace.convention.sign or 1, "rad")
    raw = at.sign * in_model(trace.theta, replace(at, sign=1))
    return replace(trace, theta=in_model(change.apply(raw), at), se=None)


def _resting_shifts(prepared: Prepared) -> Iterator[Change]:
    """Shifts of one column, or of all, that bring the mean directions of a free line to those at rest."""
    model = prepared.simulator.model
    trace = prepared.traces[0]
    if model.end_held:
        return  # open frames were handled before
    at = trace.convention
    mean = np.angle(np.nanmean(np.exp(1j * trace.theta), axis=0))
    off = wrap(resting_angles(model) - mean) * (-at.sign if at.zero == "down" else at.sign or 1)
    for part in (0.7, 1.0, 1.3):  # the mean of a few swings differs from the angle at rest
        for j, by in enumerate(off):
            yield shift(j, part * float(by))
        yield shift(None, part * float(np.mean(off)))
