"""The search by gradients beside differential evolution and CMA-ES, at equal processor time on the packaged small site.

    python benchmarks/farm_search.py gradient
    python benchmarks/farm_search.py de --seed 1      # SciPy's; likewise `cma --seed 1` with the package `cma`

Every way minimises the material within the same bounds under the same constraints of whole runs. The searches without
gradients have the constraints as a penalty of the same price as the search by gradients and start from the same design;
sizes of catalogues are left out for all, so that one problem is compared. The processor time counts from when all
programs are compiled. Writes `results/farm_search.json`.
"""

import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
from study import command, say, store, stored

from dropper_jax import SceneError
from fitting.optimise.models import with_design
from fitting.optimise.run import read_problem
from fitting.optimise.search import PERMITTED_EXCESS, PRICE, Search, run_search, violation
from fitting.optimise.storm import full_storm
from fitting.site import read_site


def problem():
    """The packaged small site without catalogues."""
    table = dict(read_site("small-longline").table)
    table["variable"] = [{k: v for k, v in row.items() if k != "catalogue"} for row in table["variable"]]
    return read_problem(read_site({**table, "name": "small-longline"}))


class OutOfTimeError(Exception):
    pass


class Judge:
    """Designs by whole runs alone, with the best feasible one over processor time."""

    def __init__(self, design, limit):
        self.design, self.limit, self.rows = design, limit, []
        self.runs, self.best, self.scale = 0, np.inf, 1.0
        self.low = np.array([v.low for v in design.variables])
        self.span = np.array([v.span for v in design.variables])
        self.start = (design.start - self.low) / self.span
        self.begun = time.process_time()

    @property
    def spent(self):
        return time.process_time() - self.begun

    def values(self, x):
        known = {}
        stands = [self.design.run_start(x, case, known) for case in self.design.cases]
        scene = with_design(self.design.site.scene, self.design.variables, x)
        full = []
        for case, stand in zip(self.design.cases, stands, strict=True):
            quantities = self.design.quantities(case, stand.still)
            full.append(full_storm(self.design.site, scene, case, quantities, stand.rest.state))
            if full[-1].message:
                raise SceneError(full[-1].message)
        return self.design.measure_full_runs(x, full)

    def seen(self, x, found):
        self.runs += 1
        if found.worst <= 1.0 + PERMITTED_EXCESS and found.objective < self.best:
            self.best = found.objective
            self.rows.append([round(self.spent, 1), self.runs, found.objective, np.asarray(x).tolist()])

    def __call__(self, u):
        """Merit of a design in shares of the ranges."""
        if self.spent > self.limit:
            raise OutOfTimeError
        x = self.low + np.clip(u, 0.0, 1.0) * self.span
        try:
            found = self.values(x)
        except SceneError:
            return 1e3
        self.seen(x, found)
        return found.objective / self.scale + PRICE * violation(found, 1.0)


def by_gradient(judge, _):
    """The package's own search; processor time and best design after every renewal."""
    design = judge.design
    windows, _ = design.renew_windows(design.start, lambda *_: None)
    design.values(design.start, windows, lambda *_: None)  # compiles the windows
    judge.begun = time.process_time()
    plain = design.measure_full_runs

    def measured(x, full):
        found = plain(x, full)
        judge.seen(x, found)
        return found

    design.measure_full_runs = measured
    run_search(Search(design.start, design.settings.reach), design, lambda: None, lambda *_: None)


def by_evolution(judge, seed):
    from scipy.optimize import differential_evolution

    settings = {"popsize": 5, "maxiter": 10_000, "tol": 0.0, "polish": False}
    differential_evolution(judge, [(0.0, 1.0)] * len(judge.start), x0=judge.start, rng=seed, **settings)


def by_cma(judge, seed):
    import cma

    cma.fmin2(judge, judge.start, 0.15, {"bounds": [0.0, 1.0], "seed": seed, "verbose": -9})


WAYS = {"gradient": by_gradient, "de": by_evolution, "cma": by_cma}


@command({"way": tuple(WAYS)}, seed=1, limit=float)
def main(args):
    kept = stored("farm_search", {})
    design = problem()
    design.settings = replace(design.settings, rounds=6)
    judge = Judge(design, args.limit or kept.get("gradient", {}).get("cpu_s", np.inf))
    start = judge.values(design.start).objective  # compiles the whole run
    judge.scale = start
    judge.begun = time.process_time()
    with suppress(OutOfTimeError):
        WAYS[args.way](judge, args.seed)
    best = min(judge.best, start)
    own = {"cpu_s": judge.spent, "designs": judge.runs, "start": start, "best": best, "reduction": 1.0 - best / start}
    say(own)
    name = args.way if args.way == "gradient" else f"{args.way}-{args.seed}"
    store("farm_search", {**kept, name: own | {"rows": judge.rows}})
