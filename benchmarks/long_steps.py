"""Runs with steps that are too long: are they warned of, and only they?

    python benchmarks/long_steps.py [--scenes NAME ...] [--out FILE]

Every packaged scene runs at 3, 10 and 30 times its step, and at its step and half of it, over 5 observed periods and at
least 200 steps. The truth is a run at a third of the packaged step, over the same time. Errors are those of each line's
mean tension (limit 5 %) and mean of its maxima in windows of a period (10 %), and of the positions (RMS in time of the
largest distance of a node, 10 % of the largest travel). Lines with less than 10 % of the largest tension count relative
to that, as in the check. Where the truth differs from a run at half its own step by a third of the limit, the quantity
is left out. Each run is checked twice: as a whole, and by stretches as if it were long. Writes
results/long_steps.json.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np
from study import RESULTS, Found, collect, command, say, store, stored, timed

import dropper_jax as dj
from dropper_jax.run import chunks, step_check
from dropper_jax.run.samples import TOO_LONG
from dropper_jax.scene import whole_lines

FACTORS = (0.5, 1, 3, 10, 30)
#: Steps and observed periods of a run at least, and parts of the packaged step that the truth takes.
STEPS, PERIODS, FINER = 200, 5, 3
REACHED_END = ("ok", TOO_LONG)
#: Allowed errors, and the error below which a warning at the packaged step or half of it is a false alarm.
LIMITS = {"mean_tension": 0.05, "window_maxima": 0.1, "positions": 0.1}
FALSE = 0.01
#: Longest time of the truth over the packaged step: 5 periods beyond are left out.
LONGEST = 20_000
#: Links above which the truth saves only whole packaged steps. Of fewer links it saves every step, so that one compiled
#: program serves all runs of a scene, which halves its time.
MANY_LINKS = 60
#: Windows where nothing swings.
WINDOWS = 8
#: Scenes that the check was tuned on: those of at most this number of links, and these.
TUNED_LINKS = 7
TUNED_ON = (
    "paper-case-1",
    "paper-case-1-pitching",
    "paper-case-1-table-6",
    "paper-case-2-table-6",
    "paper-case-5-table-6",
)


def observed_period(run: dj.Solution) -> float | None:
    """Mean period [s] of the node that travels farthest, by crossings of its mean; None of fewer than three."""
    node = int(np.argmax(np.linalg.norm(np.ptp(run.positions, axis=0), axis=1)))
    path = run.positions[:, node] - run.positions[:, node].mean(axis=0)
    along = path @ np.linalg.svd(path, full_matrices=False)[2][0]
    crossed = np.flatnonzero(along[1:] * along[:-1] < 0)
    return None if len(crossed) < 3 else 2.0 * float(np.mean(np.diff(run.t[crossed])))


def errors(run: dj.Solution, truth: dj.Solution, until: float, window: float) -> dict[str, float]:
    """Errors of a run up to a time [s]; both have saved times in common."""
    steps = run.t[1] - run.t[0], truth.t[1] - truth.t[0]
    common = max(steps)
    ours, theirs = (one.positions[:: round(common / h)] for one, h in zip((run, truth), steps, strict=True))
    k = min(len(ours), len(theirs), int(until / common + 1e-6) + 1)
    travel = float(np.max(np.linalg.norm(np.ptp(theirs[:k], axis=0), axis=1)))
    still = travel < step_check.TRAVEL_AT_REST * max(line.total for line in run.scene.lines)
    apart = np.max(np.linalg.norm(ours[:k] - theirs[:k], axis=2), axis=1)
    found = {"positions": 0.0 if still else float(np.sqrt(np.mean(apart**2))) / travel}
    (mean, top, _), (right, right_top, sizes) = (_loads(one, common * (k - 1), window) for one in (run, truth))
    for name, off, size in (("mean_tension", mean - right, sizes), ("window_maxima", top - right_top, right_top)):
        scale = np.maximum(np.abs(size), step_check.SMALL_TENSION * np.max(np.abs(size)))
        found[name] = float(np.max(np.abs(off) / scale)) if np.all(scale > 0) else 0.0
    return found


def _loads(run: dj.Solution, until: float, window: float) -> list[np.ndarray]:
    """Mean tension, mean of window maxima and mean size of the tension of each line."""
    rows = slice(1, int(np.searchsorted(run.t, until * (1 + 1e-9), side="right")))
    part = np.minimum((run.t[rows] - 1e-9) / window, until / window - 0.5).astype(int)
    starts = np.flatnonzero(np.diff(part, prepend=-1))
    tensions = [run.tension[rows, line.links] for line in whole_lines(run.scene)]
    top = np.array([np.maximum.reduceat(one.max(axis=1), starts).mean() for one in tensions])
    return [np.array([one.mean() for one in tensions]), top, np.array([np.abs(one).mean() for one in tensions])]


def judge(name: str) -> Found:
    """All runs of a scene against its truth, or why the scene is left out."""
    scene = dj.load_scene(name)
    dt = scene.run.dt * scene.run.save_every
    if scene.run.save_every > 1 or scene.run.accuracy or scene.run.error_tolerance:
        return {"left_out": f"saves every {dt:g} s"}
    span = STEPS * max(FACTORS) * dt
    truth, finer = (_truth(scene, span, parts) for parts in (FINER, 2 * FINER))
    if truth.status != "ok" or finer.status != "ok":
        return {"left_out": f"the truth ends {truth.failure or finer.failure}"}
    period = observed_period(truth) or 0.0
    if PERIODS * period > LONGEST * dt:
        return {"left_out": f"its period of {period:.3g} s"}
    if PERIODS * period > span:
        truth, finer = (_truth(scene, PERIODS * period, parts) for parts in (FINER, 2 * FINER))
    rows = []
    for factor in FACTORS:
        until = max(STEPS * max(factor, 1) * dt, PERIODS * period)
        window = min(period or until / WINDOWS, until / 2)
        run, row = checked(scene, factor * dt, until)
        if run.status in REACHED_END:
            own = errors(truth, finer, until, window)
            row["left_out"] = [key for key, limit in LIMITS.items() if own[key] > limit / 3]
            row["errors"] = errors(run, truth, until, window)
        rows.append({"factor": factor, **row})
    return {"dt": dt, "period": period, "runs": rows}


def checked(scene: dj.Scene, dt: float, until: float) -> tuple[dj.Solution, Found]:
    """A run with its checks, as a whole and by stretches."""
    row: Found = {"dt": dt, "duration": until}
    ways = {
        "whole": (np.inf, step_check.REPEATED_SHARE),
        "stretches": (0, 0.5),  # a long run has 32 of a step or more within its share
    }
    for mode, (work, share) in ways.items():
        with patch.multiple(step_check, WHOLE_RUN_WORK=work, REPEATED_SHARE=share):
            run = dj.simulate(scene, dt=dt, duration=until, step_check=True)
        found = run.settings.get("step_check")
        row[mode] = found and {key: found[key] for key in ("repeated", *LIMITS, "chaotic_from_s", "snaps_unresolved")}
    return run, row | {"status": run.status}


def _truth(scene: dj.Scene, span: float, parts: int) -> dj.Solution:
    """A run at a part of the packaged step, at whole packaged steps."""
    many = sum(line.links for line in scene.lines) > MANY_LINKS
    saved, kernel = (parts, chunks.WORTH_ONE_KERNEL) if many else (1, LONGEST * parts)
    with patch.object(chunks, "WORTH_ONE_KERNEL", kernel):
        run = dj.simulate(scene, dt=scene.run.dt / parts, duration=span, save_every=saved, step_check=False)
    rows = slice(None, None, parts // saved)
    return replace(run, t=run.t[rows], positions=run.positions[rows], tension=run.tension[rows])


def counts(scenes: list[Found], mode: str) -> Found:
    """Wrong results at long steps, right ones at the packaged step and half of it, and where the check misses them."""
    judged = [
        (f"{s['scene']} at {row['factor']:g} times its step: {key} {off:.2g}", key, off, row)
        for s in scenes
        for row in s.get("runs", [])
        for key, off in row.get("errors", {}).items()
        if key not in row["left_out"]
    ]
    warned = {case: bool(row[mode]) and step_check.is_warned(row[mode], key) for case, key, _, row in judged}
    wrong = [case for case, key, off, row in judged if row["factor"] > 1 and off > LIMITS[key]]
    right = [case for case, _, off, row in judged if row["factor"] <= 1 and off < FALSE]
    return {
        "wrong": len(wrong),
        "without_warning": [case for case in wrong if not warned[case]],
        "right": len(right),
        "false_alarms": [case for case in right if warned[case]],
    }


def summary(scenes: list[Found]) -> Found:
    """Counts of the scenes that the check was tuned on, and of the others that judge it."""
    tuned = [row for row in scenes if row["scene"] in TUNED_ON or row["links"] <= TUNED_LINKS]
    groups = {"tuned": tuned, "judged": [row for row in scenes if row not in tuned]}
    return {
        name: {
            "scenes": [row["scene"] for row in group if "runs" in row],
            **{mode: counts(group, mode) for mode in ("whole", "stretches")},
        }
        for name, group in groups.items()
    }


@command(scenes=list(dj.scene_names()), out=RESULTS / "long_steps.json")
def main(args) -> None:
    links = {name: sum(line.links for line in dj.load_scene(name).lines) for name in dj.scene_names()}

    def rows() -> Iterator[Found]:
        for name in sorted(args.scenes, key=links.__getitem__):
            try:
                found, times = timed(partial(judge, name))
            except dj.SceneError as error:
                found, times = {"left_out": str(error)}, {"processor_s": 0.0}
            yield {"scene": name, **found, "seconds": round(times["processor_s"], 1), "links": links[name]}

    collect(args.out, {"scenes": rows()}, by="scene")
    found = stored(args.out)
    found |= summary(found["scenes"])
    store(args.out, found)
    say(found)
