"""The derivative of a storm: the leg tension of a longline of 60 loops by 20 variables, statics included.

    python benchmarks/farm_design.py gradient [--loops 60] [--duration 60]
    python benchmarks/farm_design.py chaos [--loops 60] [--duration 60] [--seeds 10]

`gradient`: derivatives beside central differences of runs (the best of three steps), cost in runs, memory, time to
compile; results/farm_gradient.json.

`chaos`: what derivatives foretell of the mean over ten seeds, where single storms are chaotic. The mean of the largest
leg tension over seeds of a storm, with each of the five variables that move it most 3 % up and down: by windows as
`dropper optimise` differentiates them (ropes damped), and by the scene's own rope law. Beside it the change that the
derivatives of the windows foretell, by their mean and by their median over the seeds; results/farm_chaos.json.

Every row is stored; the next call continues.
"""

import resource
from functools import cache, partial
from pathlib import Path

import numpy as np
from study import RESULTS, command, resume, say, store, stored, timed

from fitting.optimise.models import Still, read_variables, sea_of, still, still_model, with_design
from fitting.optimise.quantities import part_load
from fitting.optimise.storm import WINDOW_RAMP, full_storm, peaks
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
    "line_type.backbone.mass": (0.3, 1.2),
}
#: Steps of the differences over the ranges.
STEPS = (1e-6, 1e-7, 1e-5)
#: Chaos: share by which a variable is moved, and how many variables are.
SHARE, STRONGEST = 0.03, 5
LAWS = ("window", "own_law")


class Farm:
    """Designs of a longline in storms: models at rest, and the largest leg tension.

    Attributes:
        x: values of the variables at the start.
        still, rest: its model with derivatives by the variables, once prepared, and its pose at rest or None.
    """

    def __init__(self, loops, **run):
        self.site = read_site(
            {
                "scene": "looped-longline",
                "parameters": {"loops": loops},
                "run": run,
                "sea_state": [{"name": "storm", "hs": 4.2, "tp": 9.5, "count": 60}],
                "cases": {"currents": [0.9]},
                "factors": {"intact": 1.0},
                "part": [{"name": "legs", "lines": "*-leg"}],
                "unchecked": ["backbone", "loop-*"],
            }
        )
        tables = [{"name": name, "low": low, "high": high} for name, (low, high) in RANGES.items()]
        self.variables = read_variables(tables, self.site.scene)
        self.x = np.array([v.value for v in self.variables])
        self.storm = self.site.cases[0].storm
        self.rest = None

    def prepare(self):
        """Compute the derivatives of the model."""
        self.still = still(self.site, self.variables, self.x, self.storm)
        self.quantities = (part_load(self.still.model, self.site.parts[0]),)

    def moved(self, variable, change):
        """The design with one variable, by number, changed by so much."""
        return self.x + change * np.eye(len(self.x))[variable]

    def at_rest(self, x, calm=True):
        """Model and pose of a design; `calm`: with damped ropes, as windows have it."""
        model = still_model(self.site, self.variables, x, self.storm, calm)
        return model, near_rest(model, self.rest.state)

    def scene(self, x):
        return with_design(self.site.scene, self.variables, x)

    def peaks(self, case, duration, slopes=False):
        """Peaks of the start, with or without derivatives, in a window of this length [s]."""
        return self._peaks(self.still, self.rest, self.x, case, duration, slopes, None)

    def peaks_of(self, x, duration, heights=None):
        """A function of the case: peaks of a design."""
        model, pose = self.at_rest(x)
        moved = Still(model, self.still.slopes), Rest(pose, self.rest.dr, self.rest.dtension)
        return lambda case: self._peaks(*moved, x, case, duration, False, heights)

    def _peaks(self, model, pose, x, case, duration, slopes, heights):
        sea = sea_of(self.site, self.scene(x), case, WINDOW_RAMP)
        return peaks(model, pose, sea, self.quantities, self.site.scene.run.dt, duration, slopes, heights)


def against_differences(farm, variable, found, duration):
    """The derivative by one variable, and the best of the central differences."""
    k = list(RANGES).index(variable)
    span = farm.variables[k].span
    slope = found.slope[0, k] * span
    rows = []
    for step in STEPS:
        ends = (farm.peaks_of(farm.moved(k, h * span), duration, found.hard) for h in (step, -step))
        up, down = (end(farm.site.cases[0]).soft[0] for end in ends)
        difference = (up - down) / (2 * step)
        off = abs(difference - slope) / max(abs(slope), 1e-12)
        rows.append({"slope": slope, "difference": difference, "off": off, "step": step})
        if off < 1e-4:
            break
    return min(rows, key=lambda row: row["off"])


