"""Largest anchor tensions of the paper's five cases from Table 6, with the spread of runs that differ by rounding.

    python benchmarks/paper_peaks.py [--cases 1 2 3 4 5] [--runs 8]

A case snaps: runs of one accuracy that differ by rounding (all masses changed by parts in 10^12) have other peaks.
Writes results/paper_peaks.json; about an hour.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from study import Found, Rows, collect, columns, command, joined, percent, say, table_of

import dropper_jax as dj

#: Largest anchor tension [kN] of each case at the smallest equal steps that were tried (0.16 to 1.25 ms).
EQUAL_STEPS = {1: 83.3, 2: 73.1, 3: 46.6, 4: 4.70, 5: 100.0}
#: Simulated time [s], accuracy, and finer ones.
DURATION = 150.0
ACCURACY = 0.01
FINER = (0.0025, 0.0003)
#: Relative change of all masses from one run to the next.
ROUNDING = 1e-12


def one_run(case: int, number: int, accuracy: float = ACCURACY) -> Found:
    """Peak of the first link [kN] and its time [s] in a run of which all masses are changed by rounding."""
    scene = dj.load_scene(f"paper-case-{case}-table-6")
    mass = scene.lines[0].mass * (1.0 + ROUNDING * number)
    solution = dj.simulate(scene.with_values({"line.0.mass": mass.tolist()}), duration=DURATION, accuracy=accuracy)
    first = solution.tension_max[:, 0]
    row = {"case": case, "run": number, "accuracy": accuracy, "status": solution.status}
    return row | {"peak_kn": 1e-3 * float(first.max()), "t_s": float(solution.t[int(np.argmax(first))])}


def case(number: int, runs: int) -> Found:
    """A case by several runs, and by finer ones."""
    rows = []
    for i in range(runs):
        rows.append(one_run(number, i))
        say(rows[-1])
    finer = [one_run(number, 0, accuracy) for accuracy in FINER]
    return {"case": number, "equal_steps_kn": EQUAL_STEPS[number], "runs": rows, "finer": finer}


@table_of("paper_peaks")
def paper_peaks(found: Found) -> Rows:
    """Peaks of runs with an accuracy, with the spread of those that differ by rounding."""
    return columns(
        found["cases"],
        ("case", "{case}"),
        ("small equal steps [kN]", "{equal_steps_kn:g}"),
        ("accuracy 0.01: lowest to highest [kN]", _peaks),
        ("their mean against small steps", lambda row: percent(_mean(row) / row["equal_steps_kn"] - 1.0, 1, "+")),
        (
            "at accuracies of 0.0025 and 0.0003 [kN]",
            lambda row: joined([run["peak_kn"] for run in row["finer"]], "{:.2f}"),
        ),
    )


def _peaks(row: Found) -> str:
    peaks = [run["peak_kn"] for run in row["runs"]]
    return f"{min(peaks):.2f} to {max(peaks):.2f} ({len(peaks)} runs)"


def _mean(row: Found) -> float:
    return float(np.mean([run["peak_kn"] for run in row["runs"]]))


@command(cases=[int], runs=8)
def main(given: Any) -> None:
    chosen = given.cases or list(EQUAL_STEPS)
    collect("paper_peaks", {"cases": (case(number, given.runs) for number in chosen)}, by="case")
