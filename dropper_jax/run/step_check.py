"""Check whether the step of a run is short enough: repeat the run at half the step and compare.

For a result q(h) at the step h of a scheme of order p, the error is about

    e = |q(h) - q(h/2)| 2^p/(2^p - 1)

The results are mean and window maxima of each line's tension, and the positions of the nodes. A run of up to
`WHOLE_RUN_WORK` steps of a link is repeated completely; a longer one in short stretches that start from its states at
fixed times. What is repeated thus follows from the scene alone. The compiled program of the run has step and count as
arguments, so no program is compiled again.

For a single line the angle error that the step leaves over a window of a fit is also found: there every window has a
start of its own, so that errors do not accumulate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.integrators import INTEGRATORS
from dropper_jax.load.scene import Scene
from dropper_jax.run.chunks import Program, RunOutcome
from dropper_jax.run.resolution import unresolved_peak
from dropper_jax.run.samples import TOO_LONG, Kind, Samples, is_finished
from dropper_jax.scene import whole_lines
from dropper_jax.stepping.integrate import Trajectory

#: Steps times links up to which a run is repeated completely: about 10 s for a system of lines, 1 s for one line.
#: Stretches miss what happens in a few steps: they show 1.3 % for a farm whose maxima are off by 30 %.
WHOLE_RUN_WORK = 1_000_000
#: Steps times links up to which a run is repeated without being asked for: 0.1 s or less.
CHEAP_WORK = 20_000
#: Windows of a complete run, maximum number of stretches of others, and their maximum fraction of the run time.
WINDOWS, REPEATED_STRETCHES, REPEATED_SHARE = 8, 32, 0.05
#: Fraction of the maximum tension of all lines, and travel as a fraction of the longest line, below which they are not
#: checked separately.
SMALL_TENSION, TRAVEL_AT_REST = 0.1, 1e-3
#: Estimated errors above which a run warns, for complete runs and for stretches, whose maxima depend on few steps
#: (`benchmarks/long_steps.py`). If another error exceeds `ROUGH` the order of the scheme is not reached, and half the
#: limit applies. Means are excepted, since unresolved maxima do not affect them.
WARNED = {"mean_tension": 0.02, "window_maxima": 0.04, "positions": 0.03}
WARNED_STRETCHES = {**WARNED, "window_maxima": 0.07}
#: Estimated error above which a result is unusable, and that of the advised step. The error then converges with this
#: fraction of the scheme's order, which is between 0.5 (whipping droppers) and 1 (pendulums).
ROUGH, ERROR_TARGET, LESS = 0.1, 0.01, 0.75
#: Chaos: the distance of the two runs is below 1 % of the travel for three times the first swing, and it then reaches
#: 30 % in less than four times this time. A linear drift of the phase takes 30 times as long.
CHAOS_RESOLVED, SEPARATED, SWINGS, SUDDEN = 0.01, 0.3, 3, 4.0
FULL_RUN = "the whole run"
#: Names of the results by their keys.
WORDS = {"mean_tension": "mean tensions", "window_maxima": "largest tensions", "positions": "positions"}


class _Compared(NamedTuple):
    """A window of the run and of the run at half the step: means, mean absolute values and maxima of each line's
    tension (2, lines) [N], and the maximum distance of a node at saved times (k,) [m]."""

    mean: np.ndarray
    size: np.ndarray
    top: np.ndarray
    distance: np.ndarray


def is_repeated(scene: Scene, limit: int) -> bool:
    """Whether the steps of a run times its links are at most this limit."""
    return scene.run.steps * sum(line.links for line in scene.lines) <= limit


def stretch_starts(scene: Scene) -> list[int]:
    """Saves of a run at which its repeated stretches start; none if it is repeated completely."""
    if is_repeated(scene, WHOLE_RUN_WORK):
        return []
    saves = scene.run.saves
    count = max(1, min(REPEATED_STRETCHES, int(REPEATED_SHARE * saves / 2)))
    return [saves * (i + 1) // (count + 1) for i in range(count)]


def with_step_check(solution: Kind, run: Program, outcome: RunOutcome, asked: bool = True) -> Kind:
    """The solution with the estimated errors of its step, a warning if they are large, and a status if it is unusable.

    Args:
        asked: otherwise the solution only gets a warning, and only if it is unusable.
    """
    if not is_finished(solution) or outcome.beside is not None:
        return solution
    check = check_stretches if outcome.passed else check_full_run
    try:
        found = check(solution, run, outcome)
    except KeyboardInterrupt:  # the run itself is complete
        return solution
    if not asked:
        unusable = found is not None and not _usable(found)
        notes = _warnings(found, solution) if unusable else ()
        return replace(solution, warnings=(*solution.warnings, *notes))
    if found is None:
        dt = solution.settings["dt"]
        note = f"time step: {dt:g} s is not checked, because a step fails at {0.5 * dt:g} s; compare with another --dt"
        return replace(solution, warnings=(*solution.warnings, note))
    settings, warned = {**solution.settings, "step_check": found}, _warnings(found, solution)
    status = TOO_LONG if solution.status == "ok" and warned and not _usable(found) else solution.status
    return replace(solution, settings=settings, status=status, warnings=(*solution.warnings, *warned))


def check_full_run(solution: Samples, run: Program, outcome: RunOutcome) -> dict[str, Any] | None:
    """Estimated errors of a run, from the complete run at half the step."""
    saves, carry, parts, starts = len(outcome.trajectory.r), run.carry, [], []
    bounds = np.linspace(0, saves, min(WINDOWS, saves) + 1).astype(int)
    for first, last in zip(bounds, bounds[1:], strict=False):
        _, rows = run.go_on.advance_again(carry, min(last - first, _angle_saves(solution)), 1)
        carry, fine = run.go_on.advance_at_half_step(carry, last - first)
        if fine is None or rows is None:
            return None
        parts.append(_compare(solution, _rows(outcome.trajectory, first, last), fine))
        starts.append((rows.r, fine.r[1::2]))
    travel = _travel(solution, outcome.trajectory.r)
    separation = None if travel is None else np.concatenate([part.distance for part in parts]) / travel
    chaos = None if separation is None else _chaos(separation, outcome.trajectory.r)
    found = {
        "repeated": FULL_RUN,
        **_with_peaks(solution, outcome.trajectory, _tensions(solution, parts, chaos is not None)),
        "positions": None if separation is None else _error(solution, float(np.sqrt(np.mean(separation[:chaos] ** 2)))),
        "chaotic_from_s": None if chaos is None else float(solution.t[1 + chaos]),
        "angles_rad": _angle_error(solution, starts),
    }
    return {**found, "dt_for_1_percent_s": _advise_step(solution, found)}


def check_stretches(solution: Samples, run: Program, outcome: RunOutcome) -> dict[str, Any] | None:
    """Estimated errors from stretches at half the step, which start from carries of the run."""
    saves, trajectory = len(outcome.trajectory.r), outcome.trajectory
    count = len(outcome.passed)
    length = max(1, int(REPEATED_SHARE * saves / (2 * count)))
    parts, separation, moved, starts = [], [], [], []
    for done, carry in outcome.passed:
        rows = _rows(trajectory, done, min(done + length, saves))
        fine = run.go_on.advance_at_half_step(carry, len(rows.r))[1]
        if fine is None:
            return None
        parts.append(_compare(solution, rows, fine))
        starts.append((rows.r, fine.r[1::2]))
        separation.append(fine.r[-1] - rows.r[-1])
        moved.append(rows.r[-1] - np.asarray(carry.state.r))
    travel = _travel(solution, np.stack([np.asarray(carry.state.r) for _, carry in outcome.passed]))
    off = None
    if travel is not None and np.any(moved):
        # an error that is along the path everywhere is a phase drift, which accumulates; other errors do not
        separation, moved = np.array(separation), np.array(moved)
        path, distance = (float(np.sqrt(np.mean(_largest(a) ** 2))) / travel for a in (moved, separation))
        drift = abs(float(np.sum(separation * moved))) / float(np.sum(moved**2))
        # errors of stretches accumulate along a path of this many travels: five swings, each in both directions
        off = _error(solution, distance + drift * min(path * saves / length, 10.0))
    found = {
        "repeated": f"{count} stretches of {length * solution.settings['save_every']} steps",
        **_with_peaks(solution, trajectory, _tensions(solution, parts, False), stretches=True),
        "positions": off,
        "chaotic_from_s": None,
        "angles_rad": _angle_error(solution, starts),
    }
    return {**found, "dt_for_1_percent_s": _advise_step(solution, found)}


def _angle_saves(solution: Samples) -> int:
    """Saves over which the angle error is found: half the shortest link's period, about a window of a fit."""
    shortest = min(float(np.min(line.length)) for line in solution.scene.lines)
    interval = solution.settings["dt"] * solution.settings["save_every"]
    return max(1, round(np.pi * np.sqrt(shortest / 9.81) / interval))


