"""The posterior of the lab dropper's damping by importance sampling and by NUTS, and what both take.

    python benchmarks/posterior.py [--draws 120]

A synthetic trace of the lab dropper (scenario A, 16 s, 60 Hz, 5 mrad) is fitted by `shooting`, then sampled both ways.
Writes results/posterior.json.
"""

import numpy as np
from descent import lab_trace
from random_droppers import NAMES
from study import RESULTS, Found, collect, command, timed

from fitting import prepare
from fitting.calibration.estimating import estimate
from fitting.estimate.nuts import nuts
from fitting.estimate.posterior import importance
from fitting.estimate.uncertainty import uncertainty

OFF = 1.5
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)


@command(draws=120, out=RESULTS / "posterior.json")
def main(args) -> None:
    trace, wrong, head = lab_trace(OFF)
    solution = estimate(prepare(trace, wrong, NAMES), "shooting")
    fitted = uncertainty(solution)
    head |= {"values": solution.values.tolist(), "std_error": fitted.std_error.tolist(), "levels": LEVELS}
    samplers = {"importance": lambda: importance(solution, 200), "NUTS": lambda: nuts(solution, args.draws)}

    def row(name: str) -> Found:
        found, seconds = timed(samplers[name])
        # quantiles about the optimum, in its standard errors: of a normal posterior -1.64, -0.67, 0, 0.67, 1.64
        far = np.array([(found.quantile(p) - solution.values) / fitted.std_error for p in LEVELS])
        given = {"sampler": name, "warnings": found.warnings, "quantiles_in_errors": far.tolist()}
        return {**found.to_json(), **seconds, **given}

    collect(args.out, {"rows": map(row, samplers)}, gap_weight=solution.gap_weight, **head)
