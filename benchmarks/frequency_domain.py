"""Tensions of `dropper frequency` next to runs in time with the same wave components, of two longlines.

    python benchmarks/frequency_domain.py [--runs N]     # N runs more; then the response, and the table

Runs start with a ramp of 15 s (see `dropper_jax.run.frequency.run_in_time`).
"""

import tomllib
from pathlib import Path

import numpy as np
from study import Found, Rows, command, markdown, store, stored, table_of

import dropper_jax as dj
from dropper_jax.run.frequency import run_in_time
from dropper_jax.scene import whole_lines

SCENES = Path(dj.__file__).parent / "data" / "scenes"
#: Significant heights [m] and peak periods [s], the first to be run first.
STATES = (
    *((1.0, 6.0), (0.5, 4.0), (2.0, 8.0), (0.5, 6.0), (1.0, 5.0), (1.0, 7.0)),
    *((2.0, 7.0), (1.5, 6.0), (1.5, 8.0), (3.0, 8.0), (3.0, 10.0), (4.0, 10.0)),
)
#: Scene: direction of the waves [rad], start of the compared part of a run [s].
LONGLINES = {"edulis-longline": (-np.pi / 2, 60.0), "looped-longline": (0.0, 100.0)}
#: Lines whose ends are compared: those between the anchors.
LINES = ("west-leg", "backbone", "east-leg")
#: Number of frequencies and end of the ramp [s].
COUNT, RAMP = 40, 15.0


def scene_in(name: str, hs: float, tp: float) -> dj.Scene:
    """A longline in the sea of a state."""
    scene = tomllib.loads((SCENES / f"{name}.toml").read_text())
    waves = {"kind": "spectrum", "hs": hs, "tp": tp, "count": COUNT, "frequencies": "even"}
    sea = {key: value for key, value in scene["sea"].items() if key != "packaged"}
    sea |= {"depth": sea.get("depth", 30.0), "ramp": RAMP, "waves": waves | {"direction": LONGLINES[name][0]}}
    return dj.load_scene({**scene, "name": name, "sea": sea})


def run(name: str, hs: float, tp: float) -> list[dict[str, float]]:
    """Mean and standard deviation [N] of each end of `LINES` in a run."""
    scene = scene_in(name, hs, tp)
    each = zip(*run_in_time(scene, (hs, tp), frequencies=COUNT, start=LONGLINES[name][1]), strict=True)
    ends = [line.name for line in whole_lines(scene) for _ in range(2)]
    return [
        {"run_mean": float(mean), "run_deviation": float(deviation)}
        for end, (mean, deviation) in zip(ends, each, strict=True)
        if end in LINES
    ]


def compare(name: str, runs: Found) -> list[Found]:
    """Rows of the ends of `LINES` in the states that were run."""
    states = [tuple(float(x) for x in key.split(":")) for key in runs]
    found = dj.frequency_response(scene_in(name, *states[0]), states, frequencies=COUNT)
    rows = []
    for i, own in enumerate(runs.values()):
        ends = [j for j, (line, _) in enumerate(found.ends) if line in LINES]
        for j, in_time in zip(ends, own, strict=True):
            line, point = found.ends[j]
            row = {"hs": states[i][0], "tp": states[i][1], "line": line, "point": point, "status": found.status[i]}
            row |= {"mean": float(found.mean_tension[i, j]), "deviation": float(found.tension_deviation[i, j])}
            rows.append({**row, **in_time, "slack_lines": int(np.sum(found.slack[i]))})
    return rows


@table_of("frequency_domain")
def frequency_domain(found: Found) -> Rows:
    """Ranges of the differences of all ends, a row per sea state."""
    rows = [
        ("scene", "Hs, Tp", "lines that go slack", "deviations of tension against the run", "means against the run")
    ]
    for name, own in found.items():
        for hs, tp in dict.fromkeys((row["hs"], row["tp"]) for row in own["rows"]):
            ends = [row for row in own["rows"] if (row["hs"], row["tp"]) == (hs, tp)]
            apart = [[100.0 * (row[key] / row[f"run_{key}"] - 1.0) for row in ends] for key in ("deviation", "mean")]
            ranges = (f"{min(values):+.1f} to {max(values):+.1f} %" for values in apart)
            rows.append((f"`{name}`", f"{hs:g} m, {tp:g} s", str(ends[0]["slack_lines"]), *ranges))
    return rows


@command(runs=0)
def main(args) -> None:
    found = stored("frequency_domain", {})
    missing = [
        (n, s) for s in STATES for n in LONGLINES if f"{s[0]:g}:{s[1]:g}" not in found.get(n, {}).get("runs", {})
    ]
    for name, state in missing[: args.runs]:
        own = found.setdefault(name, {"runs": {}})
        own["runs"][f"{state[0]:g}:{state[1]:g}"] = run(name, *state)
        store("frequency_domain", found)
    for name, own in found.items():
        own["rows"] = compare(name, own["runs"])
    store("frequency_domain", found)
    print(markdown(frequency_domain(found)))
