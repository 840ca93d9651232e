"""Faults of tensions from step to step: peaks that are not resolved, pulses, oscillations, and snatch loads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from dropper_jax.base.records import names_of
from dropper_jax.run.samples import Samples
from dropper_jax.scene import sliced_lines

#: Maximum number of lines listed for one fault: the ropes of a longline often share it, and a farm may have thousands.
MOST_WARNINGS = 3


def tension_warnings(solution: Samples) -> list[str]:
    """The warnings about faults from step to step if every step is saved, and about snatch loads."""
    used = solution.settings
    every_step = used["save_every"] == 1 and "refused_steps" not in used and len(solution.t) > 3
    found = []
    if every_step:
        found = limit_warnings(_faults_between_steps(solution))
    return [*found, *limit_warnings(_snatch_loads(solution))]


class LineFault(NamedTuple):
    """A fault of a line: its name, which lines share, its size, and the warning."""

    name: str
    size: float
    text: str


def limit_warnings(faults: Iterable[LineFault]) -> list[str]:
    """The warnings in order: all of a few lines, else the `MOST_WARNINGS` largest of each fault and the number of the
    others."""
    faults = list(faults)
    listed = []
    more = []
    for name in dict.fromkeys(names_of(faults)):
        same = [i for i, fault in enumerate(faults) if fault.name == name]
        same.sort(key=lambda i: -faults[i].size)
        listed += same[:MOST_WARNINGS]
        if len(same) > MOST_WARNINGS:
            more.append(f"{len(same) - MOST_WARNINGS} more lines: {name}")
    return [*(faults[i].text for i in sorted(listed)), *more]


#: Fraction of a link's tension over time in pulses of one step, above which a warning is given.
PULSED = 0.05


def _faults_between_steps(solution: Samples) -> Iterator[LineFault]:
    """Faults in the tensions (k, n) of each line from step to step."""
    dt = solution.settings["dt"]
    for line, where in sliced_lines(solution.scene):
        tension = solution.tension[1:, where.links]
        sharp = unresolved_peak(tension)
        if sharp is not None:
            when = f"{tension[sharp]:.4g} N at {solution.t_tension[1 + sharp[0]]:.4g} s"
            text = f"{line.name}: the peak tension, {when}, lasts only one or two steps of {dt:g} s and is not resolved"
            yield LineFault("peak tensions of one or two steps are not resolved", float(tension[sharp]), text)
        pulsed = _pulse_share(tension)
        if pulsed > PULSED:
            text = f"{line.name}: {pulsed:.0%} of the tension is in pulses of one step of {dt:g} s and is not resolved"
            yield LineFault("tensions in pulses of one step are not resolved", pulsed, text)
        elif _alternates(tension):
            text = f"{line.name}: tensions oscillate from step to step: mean values are reliable, peak values are not"
            yield LineFault("tensions oscillate from step to step", float(np.max(tension)), text)


#: Ratio to the static tension below which a link is slack, or in compression.
SLACK = 1e-3
#: Ratio to the static tension above which a link that was slack has a snatch load.
SNATCH = 10.0
#: High tensions after it, of ropes and of rigid lines: name of the fault, what came before, and the peaks in words.
SNATCHES = {
    False: ("snatch loads", "slack", "peaks are snatch loads and"),
    True: ("high tensions after compression", "compression", "peaks"),
}


def _snatch_loads(solution: Samples) -> Iterator[LineFault]:
    """Lines that change from slack to many times their static tension, of runs that start at rest."""
    if not solution.scene.start.is_static or solution.continues or "load_errors" in solution.settings:
        return
    least, largest = solution.tension_range
    for line, where in sliced_lines(solution.scene):
        rest = float(np.max(solution.tension[0, where.links]))
        slack = np.any(least[1:, where.links] < SLACK * rest, axis=0)
        top = np.max(largest[1:, where.links], axis=0, initial=0.0)
        worst = float(np.max(np.where(slack, top, 0.0)))
        if rest > 0.0 and worst > SNATCH * rest:
            fault, before, what = SNATCHES[line.rigid]
            text = (
                f"{line.name}: changes from {before} to {worst:.4g} N, {worst / rest:.3g} times its static tension: "
                f"{what} may be chaotic. Use --errors"
            )
            yield LineFault(fault, worst, text)


#: Fraction by which the tension one step before and after an unresolved peak is lower, on average. That is a half-sine
#: of less than three steps, whose maximum is low by 5 % (tension is a mean over the step) to 13 % (if it is between two
#: steps).
SHARP = 0.5


def unresolved_peak(tension: np.ndarray) -> tuple[int, int] | None:
    """Index (step, link) of the maximum tension (k, n) [N] if it is a peak of one or two steps, else None."""
    step, link = np.unravel_index(np.argmax(tension), tension.shape)
    around = tension[max(step - 1, 0) : step + 2, link]
    if len(around) < 3 or around[1] <= 0.0:
        return None
    if around[1] - 0.5 * (around[0] + around[2]) > SHARP * around[1]:
        return (int(step), int(link))
    return None


def _pulse_share(tension: np.ndarray) -> float:
    """Maximum over the links of the fraction of tension over time that is in single steps between slack ones."""
    taut = tension > 0.0
    alone = taut[1:-1] & ~taut[:-2] & ~taut[2:]
    pulses = np.sum(np.where(alone, tension[1:-1], 0.0), axis=0)
    return float(np.max(pulses / np.maximum(np.sum(np.abs(tension), axis=0), np.finfo(float).tiny)))


#: Tensions oscillate if they alternate for this number of steps, by more than this fraction of the tension.
ALTERNATING_STEPS = 20
ALTERNATING_SHARE = 0.05


def _alternates(tension: np.ndarray) -> bool:
    """Whether a link's tension alternates at every step for some time, in addition to its smooth changes."""
    saw = (tension[:-2] - 2.0 * tension[1:-1] + tension[2:]) / 4.0
    flips = saw[1:] * saw[:-1] < 0.0
    size = np.minimum(np.abs(saw[1:]), np.abs(saw[:-1]))
    alternates = flips & (size > ALTERNATING_SHARE * np.maximum(np.abs(tension[1:-2]), 1e-300))
    if len(alternates) < ALTERNATING_STEPS:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(alternates, ALTERNATING_STEPS, axis=0)
    return bool(np.any(np.all(windows, axis=-1)))
