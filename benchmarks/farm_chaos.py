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
from farm_design import Farm
from study import command, say, store, stored

from fitting.optimise.storm import WINDOW_RAMP, full_storm
from fitting.optimise.values import rest

#: Share by which a variable is moved, and how many variables are.
SHARE, STRONGEST = 0.03, 5
DURATION = 60.0


class Runs(Farm):
    """Runs of moved designs: each kind of run is made of a design and takes a case."""

    def window(self, x):
        run = self.peaks_of(x, DURATION)
        return lambda case: float(run(case).hard[0])

    def own_law(self, x):
        _, pose = self.at_rest(x, calm=False)
        return lambda case: float(full_storm(self.site, self.scene(x), case, self.quantities, pose).hard[0])


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
    runs = Runs(args.loops, values)
    names, x = [v.name for v in runs.variables], runs.x
    runs.prepare()
    runs.rest = rest(runs.still)
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
        for case in runs.site.cases:
            if str(case.seed) not in rows and time.perf_counter() - begun < args.seconds:
                yield case
                put()

    for case in missing(kept["base"]):
        found = runs.peaks(case, DURATION, slopes=True)
        hard = float(found.hard[0])
        # the slope of the soft peak, scaled
        kept["base"][str(case.seed)] = {"hard": hard, "slope": (found.slope[0] * hard / found.soft[0]).tolist()}
        kept["start"]["window"][str(case.seed)] = hard
    if len(kept["base"]) < args.seeds:
        return
    strength = np.abs(np.mean([row["slope"] for row in kept["base"].values()], axis=0) * x)
    kept["variables"] = [names[k] for k in np.argsort(-strength)[:STRONGEST]]
    for law, prepare in (("window", runs.window), ("own_law", runs.own_law)):
        designs = [(kept["start"][law], x)]
        for name in kept["variables"]:
            for sign, share in (("+", SHARE), ("-", -SHARE)):
                moved = runs.moved(names.index(name), share * x[names.index(name)])
                designs.append((kept["moved"].setdefault(f"{name}{sign}{law}", {}), moved))
        for rows, moved in designs:
            run = None
            for case in missing(rows):
                run = run or prepare(moved)
                rows[str(case.seed)] = run(case)
    put()
    for row in kept["table"]:
        say(row)
