"""The posterior of the lab dropper's damping by importance sampling and by NUTS, and what both take.

    python benchmarks/posterior.py [--draws 120]

A synthetic trace of the lab dropper (scenario A, 16 s, 60 Hz, 5 mrad) is fitted by `shooting`, then sampled both ways.
Writes results/posterior.json.
"""

import numpy as np
from study import RESULTS, Found, command, describe, say, store, timed

import dropper_jax as dj
from fitting import prepare
from fitting.calibration.estimating import estimate
from fitting.estimate.nuts import nuts
from fitting.estimate.posterior import importance
from fitting.estimate.uncertainty import uncertainty
from fitting.traces.synthetic import Camera, observe, simulate_truth

SCENE, DURATION, NOISE, OFF = "dropper-release-a", 16.0, 0.005, 1.5
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)


@command(draws=120, out=RESULTS / "posterior.json")
def main(args) -> None:
    scene = dj.load_scene(SCENE)
    names = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
    truth = [scene.value(name) for name in names]
    trace = observe(simulate_truth(scene, DURATION, 60.0), Camera(rate=60.0, angle_noise=NOISE), seed=0)
    wrong = scene.with_values({name: OFF * value for name, value in zip(names, truth, strict=True)})
    solution, seconds = timed(lambda: estimate(prepare(trace, wrong, names), "shooting"))
    say({"status": solution.status, **seconds})
    fitted = uncertainty(solution)
    rows: list[Found] = []
    samplers = {"importance": lambda: importance(solution, 200), "NUTS": lambda: nuts(solution, args.draws)}
    for name, sample in samplers.items():
        found, seconds = timed(sample)
        # quantiles about the optimum, in its standard errors: of a normal posterior -1.64, -0.67, 0, 0.67, 1.64
        far = np.array([(found.quantile(p) - solution.values) / fitted.std_error for p in LEVELS])
        row = {"sampler": name, **found.to_json(), **seconds, "quantiles_in_errors": far.tolist()}
        rows.append({**row, "warnings": found.warnings})
        say(rows[-1])
    found = {
        "scene": SCENE, "duration_s": DURATION, "noise_rad": NOISE, "truth": truth, "values": solution.values.tolist(),
        "std_error": fitted.std_error.tolist(), "gap_weight": solution.gap_weight, "levels": LEVELS, "rows": rows,
        "machine": describe(),
    }  # fmt: skip
    store(args.out, found)
