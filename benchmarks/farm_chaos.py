"""What a derivative of a storm foretells of the mean over ten seeds, where single storms are chaotic.

    python benchmarks/farm_chaos.py [--loops 60] [--seeds 10] [--seconds 1200]

The mean of the largest leg tension over seeds of a storm of 60 s, with each of the five variables that move it most
3 % up and down: by windows as `dropper optimise` differentiates them (ropes damped), and by the scene's own rope law.
Beside it the change that the derivatives of the windows foretell, by their mean and by their median over the seeds.
Writes `results/farm_chaos.json` after every run and
goes on where it stopped.
"""

import time

import numpy as np
from farm_design import problem
from study import command, say, store, stored

from fitting.optimise.models import Still, sea_of, still, still_model, with_design
from fitting.optimise.quantities import part_load
from fitting.optimise.storm import WINDOW_RAMP, full_storm, peaks
from fitting.optimise.values import Rest, near_rest, rest

#: Share by which a variable is moved, and how many variables are.
SHARE, STRONGEST = 0.03, 5
DURATION = 60.0


class Runs:
    """Runs of moved designs: each kind of run is made of a design and takes a case."""

    def __init__(self, site, variables, x):
        self.site, self.variables, self.x = site, variables, x
        self.storm = site.cases[0].storm
        self.still = still(site, variables, x, self.storm)
        self.rest = rest(self.still)
        self.quantities = (part_load(self.still.model, site.parts[0]),)

    def design(self, moved, calm):
        """The model of a design and its pose at rest."""
        model = still_model(self.site, self.variables, moved, self.storm, calm)
        return model, near_rest(model, self.rest.state)

    def peaks(self, model, pose, x, case, slopes=False):
        sea = sea_of(self.site, with_design(self.site.scene, self.variables, x), case, WINDOW_RAMP)
        return peaks(model, pose, sea, self.quantities, self.site.scene.run.dt, DURATION, slopes)

    def slopes(self, case):
        """Hard peak and its derivatives, the soft ones scaled."""
        found = self.peaks(self.still, self.rest, self.x, case, True)
        return float(found.hard[0]), (found.slope[0] * found.hard[0] / found.soft[0]).tolist()

    def window(self, moved):
        model, pose = self.design(moved, True)
        own = Still(model, self.still.slopes), Rest(pose, self.rest.dr, self.rest.dtension)
        return lambda case: float(self.peaks(*own, moved, case).hard[0])

    def own_law(self, moved):
        scene, (_, pose) = with_design(self.site.scene, self.variables, moved), self.design(moved, False)
        return lambda case: float(full_storm(self.site, scene, case, self.quantities, pose).hard[0])


def mean_of(rows):
    """Mean over the seeds that were run."""
    return np.mean(list(rows.values())) if rows else np.nan


def foretold(kept, names, x):
    """What the derivatives foretell and what runs say, for each moved variable."""
    all_slopes = [row["slope"] for row in kept["base"].values()]
    # a seed whose peak comes as a rope tautens has a derivative of its own, up to thirty times that of the others
    slopes, typical = np.mean(all_slopes, axis=0), np.median(all_slopes, axis=0)
    table = []
    for name in kept["variables"]:
        k = names.index(name)
        row = {"variable": name, "foretold": SHARE * x[k] * slopes[k], "foretold_median": SHARE * x[k] * typical[k]}
        for law in ("window", "own_law"):
            start = mean_of(kept["start"].get(law))
            up, down = (kept["moved"].get(f"{name}{sign}{law}", {}) for sign in "+-")
            above, below = mean_of(up) - start, start - mean_of(down)
            both = {"up": above, "down": below, "central": 0.5 * (mean_of(up) - mean_of(down))}
            row[law] = {key: value / row["foretold"] for key, value in both.items()}
            row[law] |= {f"{key}_by_median": value / row["foretold_median"] for key, value in both.items()}
            spread = [up[seed] - down[seed] for seed in up if seed in down]
            if len(spread) > 1:
                row[law]["error"] = abs(0.5 * np.std(spread, ddof=1) / np.sqrt(len(spread)) / row["foretold"])
        table.append(row)
    return table


@command(loops=60, seeds=10, seconds=1e9)
def main(args):
    begun = time.perf_counter()
    values = {"duration": DURATION, "seeds": args.seeds, "skip": WINDOW_RAMP, "ramp": WINDOW_RAMP}
    site, variables, x = problem(args.loops, values)
    names = [v.name for v in variables]
    runs = Runs(site, variables, x)
    own = {"loops": args.loops, "seeds": args.seeds}
    kept = stored("farm_chaos", {})
    if {key: kept.get(key) for key in own} != own:
        kept = {**own, "share": SHARE, "base": {}, "start": {"window": {}, "own_law": {}}, "moved": {}}
    spent = kept.get("cpu_s", 0.0)

    def put():
        kept["cpu_s"] = spent + time.process_time()
        if "variables" in kept:
            kept["table"] = foretold(kept, names, x)
        store("farm_chaos", kept)

    def missing(rows):
        """Cases that are not in the rows, while there is time; the rows are stored when the next one is asked for."""
        for case in site.cases:
            if str(case.seed) not in rows and time.perf_counter() - begun < args.seconds:
                yield case
                put()

    for case in missing(kept["base"]):
        hard, slope = runs.slopes(case)
        kept["base"][str(case.seed)] = {"hard": hard, "slope": slope}
        kept["start"]["window"][str(case.seed)] = hard
    if len(kept["base"]) < args.seeds:
        return
    strength = np.abs(np.mean([row["slope"] for row in kept["base"].values()], axis=0) * x)
    kept["variables"] = [names[k] for k in np.argsort(-strength)[:STRONGEST]]
    for law, prepare in (("window", runs.window), ("own_law", runs.own_law)):
        designs = [(kept["start"][law], x)]
        for name in kept["variables"]:
            for sign, share in (("+", SHARE), ("-", -SHARE)):
                moved = x.copy()
                moved[names.index(name)] *= 1.0 + share
                designs.append((kept["moved"].setdefault(f"{name}{sign}{law}", {}), moved))
        for rows, moved in designs:
            run = None
            for case in missing(rows):
                run = run or prepare(moved)
                rows[str(case.seed)] = run(case)
    put()
    for row in kept["table"]:
        say(row)
