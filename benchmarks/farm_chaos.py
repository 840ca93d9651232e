"""What a derivative of a storm foretells of the mean over ten seeds, where single storms are chaotic.

    python benchmarks/farm_chaos.py [--loops 60] [--seeds 10] [--out benchmarks/results/farm_chaos.json]

The mean of the largest leg tension over seeds of a storm of 60 s, with each of the five variables that move it most
3 % up and down: by windows as `dropper optimise` differentiates them (ropes damped), and by the scene's own rope law.
Beside it the change that the derivatives of the windows foretell, by their mean and by their median over the seeds.
Every run is stored; the next call continues.
"""

from functools import cache

import numpy as np
from farm_design import Farm
from study import RESULTS, command, resume, say, store, stored

from fitting.optimise.storm import WINDOW_RAMP, full_storm
from fitting.optimise.values import rest

#: Share by which a variable is moved, and how many variables are.
SHARE, STRONGEST = 0.03, 5
DURATION = 60.0
LAWS = ("window", "own_law")


def foretold(rows, slopes, value):
    """Measured changes of the mean over those that the mean and the median of the slopes foretell, by law.

    Args:
        rows: runs of the start and of the designs with one variable moved.
        slopes: derivatives (seeds,) by that variable. A seed whose peak comes as a rope tautens has one of its own, up
            to thirty times that of the others.
        value: of the variable at the start.
    """
    found = {"foretold": SHARE * value * np.mean(slopes), "foretold_median": SHARE * value * np.median(slopes)}
    for law in LAWS:
        own = [row for row in rows if row["law"] == law]
        down, start, up = ({row["seed"]: row["hard"] for row in own if row["sign"] == sign} for sign in (-1, 0, 1))
        low, middle, high = (np.mean(list(seeds.values())) if seeds else np.nan for seeds in (down, start, up))
        both = {"up": high - middle, "down": middle - low, "central": 0.5 * (high - low)}
        found[law] = {key: change / found["foretold"] for key, change in both.items()}
        found[law] |= {f"{key}_by_median": change / found["foretold_median"] for key, change in both.items()}
        spread = [up[seed] - down[seed] for seed in up if seed in down]
        if len(spread) > 1:
            found[law]["error"] = abs(0.5 * np.std(spread, ddof=1) / np.sqrt(len(spread)) / found["foretold"])
    return found


@command(loops=60, seeds=10, out=RESULTS / "farm_chaos.json")
def main(args):
    values = {"duration": DURATION, "seeds": args.seeds, "skip": WINDOW_RAMP, "ramp": WINDOW_RAMP}
    farm = Farm(args.loops, values)
    farm.prepare()
    farm.rest = rest(farm.still)
    cases = {case.seed: case for case in farm.site.cases}
    names = [v.name for v in farm.variables]

    def base(seed):
        found = farm.peaks(cases[seed], DURATION, slopes=True)
        scale = float(found.hard[0]) / found.soft[0]
        return {"hard": float(found.hard[0]), "slope": (scale * found.slope[0]).tolist()}

    @cache
    def peak(law, variable, sign):
        """A function of the case: the largest leg tension of a moved design."""
        x = designs[variable, sign]
        if law == "window":
            run = farm.peaks_of(x, DURATION)
        else:
            pose = farm.at_rest(x, calm=False)[1]
            run = lambda case: full_storm(farm.site, farm.scene(x), case, farm.quantities, pose)  # noqa: E731
        return lambda case: float(run(case).hard[0])

    def moved(law, variable, sign, seed):
        return {"hard": peak(law, variable, sign)(cases[seed])}

    resume(args.out, "base", ({"seed": seed} for seed in cases), base, loops=args.loops, share=SHARE)
    slopes = np.array([row["slope"] for row in stored(args.out)["base"]])
    strongest = np.argsort(-np.abs(np.mean(slopes, axis=0) * farm.x))[:STRONGEST]
    designs = {("", 0): farm.x}
    for k in strongest:
        designs |= {(names[k], sign): farm.moved(k, sign * SHARE * farm.x[k]) for sign in (1, -1)}
    wanted = (
        {"law": law, "variable": variable, "sign": sign, "seed": seed}
        for law in LAWS
        for variable, sign in designs
        for seed in cases
    )
    resume(args.out, "moved", wanted, moved)
    found = stored(args.out)
    found["table"] = []
    for k in strongest:
        own = [row for row in found["moved"] if row["variable"] in ("", names[k])]
        found["table"].append({"variable": names[k], **foretold(own, slopes[:, k], farm.x[k])})
        say(found["table"][-1])
    store(args.out, found)
