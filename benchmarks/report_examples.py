"""The examples of docs/report.md: what step and internal damping do to a snapping chain, and a storm from ten seeds.

    python benchmarks/report_examples.py

Writes `results/report_examples.json` (some minutes on a core); `tables.py` makes the tables of it.
"""

from study import Found, command, describe, store

import dropper_jax as dj
from dropper_jax.report.settings import Settings

RATIOS, STEPS = (1.0, 0.1, 0.0), (0.05, 0.02)
DURATION, SKIP, BREAKING_LOAD = 100.0, 50.0, 450e3
STORM = {"kind": "spectrum", "spectrum": "jonswap", "hs": 2.0, "tp": 7.0, "count": 100, "direction": 0.0}
SEEDS, FURTHER = range(1, 11), range(11, 29)
RUN, LEFT_OUT = 660.0, 60.0


def damping_and_step(ratio: float, dt: float) -> Found:
    """One run of case 1: mean anchor load, largest tension, snaps, equivalent range and damage of its second half."""
    values = {"line_type.chain.damping_ratio": ratio, "run.dt": dt, "run.duration": DURATION}
    solution = dj.simulate(dj.load_scene("paper-case-1").with_values(values))
    found = dj.report_run(solution, Settings(skip=SKIP, breaking_load=BREAKING_LOAD))
    (tension,), (anchor,), (snap,), (fatigue,) = (found[key] for key in ("tension", "anchors", "snap", "fatigue"))
    return {
        "damping_ratio": ratio,
        "dt_s": dt,
        "status": solution.status,
        "retried": solution.retried_steps,
        "mean_anchor_n": anchor["total_n"]["mean"],
        "largest_n": tension["largest"]["n"],
        "snaps": snap["most_events"],
        "equivalent_range_n": max(fatigue["equivalent_range_n"]),
        "damage_per_year": fatigue["damage_per_year"],
    }


def in_storm(seed: int) -> dj.Solution:
    """One run of case 3's mooring in a sea of its own."""
    values = {"sea.waves": {**STORM, "seed": seed}, "sea.ramp": 20.0, "run.dt": 0.05, "run.duration": RUN}
    return dj.simulate(dj.load_scene("paper-case-3").with_values(values))


def storm() -> Found:
    """Extremes of ten runs, and the largest values of further seeds that make up the storm."""
    runs = {f"seed-{seed}": in_storm(seed) for seed in SEEDS}
    found = dj.report_runs(runs, Settings(skip=LEFT_OUT))
    rows = []
    for name, one in found["extremes"].items():
        keys = ("most_probable", "mean", "percentile_90")
        numbers = {key: [one[key], *one[f"{key}_interval"]] for key in keys}
        rows.append({"what": name, "maxima": [min(one["maxima"]), max(one["maxima"])], **numbers})
    further = (dj.report_run(in_storm(seed), Settings(skip=LEFT_OUT)) for seed in FURTHER)
    largest = max(report["tension"][0]["largest"]["n"] for report in further)
    retried = max(run.retried_steps for run in runs.values())
    return {"rows": rows, "retried": retried, "further_seeds": len(FURTHER), "further_largest_n": largest}


@command()
def main() -> None:
    rows = [damping_and_step(ratio, dt) for ratio in RATIOS for dt in STEPS]
    store("report_examples", {"machine": describe(), "damping": rows, "storm": storm()})
