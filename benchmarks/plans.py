"""Whether plans of measurements foretell the errors of fits, and which of two measurements is the better.

    python benchmarks/plans.py [--twins 20]

Six pairs of measurements of chains with linear and quadratic drag: other release poses, durations, noises and numbers
of links, once with a length that is not known. Each is planned, then made `--twins` times with noise drawn anew and
fitted by `shooting`; the scatter of the fitted values is the error that was to be foretold. Writes results/plans.json.
"""

import time

import numpy as np
from study import RESULTS, Found, command, store, stored

from fitting import fit
from fitting.calibration.plan import plan
from fitting.traces.synthetic import Camera, observe, simulate_truth

GAP_WEIGHT = 1e-3
#: Predicted errors that differ by this ratio should be found in this order.
APART = 1.5


def chain(name: str, angles: list[float]) -> Found:
    """A chain of 0.8 m let go from angles to the vertical [rad]."""
    links = len(angles)
    return {
        "name": name,
        "run": {"dt": 0.01, "duration": 12.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "bob", "kind": "free", "position": [0.8, 0.0, 0.0]},
        ],
        "line": [
            {"name": "rod", "from": "top", "to": "bob", "links": links, "length": 0.8 / links, "mass": 0.5 / links}
        ],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.05}, "quadratic_damping": {"b_q": 0.03}},
        "start": {"kind": "angles", "zero": "down", "polar": angles},
    }


#: Pairs: what differs, and two measurements (scene, duration [s], noise [rad]); both free the same parameters.
DRAG = ("b_l", "b_q")
PAIRS: tuple[tuple[str, tuple[str, ...], tuple, tuple], ...] = (
    ("height of release", DRAG, (chain("low", [0.3]), 8.0, 0.01), (chain("high", [1.3]), 8.0, 0.01)),
    ("duration", DRAG, (chain("short", [1.2]), 4.0, 0.01), (chain("long", [1.2]), 12.0, 0.01)),
    ("noise, two links", DRAG, (chain("sharp", [1.0, 0.5]), 6.0, 0.004), (chain("dull", [1.0, 0.5]), 6.0, 0.01)),
    ("pose, two links", DRAG, (chain("straight", [1.0, 1.0]), 6.0, 0.01), (chain("bent", [1.2, -0.6]), 6.0, 0.01)),
    ("links", DRAG, (chain("one", [1.0]), 6.0, 0.01), (chain("three", [1.0, 0.8, 0.6]), 6.0, 0.01)),
    (
        "duration, a length not known",
        (*DRAG, "line.0.length"),
        (chain("short", [1.2]), 4.0, 0.01),
        (chain("long", [1.2]), 10.0, 0.01),
    ),
)


def names(found: Found) -> list[str]:
    """Names of the coefficients of drag."""
    return [name for name in found["predicted"] if ".b_" in name]


def measured(free: tuple[str, ...], scene: Found, duration: float, noise: float, twins: int) -> Found:
    """Errors of one measurement, predicted and as twins scatter."""
    (row,) = plan([scene], free, durations=[duration], noises=[noise], gap_weight=GAP_WEIGHT)
    motion = simulate_truth(scene, duration)
    found = [fit([observe(motion, Camera(angle_noise=noise), seed)], scene, free) for seed in range(twins)]
    values = np.array([one.values for one in found])
    observed = dict(zip(row.std_error, np.std(values, axis=0, ddof=1).tolist(), strict=True))
    reported = np.median([one.uncertainty.std_error for one in found], axis=0)
    return {
        "scene": scene["name"],
        "duration": duration,
        "noise": noise,
        "predicted": row.std_error,
        "observed": observed,
        "ratio": {p: row.std_error[p] / observed[p] for p in observed},
        "reported": dict(zip(observed, reported.tolist(), strict=True)),
        "ok": sum(one.status == "ok" for one in found),
    }


@command(twins=20, out=RESULTS / "plans.json")
def main(args) -> None:
    rows = stored(args.out, [])
    done = {row["pair"] for row in rows}
    for name, free, *both in PAIRS:
        if name in done:
            continue
        begun = time.process_time()
        found = [measured(free, *one, args.twins) for one in both]
        row = {"pair": name, "measurements": found, "seconds": time.process_time() - begun}
        # the errors asked for are those of drag, by the mean of their logarithms
        foretold, seen = (
            float(np.exp(np.mean([np.log(found[0][key][p] / found[1][key][p]) for p in names(found[0])])))
            for key in ("predicted", "observed")
        )
        row |= {"foretold": foretold, "seen": seen}
        row["order"] = None if max(foretold, 1 / foretold) < APART else bool((foretold > 1) == (seen > 1))
        rows.append(row)
        store(args.out, rows)
        ratios = [f"{one['ratio'][p]:.2f}" for one in found for p in names(one)]
        print(f"{name}: {', '.join(ratios)}; {foretold:.2f} foretold, {seen:.2f} seen", flush=True)
