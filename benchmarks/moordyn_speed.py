"""Speed on one thread, at equal or smaller error of mean and standard deviation of the fairlead tension.

Each code is measured against itself at a much smaller step: the question is what a given error costs, and the codes
differ in what a slack line does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from moordyn_runs import Ours, Rows, theirs

from dropper_jax import Scene

SPAN, SETTLED = 60.0, 10.0  # [s]
REPEATS = 3
#: Our steps in 0.1 s, from large steps to small ones; the last is the reference.
EVERY = (1, 2, 4, 5, 10, 20, 40, 160)
#: MoorDyn's steps [s] from large to small, tried until one is stable, and the share of it that gives the reference.
STEPS = (0.008, 0.006, 0.004, 0.003, 0.002, 0.0015, 0.001, 0.0007, 0.0005, 0.0003)
FINER = 0.25
PERIOD, SURGE, HEAVE = 8.0, 1.0, 1.5


def place(t: float) -> np.ndarray:
    """Where the driven top is (3,) [m]."""
    turn = 2 * np.pi * t / PERIOD
    return np.array([30.0 + SURGE * np.sin(turn), 0.0, -2.0 + HEAVE * np.sin(turn)])


def driven_chain(base: Scene) -> Scene:
    """The chain of case 1 in still water, its top driven 1 m to and fro and 1.5 m up and down in 8 s."""
    table = base.to_dict()
    table.pop("buoy")
    table["sea"] = {"depth": 30.0}
    table["point"][1] = {"name": "buoy", "position": [30.0, 0.0, -2.0]}
    table["start"] = {"kind": "static"}
    table["effects"]["end_motion"] = {"point": "buoy", "amplitude": [SURGE, 0.0, HEAVE], "period": PERIOD}
    return Scene.from_dict({**table, "name": "driven-chain"})


def speed(case: Callable[[int], Scene]) -> Iterator[dict[str, Any]]:
    """One row per comparison, printed as they come."""
    yield compare("chain of 12 segments, top driven", driven_chain(case(1)), 3.0, drive=place, look=0.01)
    yield compare("case 1", case(1), 5.0)
    yield compare("case 3, 29 components", case(3), 10.0)


def errors(rows: Rows, reference: Rows) -> dict[str, float] | None:
    """Relative error of mean and standard deviation of the fairlead tension."""
    a, b = rows.statistics(SETTLED), reference.statistics(SETTLED)
    if a["status"] != "ok" or b["status"] != "ok":
        return None
    return {key: abs(a["fairlead"][key] / b["fairlead"][key] - 1.0) for key in ("mean", "std")}


def compare(name: str, scene: Scene, wanted: float, **options: Any) -> dict[str, Any]:
    """MoorDyn rk2 at its largest stable step, and our fastest run with errors no larger."""
    print(f"speed: {name}", flush=True)
    there = largest_stable(scene, **options)
    ours = Ours.of(scene)
    runs = {every: ours.run(every, SPAN, REPEATS) for every in EVERY}
    reference = runs.pop(EVERY[-1])
    rows = []
    for every, run in runs.items():
        found = errors(run, reference)
        rows.append({"dt_s": 0.1 / every, "status": run.status, "errors": found, "wall_per_s": run.wall_s / SPAN})
        _show(f"ours, dt {0.1 / every:.4f} s", rows[-1])
    limit = there["errors"]
    good = [r for r in rows if limit and r["errors"] and all(r["errors"][key] <= limit[key] for key in limit)]
    best = min(good, key=lambda r: r["wall_per_s"]) if good else None
    ratio = there["wall_per_s"] / best["wall_per_s"] if best else None
    means = [
        r["fairlead"] if r["status"] == "ok" else None for r in (reference.statistics(SETTLED), there["reference"])
    ]
    print(
        f"  goal {wanted:g} times: "
        + (f"{ratio:.2f} (ours at {best['dt_s']:g} s)" if best else "no run of ours is as exact")
    )
    return {
        "name": name,
        "wanted": wanted,
        "ratio": ratio,
        "ours": best,
        "our_runs": rows,
        "moordyn": there,
        "our_reference_fairlead": means[0],
        "moordyn_reference_fairlead": means[1],
    }


def largest_stable(scene: Scene, **options: Any) -> dict[str, Any]:
    """MoorDyn rk2 at the largest step of `STEPS` that is stable over the whole run."""
    for dt in STEPS:
        run = theirs(scene, dt, SPAN, **options)
        if run.status != "ok" or not np.max(np.abs(run.place)) < 1e3:
            continue
        reference = theirs(scene, FINER * dt, SPAN, **options)
        found = errors(run, reference)
        if found is None or max(found.values()) > 0.5:  # finite, but ringing with steps at the limit
            continue
        walls = [run.wall_s] + [theirs(scene, dt, SPAN, **options).wall_s for _ in range(REPEATS - 1)]
        row = {"dt_s": dt, "status": "ok", "errors": found, "wall_per_s": min(walls) / SPAN}
        _show(f"MoorDyn rk2, dt {dt:.4f} s", row)
        return {**row, "reference": reference.statistics(SETTLED)}
    return {
        "dt_s": None,
        "status": "no stable step",
        "errors": None,
        "wall_per_s": float("nan"),
        "reference": {"status": "-"},
    }


def _show(label: str, row: dict[str, Any]) -> None:
    found = row["errors"]
    words = row["status"] if found is None else f"mean {found['mean']:.1e}, std {found['std']:.1e} off"
    print(f"  {label:28s} {words:36s} {1e3 * row['wall_per_s']:9.3f} ms per simulated s", flush=True)
