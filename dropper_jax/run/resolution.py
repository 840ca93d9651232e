"""Quality checks of a run: energy balance error and unresolved tensions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.load.scene import Scene
from dropper_jax.run.samples import DRIFT, TOO_LONG, Kind, Samples
from dropper_jax.run.winches import winch_warnings
from dropper_jax.scene import sliced_lines

#: Maximum number of lines listed for one fault: the ropes of a longline often share it, and a farm may have thousands.
MOST_WARNINGS = 3
#: Energy balance error, as a fraction of the energy scale, above which the status of a run is not ok.
ENERGY_ERROR = 0.1
#: Energy error [J] per weight times length of all lines that is ignored: rounding of runs at rest.
RESTING_ERROR = 1e-6
#: Energy of unresolved axial vibrations, as a fraction of all dissipated work and of the energy scale, above which it
#: is warned of: on a mass that bounces on a rope peaks and deviations are then 2 % too low ...
RINGING_WARNED = 0.1
#: ... and above which the steps are too long: they are then 10 % too low.
RINGING_UNUSABLE = 0.5


def with_quality_checks(solution: Kind) -> Kind:
    """The solution with the warnings of its quality checks; its status is not ok if the energy balance has a large
    error, or if most of the dissipated work is that of axial vibrations which the steps do not resolve."""
    used = solution.settings
    every_step = used["save_every"] == 1 and "refused_steps" not in used and len(solution.t) > 3
    found = []
    if every_step:
        found = limit_warnings(_tension_faults(solution))
    found += limit_warnings(_snatch_loads(solution))
    found += winch_warnings(solution)
    drift = solution.energy_drift
    line = solution.scene.line
    negligible = RESTING_ERROR * GRAVITY * float(np.sum(line.mass)) * float(np.sum(line.length))
    scale = max(solution.energy_scale, negligible)
    status = solution.status
    if used.get("track_work", True) and drift > ENERGY_ERROR * scale:
        found.insert(0, f"energy balance error {drift:.3g} J (reference {scale:.3g} J). Use a smaller step")
        # a scheme with numerical damping (implicit Euler: 90 % of a lab dropper's energy) warns; it fails if it gains
        # as much, from any time to a later one, or loses more than the energy scale
        gain = np.max(solution.balance - np.minimum.accumulate(solution.balance))
        by_design = _dissipates(solution) and max(drift, gain / ENERGY_ERROR) <= scale
        if status == "ok" and not by_design:
            status = DRIFT
    share = solution.axial_ringing_share
    ringing = min(share, solution.axial_ringing / scale)
    if ringing > RINGING_WARNED:
        found.append(
            f"axial vibrations that the steps do not resolve take {share:.0%} of the dissipated work: peaks and "
            "deviations of tensions are too low. Use a smaller --accuracy or --dt, or line.axial.damping"
        )
        if status == "ok" and ringing > RINGING_UNUSABLE:
            status = TOO_LONG
    return replace(solution, status=status, warnings=(*solution.warnings, *found))


def without_push(scene: Scene, tension: np.ndarray, tolerance: float) -> np.ndarray:
    """The tensions (k, n) [N], changed in place: zero for slack ropes if negative within the step tolerance.

    Axial residuals are lengths, so a relative tolerance of the length is a relative tolerance of EA for tensions.
    """
    for line, where in sliced_lines(scene):
        if line.axial_law == "rope" and line.EA is not None:
            own = tension[:, where.links]
            tension[:, where.links] = np.where((own < 0.0) & (own >= -tolerance * line.EA), 0.0, own)
    return tension


def _dissipates(solution: Samples) -> bool:
    """Whether the scheme of a run has numerical damping."""
    scheme = INTEGRATORS[solution.settings["integrator"]]
    return scheme(**{name: solution.settings[name] for name in scheme.options()}).dissipates


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
    for name in dict.fromkeys(fault.name for fault in faults):
        same = [i for i, fault in enumerate(faults) if fault.name == name]
        same.sort(key=lambda i: -faults[i].size)
        listed += same[:MOST_WARNINGS]
        if len(same) > MOST_WARNINGS:
            more.append(f"{len(same) - MOST_WARNINGS} more lines: {name}")
    return [*(faults[i].text for i in sorted(listed)), *more]


#: Fraction of a link's tension over time in pulses of one step, above which a warning is given.
PULSED = 0.05


def _tension_faults(solution: Samples) -> Iterator[LineFault]:
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


def check_skip(skip: float, errors: bool, duration: float) -> None:
    """Reject a time left out of the errors that is not within the run."""
    if skip and not errors:
        raise SceneError(f"--skip: {skip:g} s can only be left out together with --errors")
    if not 0.0 <= skip < duration:
        raise SceneError(f"--skip: {skip:g} is out of range; allowed: 0 to less than the {duration:g} s of the run")
