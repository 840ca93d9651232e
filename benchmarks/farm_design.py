"""The derivative of a storm: the leg tension of a longline of 60 loops by 20 variables, statics included.

    python benchmarks/farm_design.py [--loops 60] [--duration 60] [--seconds 220]

Writes `results/farm_gradient.json`: derivatives beside central differences of runs (the best of three steps), cost in
runs, memory, time to compile. Goes on where it stopped; `--seconds` is when to stop.
"""

import resource
import time

import numpy as np
from study import command, say, store, stored

from fitting.optimise.models import Still, read_variables, sea_of, still, still_model, with_design
from fitting.optimise.quantities import part_load
from fitting.optimise.storm import WINDOW_RAMP, peaks
from fitting.optimise.values import Rest, near_rest, rest
from fitting.site import read_site

#: Variables and their ranges: lengths, sizes, places, masses, coefficients.
RANGES = {
    "leg": (55.0, 80.0),
    "spread": (50.0, 60.0),
    "loop_length": (6.0, 12.0),
    "float_volume": (0.05, 0.3),
    "spacing": (2.5, 4.0),
    "backbone_diameter": (0.02, 0.06),
    "leg_diameter": (0.02, 0.06),
    "sock_mass": (4.0, 12.0),
    "depth": (22.0, 28.0),
    "line_type.sock.diameter": (0.05, 0.15),
    "line_type.sock.EA": (5e4, 2e5),
    "line_type.leg.EA": (1e6, 2e6),
    "line_type.backbone.EA": (1e6, 2e6),
    "line_type.sock.cdn": (1.0, 2.0),
    "line_type.backbone.cdn": (1.0, 2.0),
    "line_type.leg.cdn": (1.0, 2.0),
    "line_type.sock.can": (0.5, 1.5),
    "line_type.backbone.can": (0.5, 1.5),
    "line_type.leg.can": (0.5, 1.5),
    "line_type.leg.mass": (0.5, 1.5),
}
#: Values of the site's run.
RUN = {"duration": 60.0, "seeds": 1, "skip": 15.0}
#: Steps of the differences over the ranges.
STEPS = (1e-6, 1e-7, 1e-5)


def problem(loops, run=RUN):
    """Site, variables and their start, with these values of the site's run."""
    table = {
        "scene": "looped-longline",
        "parameters": {"loops": loops},
        "run": run,
        "sea_state": [{"name": "storm", "hs": 4.2, "tp": 9.5, "count": 60}],
        "cases": {"currents": [0.9]},
        "factors": {"intact": 1.0},
        "part": [{"name": "legs", "lines": "*-leg"}],
        "unchecked": ["backbone", "loop-*"],
    }
    site = read_site(table)
    # the depth moves the waves too, which windows hold
    names = {name: ends for name, ends in RANGES.items() if name != "depth"} | {"line_type.backbone.mass": (0.3, 1.2)}
    tables = [{"name": name, "low": low, "high": high} for name, (low, high) in names.items()]
    variables = read_variables(tables, site.scene)
    return site, variables, np.array([v.value for v in variables])


@command(loops=60, duration=60.0, seconds=1e9)
def main(args):
    begun = last = time.perf_counter()

    def lap():
        nonlocal last
        now = time.perf_counter()
        took, last = now - last, now
        return round(took, 2)

    site, variables, x = problem(args.loops)
    case = site.cases[0]
    found = {"loops": args.loops, "duration": args.duration, "read_s": lap()}
    here = still(site, variables, x, case.storm)
    found |= {"links": here.model.line.links, "leaves": len(here.slopes), "model_slopes_s": lap()}
    sea = sea_of(site, with_design(site.scene, variables, x), case, WINDOW_RAMP)
    quantities = (part_load(here.model, site.parts[0]),)
    dt = site.scene.run.dt

    def peak(still_, pose, slopes, heights=None):
        return peaks(still_, pose, sea, quantities, dt, args.duration, slopes, heights)

    own = None
    calls = {
        "rest": lambda: rest(here, own and own.state),
        "run": lambda: peak(here, own, False),
        "gradient": lambda: peak(here, own, True),
    }
    for name, call in calls.items():
        for key in (f"{name}_first_s", f"{name}_s"):
            value = call()
            own = value if name == "rest" else own
            found[key] = lap()
    found["cost_in_runs"] = round(found["gradient_s"] / found["run_s"], 2)
    found["memory_GB"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 2)
    found |= {"hard_peak": float(value.hard[0]), "soft_peak": float(value.soft[0])}
    before = stored("farm_gradient", {})
    same = before.get("loops") == args.loops and before.get("duration") == args.duration
    rows = {row["variable"]: row for row in before.get("rows", [])} if same else {}
    first = (
        before["first"] if same else found
    )  # later calls take compiled programs of earlier ones, where these are kept
    say(found)

    def put():
        own = {"loops": args.loops, "duration": args.duration, "first": first, "last": found}
        store("farm_gradient", {**own, "rows": list(rows.values())})

    put()
    for k, variable in enumerate(variables):
        if variable.name in rows or time.perf_counter() - begun > args.seconds:
            continue
        slope, best = value.slope[0, k] * variable.span, None
        for step in STEPS:
            ends = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[k] += sign * step * variable.span
                model = Still(still_model(site, variables, moved, case.storm), here.slopes)
                pose = Rest(near_rest(model.model, own.state), own.dr, own.dtension)
                ends.append(peak(model, pose, False, value.hard).soft[0])
            difference = (ends[0] - ends[1]) / (2 * step)
            off = abs(difference - slope) / max(abs(slope), 1e-12)
            if best is None or off < best["off"]:
                best = {"variable": variable.name, "slope": slope, "difference": difference, "off": off, "step": step}
            if off < 1e-4:
                break
        rows[variable.name] = best
        say(best)
        put()
