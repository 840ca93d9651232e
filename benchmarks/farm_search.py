"""The search by gradients, differential evolution and CMA-ES at equal processor time.

    python benchmarks/farm_search.py gradient
    python benchmarks/farm_search.py de --seed 1      # SciPy's; likewise `cma --seed 1` with the package `cma`
    python benchmarks/farm_search.py gradient --site longline-200 --states 2 --storms 1 --duration 300 --limit 900

Every search minimises the material within the same bounds under the same constraints of whole runs. The searches
without gradients have the constraints as a penalty of the same weight as the search by gradients and start from the
same design; sizes of catalogues are left out for all, so that one problem is compared. Processor time counts from when
all programs are compiled. `--states` (the first ones), `--storms` (seeds of each) and `--duration` [s] reduce a site.
Every design is written to `results/farm_search_SITE.json` after its run, so that searches may run side by side.
"""

import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
from filelock import FileLock
from study import RESULTS, Found, Rows, columns, command, describe, percent, say, store, stored, table_of

from dropper_jax import SceneError
from fitting.optimise.design import run_parallel
from fitting.optimise.models import with_design
from fitting.optimise.run import read_problem
from fitting.optimise.search import PERMITTED_EXCESS, PRICE, Search, run_search, violation
from fitting.optimise.storm import full_storm
from fitting.site import read_site


def problem(name, states, **run):
    """A site without catalogues, with its first sea states and other values of its run."""
    table = dict(read_site(name).table)
    table["variable"] = [{k: v for k, v in row.items() if k != "catalogue"} for row in table["variable"]]
    table["sea_state"] = table["sea_state"][:states]
    table["run"] = {**table["run"], **{key: value for key, value in run.items() if value is not None}}
    design = read_problem(read_site({**table, "name": name}))
    design.settings = replace(design.settings, rounds=6)
    return design


class OutOfTimeError(Exception):
    """The processor time of a search is spent."""


class Judge:
    """Designs by whole runs alone, each with the processor time at its end; `save` is called after each."""

    def __init__(self, design, limit):
        self.design, self.limit, self.rows = design, limit or np.inf, []
        self.low = np.array([v.low for v in design.variables])
        self.span = np.array([v.span for v in design.variables])
        self.start = (design.start - self.low) / self.span
        self.scale = float(design.scene_constraints(design.start)[0][0])
        self.begun = time.process_time()

    @property
    def spent(self):
        return time.process_time() - self.begun

    def values(self, x):
        known = {}
        stands = [self.design.run_start(x, case, known) for case in self.design.cases]
        scene = with_design(self.design.site.scene, self.design.variables, x)

        def run(i):
            case, stand = self.design.cases[i], stands[i]
            quantities = self.design.quantities(case, stand.still)
            return full_storm(self.design.site, scene, case, quantities, stand.rest.state)

        full = run_parallel(run, range(len(stands)), lambda _: None, alone=int(not self.rows))
        for storm in full:
            if storm.message:
                raise SceneError(storm.message)
        return self.design.measure_full_runs(x, full)

    def seen(self, x, found):
        """Enter a design; `found` is None if it could not be run."""
        row = {"cpu_s": self.spent, "objective": None, "worst": None, "values": np.asarray(x).tolist()}
        self.rows.append(row if found is None else row | {"objective": found.objective, "worst": found.worst})
        self.save()

    def __call__(self, u):
        """Merit of a design in shares of the ranges."""
        if self.spent > self.limit:
            raise OutOfTimeError
        x, found = self.low + np.clip(u, 0.0, 1.0) * self.span, None
        with suppress(SceneError):
            found = self.values(x)
        self.seen(x, found)
        return 1e3 if found is None else found.objective / self.scale + PRICE * violation(found, 1.0)


def by_gradient(judge, _):
    """The package's own search; a design at every renewal of its windows."""
    design = judge.design
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


def compile_programs(judge, way):
    """Run every program of a search once."""
    design = judge.design
    if way == "gradient":
        windows, _ = design.renew_windows(design.start, lambda *_: None)
        design.values(design.start, windows, lambda *_: None)
    else:
        judge.values(design.start)
    judge.begun = time.process_time()


def best_of(rows, begun_before=np.inf):
    """Number of designs begun before a processor time, and the least objective of those that meet all constraints."""
    begun = [0.0, *(row["cpu_s"] for row in rows)]
    own = [row for at, row in zip(begun, rows, strict=False) if at < begun_before]
    met = [row["objective"] for row in own if row["worst"] is not None and row["worst"] <= 1.0 + PERMITTED_EXCESS]
    return len(own), min(met, default=np.inf)


@table_of("farm_search_longline_200", name="farm_search_longline_200")
def searches(found: Found) -> Rows:
    """Searches at the processor time of the last design by gradients, and at that of their own last one."""
    limit = found["searches"]["gradient"]["rows"][-1]["cpu_s"]

    def material(row, begun_before=np.inf):
        """Material and its reduction, if any design met all constraints."""
        best = best_of(row["rows"], begun_before)[1]
        return f"{best:.0f} ({percent(1.0 - best / found['start'])})" if np.isfinite(best) else "no feasible design"

    rows = ({"name": name, **found["searches"][name]} for name in sorted(found["searches"]))
    return columns(
        sorted(rows, key=lambda row: row["name"] != "gradient"),
        ("search", "{name}"),
        (f"designs run in {limit:.0f} s", lambda row: str(best_of(row["rows"], limit)[0])),
        ("material (reduction)", material, limit),
        ("until its last design", lambda row: f"{material(row)}, {row['cpu_s']:.0f} s"),
    )


@command({"way": tuple(WAYS)}, seed=1, site="small-longline", states=int, storms=int, duration=float, limit=float)
def main(args):
    file = RESULTS / f"farm_search_{args.site.replace('-', '_')}.json"
    judge = Judge(problem(args.site, args.states, seeds=args.storms, duration=args.duration), args.limit)
    name = args.way if args.way == "gradient" else f"{args.way}-{args.seed}"
    site = judge.design.site
    head = {"start": judge.scale, "cases": [f"{c.storm.name}, seed {c.seed}" for c in site.cases]}
    head |= {"duration": site.run.duration, "machine": describe()}

    def save(done=False):
        own = {"cpu_s": judge.spent, "done": done, "rows": judge.rows}
        with FileLock(f"{file}.lock"):
            kept = stored(file, {})
            store(file, {**kept, **head, "searches": {**kept.get("searches", {}), name: own}})

    judge.save = save
    compile_programs(judge, args.way)
    with suppress(OutOfTimeError):
        WAYS[args.way](judge, args.seed)
    save(done=True)
    count, best = best_of(judge.rows)
    say({"search": name, "cpu_s": judge.spent, "designs": count, "start": judge.scale, "best": best})
