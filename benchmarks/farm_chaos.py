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
    """Runs of moved designs; the model and pose of the last design are kept."""

    def __init__(self, site, variables, x):
        self.site, self.variables, self.x = site, variables, x
        self.storm = site.cases[0].storm
        self.still = still(site, variables, x, self.storm)
        self.rest = rest(self.still)
        self.quantities = (part_load(self.still.model, site.parts[0]),)
        self._last = None

    def design(self, moved, calm):
        key = moved.tobytes(), calm
        if self._last is None or self._last[0] != key:
            model = still_model(self.site, self.variables, moved, self.storm, calm)
            self._last = key, model, near_rest(model, self.rest.state)
        return self._last[1:]

    def slopes(self, case):
        """Hard peak and its derivatives, the soft ones scaled."""
        sea = self.sea(self.x, case)
        found = peaks(self.still, self.rest, sea, self.quantities, self.site.scene.run.dt, DURATION, True)
        return float(found.hard[0]), (found.slope[0] * found.hard[0] / found.soft[0]).tolist()

    def sea(self, x, case):
        return sea_of(self.site, with_design(self.site.scene, self.variables, x), case, WINDOW_RAMP)

    def window(self, moved, case):
        model, pose = self.design(moved, True)
        still_, own = Still(model, self.still.slopes), Rest(pose, self.rest.dr, self.rest.dtension)
        found = peaks(still_, own, self.sea(moved, case), self.quantities, self.site.scene.run.dt, DURATION, False)
        return float(found.hard[0])

    def own_law(self, moved, case):
        scene = with_design(self.site.scene, self.variables, moved)
        found = full_storm(self.site, scene, case, self.quantities, self.design(moved, False)[1])
        return float(found.hard[0])


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
            ends, start = [], np.mean(list(kept["start"].get(law, {}).values() or [np.nan]))
            for sign in ("+", "-"):
                own = list(kept["moved"].get(f"{name}{sign}{law}", {}).values())
                ends.append(np.mean(own) if own else np.nan)
            spread = [
                kept["moved"][f"{name}+{law}"][s] - kept["moved"][f"{name}-{law}"][s]
                for s in kept["moved"].get(f"{name}+{law}", {})
                if s in kept["moved"].get(f"{name}-{law}", {})
            ]
            both = {"up": ends[0] - start, "down": start - ends[1], "central": 0.5 * (ends[0] - ends[1])}
            row[law] = {key: value / row["foretold"] for key, value in both.items()}
            row[law] |= {f"{key}_by_median": value / row["foretold_median"] for key, value in both.items()}
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

    def late():
        return time.perf_counter() - begun > args.seconds

    def put(done=False):
        kept["cpu_s"] = kept.get("cpu_s", 0.0) + time.process_time() - put.last
        put.last = time.process_time()
        if done or kept["moved"]:
            kept["table"] = foretold(kept, names, x)
        store("farm_chaos", kept)

    put.last = 0.0
    for case in site.cases:
        if str(case.seed) not in kept["base"] and not late():
            hard, slope = runs.slopes(case)
            kept["base"][str(case.seed)] = {"hard": hard, "slope": slope}
            kept["start"]["window"][str(case.seed)] = hard
            put()
    if len(kept["base"]) < args.seeds:
        return
    strength = np.abs(np.mean([row["slope"] for row in kept["base"].values()], axis=0) * x)
    kept["variables"] = [names[k] for k in np.argsort(-strength)[:STRONGEST]]
    for law, run in (("window", runs.window), ("own_law", runs.own_law)):
        designs = [(None, x)]
        for name in kept["variables"]:
            for sign, share in (("+", SHARE), ("-", -SHARE)):
                moved = x.copy()
                moved[names.index(name)] *= 1.0 + share
                designs.append((f"{name}{sign}{law}", moved))
        for key, moved in designs:
            rows = kept["start"][law] if key is None else kept["moved"].setdefault(key, {})
            for case in site.cases:
                if str(case.seed) in rows or late():
                    continue
                rows[str(case.seed)] = run(moved, case)
                put()
    put(done=True)
    for row in kept["table"]:
        say(row)
