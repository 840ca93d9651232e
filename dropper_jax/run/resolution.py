"""Warnings of a run about its own numbers: energy that is not accounted for, tensions that are not resolved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.load.scene import Scene
from dropper_jax.run.samples import Kind, Samples
from dropper_jax.scene import line_slices

#: Drift of the energy balance over its scale from which a run is not called ok. A scheme that takes energy by design
#: (implicit Euler: 90 % of a lab dropper's) warns, and fails where it gains as much, or loses more than there is.
DRIFT_FAILED, LOSS_FAILED = 0.1, 1.0
#: Energy [J] per weight times length of all lines below which none is missed: rounding of runs at rest.
NEGLIGIBLE = 1e-6
#: A largest tension of which this share is gone one step before and after, in the mean: a half-sine of less than three
#: steps, of which 5 % are lost (tension is a mean over the step) to 13 % (where its top falls between two steps).
SHARP = 0.5
#: Share of a link's tension over time that comes in pulses of one step, from which it is told.
PULSES = 0.05
#: Tensions that alternate for this many steps by more than this share of their mean.
ALTERNATING, ALTERNATION = 20, 0.05
#: Tension over that at rest from which a line that was slack before has snatched.
SNATCH = 10.0
#: Tension over that at rest below which a link is slack.
SLACK = 1e-3
#: Steps in the period of an oscillation with which the midpoint rule has its frequency to 0.1 %: `(2 pi/n)^2/12`.
RESOLVED = 60
#: Most lines that a run names for one fault: a farm of thousands says the same of each.
MOST = 20


def with_quality_checks(solution: Kind) -> Kind:
    """The solution with what it has to say about its own numbers; where energy comes from nowhere or is lost, it is not
    called ok."""
    used = solution.settings
    every_step = used["save_every"] == 1 and "refused_steps" not in used and len(solution.t) > 3
    found = _fewer(_tensions(solution)) if every_step else []
    found += _fewer(_snatches(solution))
    drift, scale = solution.energy_drift, max(solution.energy_scale, _negligible(solution))
    status = solution.status
    if used.get("track_work", True) and drift > DRIFT_FAILED * scale:
        found.insert(
            0, f"energy: {drift:.3g} J are not accounted for, of a scale of {scale:.3g} J; take a smaller step"
        )
        by_design = _dissipates(solution) and max(drift / LOSS_FAILED, _gain(solution) / DRIFT_FAILED) <= scale
        if status == "ok" and not by_design:
            status = "energy_drift"
    return replace(solution, status=status, warnings=(*solution.warnings, *found))


def step_facts(solution: Samples) -> dict[str, float | int | None]:
    """What the steps resolve: of the stiffest link's axial motion, of turning links, and of links that tauten.

    Returns:
        axial_period_s: `2 pi/omega` of the stiffest link, `omega^2 = 4 EA/(L m)`, None where none stretches.
        steps_per_axial_period, axial_step_s: steps in it, and the step that has `RESOLVED` of them.
        largest_turn_rad: of a link between two saved times; slack_to_taut_steps: steps, summed over the links, before
            which a link was slack and after which it is not. None where not every step is saved.
    """
    line, used = solution.scene.line, solution.settings
    period = None
    if line.EA is not None:
        period = float(np.pi * np.sqrt(np.min(line.length * line.mass / line.EA)))
    facts: dict[str, float | int | None] = {
        "axial_period_s": period,
        "steps_per_axial_period": None if period is None or "dt" not in used else period / used["dt"],
        "axial_step_s": None if period is None else period / RESOLVED,
        "largest_turn_rad": None,
        "slack_to_taut_steps": None,
    }
    if used.get("save_every") != 1 or "refused_steps" in used or len(solution.t) < 3:
        return facts
    turns, taut = [0.0], solution.tension[1:] > 0.0
    with np.errstate(invalid="ignore"):  # a run that failed may end with infinite positions
        for where in solution.lines:
            links = np.diff(solution.positions[:, where.nodes], axis=1)
            links = links / np.maximum(np.linalg.norm(links, axis=2, keepdims=True), 1e-300)
            turns.append(float(np.max(np.linalg.norm(links[1:] - links[:-1], axis=2))))
    facts["largest_turn_rad"] = float(2.0 * np.arcsin(min(0.5 * max(turns), 1.0)))
    facts["slack_to_taut_steps"] = int(np.sum(taut[1:] & ~taut[:-1]))
    return facts


def without_push(scene: Scene, tension: np.ndarray, tolerance: float) -> np.ndarray:
    """Tensions (k, n) [N] without what a step's tolerance leaves below zero of slack ropes, which do not push.

    Axial rows are lengths: solved to a part of the length, tensions are known to that part of EA.
    """
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if line.axial_law == "rope":
            own = tension[:, where.links]
            tension[:, where.links] = np.where((own < 0.0) & (own >= -tolerance * line.EA), 0.0, own)
    return tension


def _negligible(solution: Samples) -> float:
    lines = solution.scene.lines
    return (
        NEGLIGIBLE * GRAVITY * sum(float(np.sum(x.mass)) for x in lines) * sum(float(np.sum(x.length)) for x in lines)
    )


def _dissipates(solution: Samples) -> bool:
    scheme = INTEGRATORS[solution.settings["integrator"]]
    return scheme(**{name: solution.settings[name] for name in scheme.options()}).dissipates


def _gain(solution: Samples) -> float:
    """Largest rise of the energy balance [J] from any time to a later one."""
    balance = solution.balance
    return float(np.max(balance - np.minimum.accumulate(balance)))


def _fewer(found: Iterator[tuple[str, float, str]]) -> list[str]:
    """What is told of (fault, its size, text), in its order: all of few lines, of many the `MOST` largest of each fault
    and how many more there are."""
    rows = list(found)
    least: dict[str, float] = {}
    for fault in dict.fromkeys(row[0] for row in rows):
        sizes = sorted((row[1] for row in rows if row[0] == fault), reverse=True)
        least[fault] = sizes[min(MOST, len(sizes)) - 1]
    notes: list[str] = []
    count = dict.fromkeys(least, 0)
    for fault, size, text in rows:
        if size >= least[fault] and count[fault] < MOST:
            count[fault] += 1
            notes.append(text)
    for fault, shown in count.items():
        more = sum(row[0] == fault for row in rows) - shown
        if more:
            notes.append(f"{more} more lines: {fault}")
    return notes


def _tensions(solution: Samples) -> Iterator[tuple[str, float, str]]:
    """What each line's tensions (k, n) show from step to step: fault, its size, text."""
    dt = solution.settings["dt"]
    for line, where in zip(solution.scene.lines, solution.lines, strict=True):
        tension = solution.tension[1:, where.links]
        sharp = _sharpest(tension)
        if sharp is not None:
            when = f"{tension[sharp]:.4g} N at {solution.t_tension[1 + sharp[0]]:.4g} s"
            text = f"{line.name}: its largest tension, {when}, lasts a step of {dt:g} s or two: not resolved"
            yield "largest tensions of a step or two: not resolved", float(tension[sharp]), text
        pulsed = _pulse_share(tension)
        if pulsed > PULSES:
            text = f"{line.name}: {pulsed:.0%} of its tension comes in pulses of one step of {dt:g} s: not resolved"
            yield "tension in pulses of one step: not resolved", float(pulsed), text
        elif _alternates(tension):
            text = f"{line.name}: tension alternates from step to step; means are good, extremes are not"
            yield "tension alternates from step to step", float(np.max(tension)), text


