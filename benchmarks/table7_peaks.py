"""The largest loads of the paper's Table 7, at steps that resolve their snaps, and from starts moved by a micrometre.

    python benchmarks/table7_peaks.py [--cases 1,2] [--starts 10]

Two schemes at two steps each, from the poses of Table 6; then ten starts whose buoy is moved by up to 1e-6 m. Where the
ten agree within 3 % the four values must; elsewhere the motion is chaotic, and the table gives the range of the ten.
Takes about half an hour on one core. Writes results/table7_peaks.json; `python benchmarks/tables.py` makes the table.
"""

import numpy as np
from paper_cases import TABLE_7, case
from study import Found, command, describe, say, store, stored

import dropper_jax as dj

#: Length of the record [s]; in a current alone all is steady long before.
SPAN, STEADY = 150.0, 30.0
#: Schemes, and their two steps [s]; irregular waves and the bare start need shorter ones. Moved starts take the first.
STEPS = {"energy_momentum": (0.00125, 0.000625), "generalized_alpha": (0.001, 0.0005)}
SHORT = {"energy_momentum": (0.0003125, 0.00015625), "generalized_alpha": (0.0005, 0.00025)}
SHORTEST = {**SHORT, "generalized_alpha": (0.00025, 0.000125)}
STEPS_OF = {1: STEPS, 2: STEPS, 3: SHORT, 4: SHORTEST, 5: SHORT}
MOVED = 1e-6  # [m]


def loads(number: int, scheme: str, dt: float, moved: float = 0.0) -> Found:
    """Least, mean and largest tension [N] of the links at both ends over the first 150 s."""
    scene = case(number)
    buoy = scene.value("point.buoy.position")
    changes = {
        "run.duration": STEADY if number == 4 else SPAN,
        "run.integrator": scheme,
        "run.dt": dt,
        "point.buoy.position": [buoy[0] + moved, *buoy[1:]],
    }
    run = dj.simulate(scene.with_values(changes))
    found = {"case": number, "scheme": scheme, "dt_s": dt, "moved_m": moved, "status": run.status}
    for end, link in (("anchor", 0), ("fairlead", -1)):
        tension = run.tension[:, link]
        found[end] = {"min": float(tension.min()), "mean": float(tension.mean()), "max": float(tension.max())}
    return found


@command(cases="1,2,3,4,5", starts=10)
def main(args) -> None:
    found = stored("table7_peaks", {"rows": []})
    found |= {"schema": 1, "machine": describe(), "table_7": TABLE_7, "span_s": SPAN}
    draws = np.random.default_rng(7).uniform(-MOVED, MOVED, args.starts)
    done = [(r["case"], r["scheme"], r["dt_s"], r["moved_m"]) for r in found["rows"]]
    for number in map(int, args.cases.split(",")):
        schemes = [(number, scheme, dt) for scheme, steps in STEPS_OF[number].items() for dt in steps]
        runs = [(*one, 0.0) for one in schemes] + [(*schemes[0], float(moved)) for moved in draws]
        for run in runs:
            if run not in done:
                found["rows"].append(loads(*run))
                say(found["rows"][-1])
                store("table7_peaks", found)
