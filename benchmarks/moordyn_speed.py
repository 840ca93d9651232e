"""Speed on one thread, at equal or smaller error of mean and standard deviation of the fairlead tension.

Each code is measured against itself at a much smaller step: the question is what a given error costs. Ours runs twice:
as MoorDyn models lines (`damped_rope`, whose damper works on in a slack line) by `generalized_alpha`, and by default
(`rope`, energy_momentum), where slack lines chatter and the deviation is chaotic to some per cent. Two measures of the
standard deviation: of the tension at all steps, where the width of snaps counts, and of its means over 0.1 s. The goal
is judged by the first; both ratios are reported. A step counts where all smaller ones are as exact too. Where MoorDyn
takes its waves from a grid, so do we. Ours runs as one kernel. Ratios are of processor time, one thread each; wall
times stand beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from moordyn_runs import SAMPLE, Ours, Rows, theirs
from table7_edulis import turned

from dropper_jax import Scene

SPAN, SETTLED = 60.0, 10.0  # [s]
REPEATS = 3
#: Our steps in 0.1 s, from large steps to small ones; the last is the reference.
EVERY = (1, 2, 4, 5, 10, 15, 20, 40, 160)
#: MoorDyn's steps [s] from large to small, tried until one is stable, and the share of it that gives the reference.
STEPS = (0.008, 0.006, 0.004, 0.003, 0.002, 0.0015, 0.001, 0.0007, 0.0005, 0.0003)
FINER = 0.25
#: Motions of the driven top: period [s], surge and heave [m]. The first makes segments snap, the second does not.
HARD, SMOOTH = (8.0, 1.0, 1.5), (10.0, 0.3, 0.5)
#: Time between looks at MoorDyn [s] for statistics.
LOOK = 0.01
#: Our two ways: values of the scene.
WAYS = {
    "damped_rope": {"line.0.axial.law": "damped_rope", "run.integrator": "generalized_alpha"},
    "rope": {"line.0.axial.law": "rope", "run.integrator": "energy_momentum"},
}
MEASURES = {"all_steps": ("mean", "std"), "below_5_hz": ("mean", "std_of_rows")}


def driven(motion: tuple[float, float, float]) -> Callable[[float], np.ndarray]:
    """Place (3,) [m] of the driven top over time [s]."""
    period, surge, heave = motion

    def place(t: float) -> np.ndarray:
        turn = np.sin(2 * np.pi * t / period)
        return np.array([30.0 + surge * turn, 0.0, -2.0 + heave * turn])

    return place


def driven_chain(base: Scene, motion: tuple[float, float, float]) -> Scene:
    """The chain of case 1 in still water with a driven top."""
    period, surge, heave = motion
    table = base.to_dict()
    table.pop("buoy")
    table["sea"] = {"depth": 30.0}
    table["point"][1] = {"name": "buoy", "position": [30.0, 0.0, -2.0]}
    table["start"] = {"kind": "static"}
    table["effects"]["end_motion"] = {"point": "buoy", "amplitude": [surge, 0.0, heave], "period": period}
    return Scene.from_dict({**table, "name": "driven-chain"})


def speed(case: Callable[[int], Scene]) -> Iterator[dict[str, Any]]:
    """One row per comparison, printed as they come."""
    for name, motion, wanted in (("hard", HARD, 1.5), ("smooth", SMOOTH, 4.0)):
        chain = driven_chain(case(1), motion)
        yield from compare(f"chain of 12 segments, top driven, {name}", chain, wanted, LOOK, drive=driven(motion))
    yield from compare("case 1 (MoorDyn: wave grid)", case(1), 4.0, SAMPLE, grid=True)
    gridded = case(3).with_values({"sea.interpolation": "grid"})
    yield from compare("case 3, 29 components (both: wave grid)", gridded, 2.0, SAMPLE, grid=True)
    yield from compare("case 3, 29 components (both: exact kinematics)", case(3), 2.0, SAMPLE)
    longline, law = turned().with_values({"sea.interpolation": "grid"}), "rope"
    ways = {law: {}, f"{law}, as well": {"run.integrator": "generalized_alpha"}}
    yield from compare("edulis-longline (both: wave grid)", longline, 1.0, SAMPLE, ways, grid=True, across=(-60, 120))


def errors(rows: Rows, reference: Rows) -> dict[str, float] | None:
    """Relative error of mean and standard deviations of the fairlead tension."""
    a, b = rows.statistics(SETTLED), reference.statistics(SETTLED)
    if a["status"] != "ok" or b["status"] != "ok":
        return None
    return {key: abs(a["fairlead"][key] / b["fairlead"][key] - 1.0) for key in ("mean", "std", "std_of_rows")}


def compare(
    name: str, scene: Scene, wanted: float, calls: float, ways: dict[str, dict[str, Any]] = WAYS, **options: Any
) -> Iterator[dict[str, Any]]:
    """MoorDyn rk2 at its largest stable step, and each of our ways: the fastest run with errors no larger.

    Args:
        calls: time between calls of MoorDyn [s] where its wall time is taken.
    """
    print(f"speed: {name}", flush=True)
    there = largest_stable(scene, calls, **options)
    for law, values in ways.items():
        integrator = values.get("run.integrator", scene.run.integrator)
        print(f" {law}, {integrator}", flush=True)
        found = _ours(scene.with_values(values), wanted, there)
        head = {"name": name, "wanted": wanted, "law": law.split(",")[0], "integrator": integrator}
        yield {**head, "moordyn": there, **found}


def _ours(scene: Scene, wanted: float, there: dict[str, Any]) -> dict[str, Any]:
    ours = Ours.of(scene)
    reference = ours.run(EVERY[-1], SPAN)
    rows = []
    for every in EVERY[:-1]:
        run = ours.run(every, SPAN, REPEATS)
        row = {"dt_s": 0.1 / every, "status": run.status, "retried": run.retried, "errors": errors(run, reference)}
        rows.append({**row, "wall_per_s": run.wall_s / SPAN, "cpu_per_s": run.cpu_s / SPAN})
        _show(f"ours, dt {0.1 / every:.4f} s", rows[-1])
    found: dict[str, Any] = {"our_runs": rows, "our_reference": reference.statistics(SETTLED)}
    for measure, keys in MEASURES.items():
        limit = there["errors"]
        best = None
        for row in reversed(rows):  # from the smallest step on: a lucky large one is none
            if not (limit and row["errors"] and all(row["errors"][key] <= limit[key] for key in keys)):
                break
            best = row
        found[measure] = {"ratio": there["cpu_per_s"] / best["cpu_per_s"], "ours_dt_s": best["dt_s"]} if best else None
        words = f"{found[measure]['ratio']:.2f}, ours at {best['dt_s']:g} s" if best else "no run of ours is as exact"
        print(f"  goal {wanted:g} times, {measure}: {words}", flush=True)
    return found


def largest_stable(scene: Scene, calls: float, **options: Any) -> dict[str, Any]:
    """MoorDyn rk2 at the largest step of `STEPS` that is stable over the whole run."""
    for dt in STEPS:
        run = theirs(scene, dt, SPAN, look=LOOK, **options)
        if run.status != "ok" or not np.max(np.abs(run.place)) < 1e3:
            continue
        reference = theirs(scene, FINER * dt, SPAN, look=LOOK, **options)
        found = errors(run, reference)
        if found is None or max(found.values()) > 0.5:  # finite, but ringing with steps at the limit
            continue
        runs = [theirs(scene, dt, SPAN, look=calls, **options) for _ in range(REPEATS)]
        row = {"dt_s": dt, "status": "ok", "errors": found}
        row.update({"wall_per_s": min(r.wall_s for r in runs) / SPAN, "cpu_per_s": min(r.cpu_s for r in runs) / SPAN})
        _show(f"MoorDyn rk2, dt {dt:.4f} s", row)
        return {**row, "reference": reference.statistics(SETTLED)}
    none = float("nan")
    found = {"dt_s": None, "status": "no stable step", "errors": None, "reference": None}
    return {**found, "wall_per_s": none, "cpu_per_s": none}


def _show(label: str, row: dict[str, Any]) -> None:
    found, words = row["errors"], row["status"]
    if found is not None:
        words = f"off: mean {found['mean']:.1e}, std {found['std']:.1e}, below 5 Hz {found['std_of_rows']:.1e}"
    times = f"{1e3 * row['cpu_per_s']:9.3f} ms per simulated s ({1e3 * row['wall_per_s']:.3f} on the wall)"
    print(f"  {label:28s} {words:52s} {times}", flush=True)