def gradient(file, loops, duration):
    """The derivatives, and what they cost."""
    last = {"loops": loops, "duration": duration}

    def spent(key, call):
        found, times = timed(call)
        last[key] = round(times["seconds"], 2)
        return found

    farm = spent("read_s", lambda: Farm(loops, duration=60.0, seeds=1, skip=15.0))
    spent("model_slopes_s", farm.prepare)
    last |= {"links": farm.still.model.line.links, "leaves": len(farm.still.slopes)}
    case = farm.site.cases[0]
    for key in ("rest_first_s", "rest_s"):
        farm.rest = spent(key, lambda: rest(farm.still, farm.rest and farm.rest.state))
    for name in ("run", "gradient"):
        for key in (f"{name}_first_s", f"{name}_s"):
            found = spent(key, lambda name=name: farm.peaks(case, duration, name == "gradient"))
    last["cost_in_runs"] = round(last["gradient_s"] / last["run_s"], 2)
    last["memory_GB"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 2)
    last |= {"hard_peak": float(found.hard[0]), "soft_peak": float(found.soft[0])}
    say(last)
    # later calls take compiled programs where these are kept
    head = {"first": last, **stored(file, {}), "last": last}
    slope = partial(against_differences, farm, found=found, duration=duration)
    resume(file, "rows", ({"variable": name} for name in RANGES), slope, **head)


def chaos(file, loops, duration, seeds):
    """Runs of the designs with one variable moved, and the changes that are foretold."""
    farm = Farm(loops, duration=duration, seeds=seeds, skip=WINDOW_RAMP, ramp=WINDOW_RAMP)
    farm.prepare()
    farm.rest = rest(farm.still)
    cases = {case.seed: case for case in farm.site.cases}
    names = [v.name for v in farm.variables]

    def base(seed):
        found = farm.peaks(cases[seed], duration, slopes=True)
        scale = float(found.hard[0]) / found.soft[0]
        return {"hard": float(found.hard[0]), "slope": (scale * found.slope[0]).tolist()}

    @cache
    def storm(law, variable, sign):
        """A function of the case: the run of a moved design."""
        x = designs[variable, sign]
        if law == "window":
            return farm.peaks_of(x, duration)
        scene, pose = farm.scene(x), farm.at_rest(x, calm=False)[1]
        return lambda case: full_storm(farm.site, scene, case, farm.quantities, pose)

    def moved(seed, **design):
        return {"hard": float(storm(**design)(cases[seed]).hard[0])}

    resume(file, "base", ({"seed": seed} for seed in cases), base, loops=loops, share=SHARE)
    slopes = np.array([row["slope"] for row in stored(file)["base"]])
    strongest = np.argsort(-np.abs(np.mean(slopes, axis=0) * farm.x))[:STRONGEST]
    designs = {(names[k], sign): farm.moved(k, sign * SHARE * farm.x[k]) for k in strongest for sign in (1, -1)}
    designs[("", 0)] = farm.x
    wanted = (
        {"law": law, "variable": variable, "sign": sign, "seed": seed}
        for law in LAWS
        for variable, sign in designs
        for seed in cases
    )
    resume(file, "moved", wanted, moved)
    found = stored(file)
    found["table"] = [
        {
            "variable": names[k],
            **foretold(
                [row for row in found["moved"] if row["variable"] in ("", names[k])], SHARE * farm.x[k] * slopes[:, k]
            ),
        }
        for k in strongest
    ]
    say(found["table"])
    store(file, found)


def foretold(rows, changes):
    """Measured changes of the mean over those that the mean and the median of the seeds' derivatives foretell, by law.

    Args:
        rows: runs of the start and of the designs with one variable moved.
        changes: foretold of each seed (seeds,). A seed whose peak comes as a rope tautens has a derivative of its own,
            up to thirty times that of the others.
    """
    found = {"foretold": np.mean(changes), "foretold_by_median": np.median(changes)}
    for law in LAWS:
        own = [row for row in rows if row["law"] == law]
        low, middle, high = (np.mean([row["hard"] for row in own if row["sign"] == sign]) for sign in (-1, 0, 1))
        both = {"up": high - middle, "down": middle - low, "central": 0.5 * (high - low)}
        found[law] = {
            f"{key}{by}": change / found[f"foretold{by}"] for key, change in both.items() for by in ("", "_by_median")
        }
    return found


@command({"study": ("gradient", "chaos")}, loops=60, duration=60.0, seeds=10, out=Path)
def main(args):
    file = args.out or RESULTS / f"farm_{args.study}.json"
    if args.study == "gradient":
        gradient(file, args.loops, args.duration)
    else:
        chaos(file, args.loops, args.duration, args.seeds)
