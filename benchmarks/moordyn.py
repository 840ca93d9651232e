"""The paper's cases and a driven chain in MoorDyn v2 and here: motions, tensions, conventions, and speed on one thread.

    python benchmarks/moordyn.py [--only conventions|cases|steps|schemes|speed|peaks] [--rows TEXT]

Needs the extra `moordyn`; takes about 15 minutes, a few more with the explicit schemes,
an hour more with peaks. `--rows driven` measures the rows of speed or peaks whose names have `driven`.

Writes results/moordyn.json and results/moordyn-case-1.png beside this file and prints what it finds. Both codes start
from the paper's positions. MoorDyn's component waves (WaveKin 7) carry no dynamic pressure: an upright cylinder held
in place then feels almost no heave force (measured in phase with the wave: -3 N where theory has 383 N, 374 N with a
wave grid). Motions and tensions are therefore compared on its wave grid (WaveKin 3); component waves are for speed
only.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000000 "  # runs as one kernel
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import argparse
import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from explicit_schemes import schemes
from moordyn_conventions import conventions
from moordyn_runs import Ours, Rows, theirs
from moordyn_speed import peaks, speed
from paper_cases import TABLE_7, case
from study import describe

from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import jsonable

RESULTS = Path(__file__).parent / "results"
SPAN, SETTLED = 150.0, 50.0  # [s]: the whole run, and from where on it counts as settled
RATIOS = (1.0, 0.1, 0.0)
EVERY = 5  # our steps in 0.1 s: dt = 0.02 s
#: Our steps in 0.1 s for the comparison of step sizes: dt = 0.05, 0.02, 0.01 and, as reference, 0.001 s.
STEP_COUNTS = (2, 5, 10, 100)
#: MoorDyn's step [s] for each internal damping ratio: stronger dampers need smaller ones.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}


def both(number: int, ratio: float) -> tuple[dict[str, Any], Rows, Rows]:
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
    show(found)
    return found, here, there


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
        print(
            f"case 1, ratio {ratio:g}, dt {row['dt_s']:g} s: {row['status']}, mean anchor tension "
            f"{row['anchor']['mean']:.1f} N ({row['mean_against_smallest_step']:+.2%}), largest "
            f"{row['anchor']['max']:.0f} N, retried {row['retried']:.2%}",
            flush=True,
        )
    return rows


def show(found: dict[str, Any]) -> None:
    """A case on a few lines."""
    paper = TABLE_7[str(found["case"])]
    means = f"OrcaFlex {paper['orcaflex'][1]} N, adapted MoorDyn {paper['adapted_moordyn'][1]} N"
    print(
        f"case {found['case']}, internal damping ratio {found['damping_ratio']:g} (Table 7, anchor: {means})",
        flush=True,
    )
    for name in ("ours", "moordyn"):
        for part in ("whole", "settled"):
            rows = found[name][part]
            if rows["status"] != "ok":
                print(f"  {name:8s} {part:8s} {rows['status']}")
                continue
            a, f, p = rows["anchor"], rows["fairlead"], rows["place"]
            ranges = ", ".join(f"{axis} {p['min'][i]:.2f}..{p['max'][i]:.2f}" for i, axis in enumerate("xyz"))
            print(
                f"  {name:8s} {part:8s} anchor {a['mean']:6.0f} ({a['min']:.0f}..{a['max']:.0f}) N, fairlead "
                f"{f['mean']:6.0f} ({f['min']:.0f}..{f['max']:.0f}) N, buoy {ranges} m, retried {rows['retried']:.1%}"
            )


def picture(here: Rows, there: Rows, path: Path) -> None:
    """Case 1 in both codes: where the buoy is, and the tension at the anchor."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(3, 1, figsize=(9, 7), sharex=True, layout="constrained")
    for rows, name, style in (
        (there, "MoorDyn v2, wave grid, dt 0.0005 s", "C1-"),
        (here, "dropper-jax, dt 0.02 s", "C0-"),
    ):
        kept = (rows.t > 100.0) & (rows.t <= 134.0)
        t = rows.t[kept]
        for ax, values in zip(axes, (rows.place[:, 0], rows.place[:, 2], 1e-3 * rows.mean[:, 0]), strict=True):
            ax.plot(t, values[kept], style, lw=1.1, label=name)
    labels = ("x of the buoy's base [m]", "z of the buoy's base [m]", "anchor tension,\nmean over 0.1 s [kN]")
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize=8)
    axes[0].set_title("The paper's case 1, internal damping ratio 0.1")
    axes[-1].set_xlabel("time [s]")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("conventions", "cases", "steps", "schemes", "speed", "peaks")
    parser.add_argument("--only", choices=parts, help="measure this part, keep the others")
    parser.add_argument("--rows", default="", help="of speed and peaks only the rows with this in their names")
    given = parser.parse_args()
    only = given.only
    RESULTS.mkdir(exist_ok=True)
    target = RESULTS / "moordyn.json"
    found: dict[str, Any] = json.loads(target.read_text()) if only and target.exists() else {}
    found.update(
        {
            "schema": 1,
            "machine": describe(),
            "versions": {name: metadata.version(name) for name in ("moordyn", "jax", "dropper-jax", "numpy")},
            "load_average": os.getloadavg()[0],
            "table_7": TABLE_7,
        }
    )

    def keep() -> None:
        atomic_write(target, json.dumps(jsonable(found), indent=1) + "\n")

    if only in (None, "conventions"):
        found["case_4"] = conventions()
        keep()
    if only in (None, "cases"):
        found["cases"] = []
        for number, ratio in [*((1, ratio) for ratio in RATIOS), (2, 0.1), (3, 0.1), (5, 0.1)]:
            row, here, there = both(number, ratio)
            found["cases"].append(row)
            if (number, ratio) == (1, 0.1):
                picture(here, there, RESULTS / "moordyn-case-1.png")
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
    return 0


if __name__ == "__main__":
    sys.exit(main())
