"""Other simulators on the same droppers: error against a common reference and wall time, one thread each.

    python benchmarks/peers.py            (needs the extra `peers`; about 3 minutes)

Writes results/peers.json and results/peers-dropper-17-links.png and prints whether the goals are met: at equal or
smaller error, our best integrator at least 15 times faster per simulated second than MuJoCo (C library), 3.5 times
faster than diffrax as it is, and not more than a tenth slower than diffrax with our tensions, its runs one kernel too.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from pathlib import Path

import diffrax_line
import mujoco_chain
from study import RESULTS, Found, command, describe, say, store, versions

from dropper_jax import Model, Scene, State, build, load_scene
from dropper_jax.plots import figures, style
from dropper_jax.study.curves import marks
from dropper_jax.study.reference import Reference, reference
from dropper_jax.study.schemes import Scheme, runnable
from dropper_jax.study.work_precision import Comparison

REPEATS = 7  # the least of these counts, for everybody: other load on the machine only ever adds
SPAN = 2.0  # [s]
GRID = 2.0**-4  # [s]
OURS = [
    Scheme("rattle"),
    Scheme("rattle", dtype="float32"),
    Scheme("energy_momentum"),
    Scheme("energy_momentum_4"),
    Scheme("rattle_4"),
    Scheme("tsit5"),
    Scheme("dop853"),
    Scheme("thesis_angles", 0.51, "dense"),
]
DTS = [2.0**-k for k in range(4, 13)]
GOALS = (
    ("mujoco", 15.0, "MuJoCo, tuned as well as we could"),
    ("mujoco RK4 default", 15.0, "MuJoCo RK4 at 5 ms"),
    ("diffrax tridiagonal", 3.5, "diffrax as it is"),
    ("diffrax angles", 3.5, "diffrax, minimal coordinates"),
    ("diffrax cyclic", 0.9, "diffrax with our tensions, in one kernel"),
)


def dropper_17() -> Scene:
    """17 m in 17 links of 14 kg/m, ends 2.5 m apart, let go from a pull of 300 N up and aside at node 5."""
    return load_scene(
        {
            "name": "dropper-17-links",
            "run": {"dt": 0.03125, "duration": 10.0},
            "point": [
                {"name": "left", "position": [0.0, 0.0, 0.0]},
                {"name": "right", "position": [2.5, 0.0, 0.0]},
            ],
            "line": [{"name": "dropper", "from": "left", "to": "right", "links": 17, "length": 1.0, "mass": 14.0}],
            "effects": {"weight": {}},
            "start": {"kind": "static", "release_nodes": [5], "release_force": [[-200.0, 0.0, 300.0]]},
        }
    )


def compare(scene: Scene) -> Found:
    """Rows of all simulators on one scene, and its goals."""
    model, s = build(scene)
    target = reference(model, s, GRID, round(SPAN / GRID), 0.0)
    schemes, _ = runnable(OURS, model)
    every = Comparison(model, s, target, REPEATS, min).rows(schemes, DTS)
    rows = [row for row in every if "reason" not in row]
    rows += peer_rows(scene, model, s, target)
    return {"scene": scene.name, "reference": target.summary(), "rows": rows, "goals": goals(rows)}


def peer_rows(scene: Scene, model: Model, s: State, target: Reference) -> list[Found]:
    """Rows of MuJoCo and diffrax, like those of a `Comparison`; one that cannot run the scene is reported."""
    rows = []
    for peer in (mujoco_chain, diffrax_line):
        reason = peer.refuse(model, s)
        if reason:
            say({"scene": scene.name, "left out": peer.NAME, "reason": reason})
        else:
            rows += peer.rows(model, s, target)
    return rows


def goals(rows: list[Found]) -> list[Found]:
    """For each goal the ratio of wall times where ours has no larger position error, at the peer's best and worst run.

    `ratio` is over all of the peer's runs the least favourable to us; `largest` the most favourable.
    """
    ours = [r for r in rows if not r.get("peer") and r["status"] == "ok" and r["integrator"] != "thesis_angles"]
    found = []
    for start, wanted, words in GOALS:
        peer = [r for r in rows if r.get("peer") and r["status"] == "ok" and r["label"].startswith(start)]
        if start == "mujoco RK4 default":
            peer = sorted(peer, key=lambda r: abs(r["dt"] - 0.005))[:1]
        if peer:
            ratios = sorted((_ratio(r, ours) for r in peer), key=lambda x: x["ratio"])
            ends = {"least": ratios[0], "largest": ratios[-1], "met": ratios[0]["ratio"] >= wanted}
            found.append({"goal": words, "wanted": wanted, **ends})
            say(found[-1])
    return found


def _ratio(row: Found, ours: list[Found]) -> Found:
    """Peer's wall time over that of our fastest run which is at least as exact."""
    good = [r for r in ours if r["rms_position_error_m"] <= row["rms_position_error_m"]]
    if not good:
        return {"ratio": 0.0, "error_m": row["rms_position_error_m"], "peer": row["label"], "ours": None}
    best = min(good, key=lambda r: r["wall_s_per_simulated_s"])
    return {
        "ratio": row["wall_s_per_simulated_s"] / best["wall_s_per_simulated_s"],
        "error_m": row["rms_position_error_m"],
        "peer": f"{row['label']}, dt {row['dt']:.4g} s",
        "ours": f"{best['label']}, dt {best['dt']:.4g} s",
    }


@style.plot_style()
def picture(result: Found, path: Path) -> Path:
    """RMS position error against wall time per simulated second, ours filled, the others open, log-log."""
    figure = figures.new_figure(9.0, 5.8)
    axes = figure.subplots()
    # below this the reference's own error is compared; a run at its own step even shows none
    floor = result["reference"]["error_estimate_rad"]
    rows = [row for row in result["rows"] if row["status"] == "ok" and row["rms_angle_error_rad"] > floor]
    for i, label in enumerate(dict.fromkeys(row["label"] for row in rows)):
        part = sorted((r for r in rows if r["label"] == label), key=lambda r: r["dt"])
        look = marks(i)
        if part[0].get("peer"):
            look.update(mfc="white", ls="--")
        x, y = ([r[key] for r in part] for key in ("wall_s_per_simulated_s", "rms_position_error_m"))
        axes.plot(x, y, label=label, lw=1.0, **look)
    axes.set(xscale="log", yscale="log", xlabel="wall time per simulated second [s], one thread")
    axes.set_ylabel("RMS position error [m]")
    figure.legend(loc="outside right center", fontsize=8)
    figures.title(
        figure, f"{result['scene']}: the same motion by other simulators, {result['reference']['horizon_s']:g} s"
    )
    return figures.save(figure, path)


@command()
def main() -> None:
    results = [compare(dropper_17()), compare(load_scene("dropper-release-a-undamped"))]
    packages = versions("mujoco", "diffrax", "jax", "dropper-jax")
    store("peers", {"schema": 1, "machine": describe(), "versions": packages, "scenes": results})
    picture(results[0], RESULTS / "peers-dropper-17-links.png")
