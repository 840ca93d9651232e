"""The paper's cases and a driven chain in MoorDyn v2 and here: motions, tensions, conventions, and speed on one thread.

    python benchmarks/against_moordyn.py [--only conventions|cases|steps|schemes|speed|peaks] [--rows TEXT]

Needs the extra `moordyn`; takes about 15 minutes, a few more with the explicit schemes,
an hour more with peaks. `--rows driven` measures the rows of speed or peaks whose names have `driven`.

Writes results/moordyn.json and prints what it finds. Both codes start
from the paper's positions. MoorDyn's component waves (WaveKin 7) carry no dynamic pressure: an upright cylinder held
in place then feels almost no heave force (measured in phase with the wave: -3 N where theory has 383 N, 374 N with a
wave grid). Motions and tensions are therefore compared on its wave grid (WaveKin 3); component waves are for speed
only.
"""

from __future__ import annotations

import one_thread  # noqa: F401 - before JAX

# isort: split

import os
from typing import Any

from explicit_schemes import schemes
from moordyn_conventions import conventions
from moordyn_runs import Ours, theirs
from moordyn_speed import peaks, speed
from paper_cases import TABLE_7, case
from study import describe, options, say, store, stored, versions

SPAN, SETTLED = 150.0, 50.0  # [s]: the whole run, and from where on it counts as settled
RATIOS = (1.0, 0.1, 0.0)
EVERY = 5  # our steps in 0.1 s: dt = 0.02 s
#: Our steps in 0.1 s for the comparison of step sizes: dt = 0.05, 0.02, 0.01 and, as reference, 0.001 s.
STEP_COUNTS = (2, 5, 10, 100)
#: MoorDyn's step [s] for each internal damping ratio: stronger dampers need smaller ones.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}


def both(number: int, ratio: float) -> dict[str, Any]:
    """One case in both codes: statistics of the whole run and of its settled part."""
    scene = case(number, ratio)
    here = Ours.of(scene).run(EVERY, SPAN)
    there = theirs(scene, STEPS[ratio], SPAN, look=0.01, grid=True)
    found: dict[str, Any] = {"case": number, "damping_ratio": ratio}
    for name, rows, dt in (("ours", here, 0.1 / EVERY), ("moordyn", there, STEPS[ratio])):
        found[name] = {
            "dt_s": dt,
            "wall_s": rows.wall_s,
            "whole": rows.statistics(),
            "settled": rows.statistics(SETTLED),
        }
    say(found)
    return found


def step_sizes(ratio: float) -> list[dict[str, Any]]:
    """Case 1 here at several steps: mean anchor tension after SETTLED, and its difference from the smallest step's."""
    ours = Ours.of(case(1, ratio))
    rows = []
    for every in STEP_COUNTS:
        run = ours.run(every, SPAN)
        settled = run.statistics(SETTLED)
        rows.append({"damping_ratio": ratio, "dt_s": 0.1 / every, "wall_s": run.wall_s, **settled})
    for row in rows:
        row["mean_against_smallest_step"] = row["anchor"]["mean"] / rows[-1]["anchor"]["mean"] - 1.0
        say(row)
    return rows


def main() -> None:
    given = options(__doc__, only=(None, "conventions", "cases", "steps", "schemes", "speed", "peaks"), rows="")
    only = given.only
    found: dict[str, Any] = stored("moordyn", {}) if only else {}
    found.update(
        {
            "schema": 1,
            "machine": describe(),
            "versions": versions("moordyn", "jax", "dropper-jax", "numpy"),
            "load_average": os.getloadavg()[0],
            "table_7": TABLE_7,
        }
    )

    def keep() -> None:
        store("moordyn", found)

    if only in (None, "conventions"):
        found["case_4"] = conventions()
        keep()
    if only in (None, "cases"):
        found["cases"] = []
        for number, ratio in [*((1, ratio) for ratio in RATIOS), (2, 0.1), (3, 0.1), (5, 0.1)]:
            found["cases"].append(both(number, ratio))
            keep()
    if only in (None, "steps"):
        found["step_sizes"] = [row for ratio in RATIOS for row in step_sizes(ratio)]
        keep()
    if only in (None, "schemes"):
        found["schemes"] = []
        for row in schemes(case):
            found["schemes"].append(row)
            keep()
    for part, measure in (("speed", speed), ("peaks", peaks)):
        if only in (None, part):
            others = [row for row in found.get(part, []) if given.rows and given.rows not in row["name"]]
            measured: list[dict[str, Any]] = []
            for row in measure(case, only=given.rows):
                measured.append(row)
                found[part] = measured + others
                keep()


if __name__ == "__main__":
    main()