def _snatches(solution: Samples) -> Iterator[tuple[str, float, str]]:
    """Lines that go from slack to many times their tension at rest, of runs that start at rest: fault, size, text."""
    if solution.scene.start.kind != "static" or solution.continues or "load_errors" in solution.settings:
        return
    least = solution.tension if solution.tension_min is None else solution.tension_min
    largest = solution.tension if solution.tension_max is None else solution.tension_max
    for line, where in zip(solution.scene.lines, solution.lines, strict=True):
        rest = float(np.max(solution.tension[0, where.links]))
        slack = np.any(least[1:, where.links] < SLACK * rest, axis=0)
        top = np.max(largest[1:, where.links], axis=0, initial=0.0)
        worst = float(np.max(np.where(slack, top, 0.0)))
        if rest > 0.0 and worst > SNATCH * rest:
            text = (
                f"{line.name}: goes from slack to {worst:.4g} N, {worst / rest:.3g} times its tension at rest: peaks "
                "come from snatch loads and may be chaotic; run with --errors"
            )
            yield "snatch loads", worst, text


def _sharpest(tension: np.ndarray) -> tuple[int, int] | None:
    """Where the largest tension is, if it is a peak of a step or two."""
    step, link = np.unravel_index(np.argmax(tension), tension.shape)
    around = tension[max(step - 1, 0) : step + 2, link]
    if len(around) < 3 or around[1] <= 0.0:
        return None
    return (int(step), int(link)) if around[1] - 0.5 * (around[0] + around[2]) > SHARP * around[1] else None


def _pulse_share(tension: np.ndarray) -> float:
    """Share of all tension over time that single steps between slack ones hold, of the link with most."""
    taut = tension > 0.0
    alone = taut[1:-1] & ~taut[:-2] & ~taut[2:]
    held = np.sum(np.where(alone, tension[1:-1], 0.0), axis=0)
    return float(np.max(held / np.maximum(np.sum(np.abs(tension), axis=0), np.finfo(float).tiny)))


def _alternates(tension: np.ndarray) -> bool:
    """Whether a link's tension goes up and down at every step for a while, beside what changes smoothly."""
    saw = (tension[:-2] - 2.0 * tension[1:-1] + tension[2:]) / 4.0
    flips = saw[1:] * saw[:-1] < 0.0
    least = np.minimum(np.abs(saw[1:]), np.abs(saw[:-1])) > ALTERNATION * np.maximum(np.abs(tension[1:-2]), 1e-300)
    both = flips & least
    if len(both) < ALTERNATING:
        return False
    runs = np.lib.stride_tricks.sliding_window_view(both, ALTERNATING, axis=0)
    return bool(np.any(np.all(runs, axis=-1)))