def _angle_error(solution: Samples, starts: list[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Mean over stretches of the RMS angle error [rad] of a single line's links; None for several lines.

    The change of a link's vector over its length bounds the change of its angle. The error of shorter stretches is
    extrapolated linearly.

    Args:
        starts: free nodes (k, nodes, 3) [m] of the run and of the run at half the step, from a common state.
    """
    if solution.scene.branched:
        return None
    found, length = [], solution.scene.lines[0].length
    for rows, fine in starts:
        count = min(len(rows), _angle_saves(solution))
        # the nodes between two fixed end points, or from a fixed one to the free end
        apart = np.pad(rows[:count] - fine[:count], ((0, 0), (1, len(length) - rows.shape[1]), (0, 0)))
        turned = np.sum(np.diff(apart, axis=1) ** 2, axis=2) / np.square(length)
        found.append(float(np.sqrt(np.mean(turned))) * _angle_saves(solution) / count)
    return _error(solution, float(np.mean(found)))


def _with_peaks(
    solution: Samples, trajectory: Trajectory, found: dict[str, float | None], stretches: bool = False
) -> dict[str, float | bool | None]:
    """Errors of tensions, in which maxima are unresolved if a link snaps within a step that is too long for it.

    A snap lasts about an axial period of its link, `2 pi/omega`, `omega^2 = 4 EA/(L m)`. Steps longer than this miss
    its peak, half of such a step as well, so the two agree on maxima that are both too low. Stretches of few steps also
    miss the maximum tension of a line if it lasts one or two steps.
    """
    if solution.settings["save_every"] > 1 or found["window_maxima"] is None:
        return {**found, "snaps_unresolved": False, "snap_period_s": None}
    tension, missed = trajectory.tension, False
    least = SMALL_TENSION * np.max(tension)
    # rigid links do not snap
    square = [np.inf * one.length if one.EA is None else one.length * one.mass / one.EA for one in solution.scene.lines]
    snapped = np.any((tension[:-1] <= 0.0) & (tension[1:] >= least), axis=0)
    shortest = float(np.pi * np.sqrt(np.min(np.concatenate(square)[snapped], initial=np.inf)))
    snaps = shortest < solution.settings["dt"]
    if stretches:
        lines = [tension[:, line.links] for line in whole_lines(solution.scene)]
        missed = any(np.max(one) >= least and unresolved_peak(one) is not None for one in lines)
    # fraction by which the maximum of an unresolved peak is low: up to this if it lasts a step or two, else more
    low = 0.13 * (snaps or missed)
    found = {**found, "window_maxima": max(found["window_maxima"], low)}
    return {**found, "snaps_unresolved": snaps, "snap_period_s": shortest if np.isfinite(shortest) else None}


def _rows(trajectory: Trajectory, first: int, last: int) -> Trajectory:
    return trajectory._replace(r=trajectory.r[first:last], tension=trajectory.tension[first:last])


def _compare(solution: Samples, rows: Trajectory, fine: Trajectory) -> _Compared:
    """Rows (k, ...) of the run and (2 k, ...) of the run at half the step."""
    lines = [line.links for line in whole_lines(solution.scene)]
    first, links = [line.start for line in lines], [line.stop - line.start for line in lines]
    # the same times if states are some steps apart: more times would have larger maxima
    every = slice(None) if solution.settings["save_every"] == 1 else slice(1, None, 2)
    both = rows.tension, fine.tension[every]
    mean, size = (
        np.stack([np.add.reduceat(change(tension).mean(axis=0), first) / links for tension in both])
        for change in (np.asarray, np.abs)
    )
    top = np.stack([np.maximum.reduceat(tension.max(axis=0), first) for tension in both])
    return _Compared(mean, size, top, _largest(rows.r - fine.r[1::2]))


def _largest(distance: np.ndarray) -> np.ndarray:
    """Maximum distance of a node (k,) of (k, nodes, 3)."""
    return np.sqrt(np.max(np.sum(distance**2, axis=2), axis=1))


def _travel(solution: Samples, nodes: np.ndarray) -> float | None:
    """Maximum extent [m] of a node's path (k, nodes, 3); None for a run at rest."""
    travel = float(np.max(np.linalg.norm(np.ptp(nodes, axis=0), axis=1)))
    return travel if travel > TRAVEL_AT_REST * max(line.total for line in solution.scene.lines) else None


def _chaos(separation: np.ndarray, nodes: np.ndarray) -> int | None:
    """Saved time after which the two runs are different motions: small errors grow at a rate that only chaos has."""
    if not np.any(separation > SEPARATED):
        return None
    shift = _largest(nodes - nodes[0])
    swing = int(np.argmax(shift > 0.5 * np.max(shift)))
    resolved, off = (int(np.argmax(separation > limit)) for limit in (CHAOS_RESOLVED, SEPARATED))
    return resolved if resolved > SWINGS * swing and off < SUDDEN * resolved else None


def _tensions(solution: Samples, parts: list[_Compared], chaotic: bool) -> dict[str, float | None]:
    """Estimated errors of mean tensions and window maxima of the worst line."""
    found = {}
    for name, values, sizes in (("mean_tension", "mean", "size"), ("window_maxima", "top", "top")):
        value = np.stack([getattr(part, values) for part in parts])
        change = value[:, 0] - value[:, 1]
        scale = np.abs(np.mean([getattr(part, sizes) for part in parts], axis=0)[1])
        scale = np.maximum(scale, SMALL_TENSION * np.max(scale))
        off = np.abs(change.mean(axis=0))
        if chaotic:  # different motions differ by chance
            off = np.maximum(off - 2.0 * change.std(axis=0) / np.sqrt(len(change)), 0.0)
        found[name] = _error(solution, float(np.max(off / scale))) if np.all(scale > 0.0) else None
    return found


def _error(solution: Samples, change: float) -> float:
    """The error of the step that follows from the change at half the step."""
    gain = 2.0 ** _order(solution)
    return change * gain / (gain - 1.0)


def _order(solution: Samples) -> int:
    return INTEGRATORS[solution.settings["integrator"]].order


def _advise_step(solution: Samples, found: dict[str, Any]) -> float:
    """The step [s] for an error of 1 %, two digits."""
    worst = max(found[name] or 1e-300 for name in WARNED)
    order = _order(solution) * (1.0 if worst < ROUGH else LESS)
    dt = solution.settings["dt"] * min(1.0, (ERROR_TARGET / worst) ** (1.0 / order))
    if found["snaps_unresolved"]:  # a tenth of a period resolves its peak
        dt = min(dt, 0.1 * found["snap_period_s"])
    return float(f"{dt:.2g}")


def is_warned(found: dict[str, Any], name: str) -> bool:
    """Whether an estimated error requires a warning."""
    if found[name] is None:
        return False
    limit = (WARNED if found["repeated"] == FULL_RUN else WARNED_STRETCHES)[name]
    rough = name != "mean_tension" and any((found[other] or 0.0) > ROUGH for other in WARNED if other != name)
    return found[name] > (0.5 * limit if rough else limit) or _is_lower_bound(found, name)


def _is_lower_bound(found: dict[str, Any], name: str) -> bool:
    """Whether the error may be much larger than its estimate: maxima of unresolved snaps, and means if the path is
    wrong, which stretches do not show because they start from states of the run."""
    if name == "mean_tension":
        return found["repeated"] != FULL_RUN and (found["positions"] or 0.0) > ROUGH
    return name == "window_maxima" and found.get("snaps_unresolved", False)


def shorter_step(solution: Samples) -> float | None:
    """The step [s] for an error of 1 % if the check of a run warns; None if it does not warn or was not made."""
    found = solution.settings.get("step_check")
    return found["dt_for_1_percent_s"] if found and any(is_warned(found, name) for name in WARNED) else None


def step_words(found: dict[str, Any]) -> str:
    """The estimated errors in words."""
    off = _off(found, [name for name in WORDS if found[name] is not None])
    chaos = found["chaotic_from_s"]
    until = "" if chaos is None else f"; chaotic from {chaos:.3g} s: positions until then, tensions above chance"
    return f"{off or 'no motion'}; from {found['repeated']} at half the step{until}"


def _off(found: dict[str, Any], names: list[str]) -> str:
    sizes = {name: f"{100.0 * found[name]:.2g} %{' of the travel' if name == 'positions' else ''}" for name in names}
    sizes |= {name: f"at least {sizes[name]}" for name in names if _is_lower_bound(found, name)}
    if found["chaotic_from_s"] is not None:
        sizes |= {name: "no more than chance" for name in names if found[name] == 0.0}
    by = [f"{WORDS[name]} {'by' if i else 'are off by about'} {size}" for i, (name, size) in enumerate(sizes.items())]
    return ", ".join(by).replace("about no more", "no more").replace("about at least", "at least")


def _usable(found: dict[str, Any]) -> bool:
    return max(found[name] or 0.0 for name in WARNED) <= ROUGH


def _warnings(found: dict[str, Any], solution: Samples) -> tuple[str, ...]:
    off = _off(found, [name for name in WORDS if is_warned(found, name)])
    if not off:
        return ()
    use = "usable as a rough estimate" if _usable(found) else "not usable"
    dt, better = solution.settings["dt"], f"--dt {found['dt_for_1_percent_s']:g}"
    if found["snap_period_s"] is not None and solution.scene.run.accuracy is None:
        better += ", or with --accuracy 0.01, whose steps follow snaps"
    return (f"time step: {dt:g} s is too long: {off}: {use}; run with {better}",)
