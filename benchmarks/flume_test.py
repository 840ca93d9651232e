"""C_D and C_M of a looped dropper from a test in waves: what the fit finds where MoorDyn is the truth.

A loop of 3 m hangs on two hooks in a flume of 4 m; irregular waves pass. Load cells at the hooks and a camera on the
lowest point measure. MoorDyn (WaveKin 7, 0.1 ms) makes the measurement, `fit_channels` finds `cdn` and `can`, with
C_M = 1 + can, from start values of about half the true ones. Before the test, `plan` gives the errors to expect, by the
information of the samples at the start values:

    S(T) = sum over samples before T of J' J / sigma^2,      errors = sqrt(diag(S^-1))

    python benchmarks/flume_test.py [--seeds 0:20]
"""

import math
from typing import Any

import numpy as np
from moordyn_runs import Looks, looks_at
from study import Found, command, say, seeds_of, store, versions

from dropper_jax import Scene
from fitting import fit_channels
from fitting.channels.make_problem import make_problem

TRUTH = {"cdn": 1.4, "can": 0.9}
START = {"cdn": 0.8, "can": 0.4}
FREE = [f"line_type.dropper.{name}" for name in TRUTH]
#: Hooks [m]: below the troughs, so that no link leaves the water.
SPAN, HOOKS = 0.6, -0.7
HALF_LENGTH, HALF_LINKS = 1.5, 16
DURATION = 40.0
#: The waves rise over 5 s, in MoorDyn by another curve: samples count from here [s].
FROM = 15.0
#: Time between samples [s], and noise: 1 % of the load cells' range of 100 N, and a camera's 5 mm.
SAMPLE = 0.04
NOISE = {"tension": 1.0, "position": 0.005}
#: Step of the fit, and MoorDyn's, whose scheme is explicit [s].
STEP, THEIR_STEP = 0.01, 1e-4
PLANNED = (20.0, 30.0, 40.0)
#: Of a normal distribution: half the width of an interval of 90 %.
NINETY = 1.645


def flume(cdn: float, can: float) -> Scene:
    """The loop in two lines, so that its lowest point has a name."""
    lowest = HOOKS - math.sqrt(HALF_LENGTH**2 - (SPAN / 2) ** 2)
    line = {"type": "dropper", "length": HALF_LENGTH, "links": HALF_LINKS}
    waves = {"kind": "spectrum", "spectrum": "jonswap", "hs": 0.3, "tp": 2.5, "gamma": 3.3, "count": 40, "seed": 1}
    kind = {"mass": 18.0, "diameter": 0.12, "EA": 2e5, "damping_ratio": 0.1, "cdt": 0.3, "cat": 0.1}
    return Scene.from_dict(
        {
            "name": "flume",
            "run": {"dt": STEP, "duration": DURATION, "save_interval": SAMPLE},
            "line_type": [{"name": "dropper", "cdn": cdn, "can": can, **kind}],
            "point": [
                {"name": "left", "position": [-SPAN / 2, 0.0, HOOKS]},
                {"name": "right", "position": [SPAN / 2, 0.0, HOOKS]},
                {"name": "lowest", "kind": "free", "position": [0.0, 0.0, lowest]},
            ],
            "line": [
                {"name": "first", "from": "left", "to": "lowest", **line},
                {"name": "second", "from": "lowest", "to": "right", **line},
            ],
            "sea": {"depth": 4.0, "density": 1000.0, "ramp": 5.0, "waves": waves},
            "start": {"kind": "static"},
            "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
        }
    )


def measurement(truth: Looks, noise: float, seed: int) -> Found:
    """The samples of the test with `noise` times the sensors' noise, and the sensors."""
    rng = np.random.default_rng(seed)

    def read(values: np.ndarray, kind: str) -> np.ndarray:
        return values + noise * NOISE[kind] * rng.standard_normal(values.shape)

    x, _, z = truth.position[:, 0].T
    file = {
        "t": truth.t,
        "left": read(truth.tension[:, 0], "tension"),
        "right": read(truth.tension[:, 1], "tension"),
        "x": read(x, "position"),
        "z": read(z, "position"),
    }
    cell = {"kind": "tension", "unit": "N", "noise": NOISE["tension"]}
    camera = {"kind": "position", "unit": "m", "noise": NOISE["position"], "axes": ["x", "z"]}
    return {
        "run": [{"file": file, "from": FROM}],
        "channel": [
            {"name": "left", "column": "left", "line": "first", "end": "from", **cell},
            {"name": "right", "column": "right", "line": "second", "end": "to", **cell},
            {"name": "lowest", "columns": ["x", "z"], "point": "lowest", **camera},
        ],
    }


def plan(truth: Looks) -> list[Found]:
    """Errors to expect of tests of several durations, at the start values (of `truth`, the times count)."""
    problem = make_problem(measurement(truth, 1.0, 0), flume(**START), FREE, (), {}, {}, {})
    slopes = problem.evaluate(problem.values).slopes[0]
    times = problem.data.runs[0].t
    noise = (NOISE["tension"], NOISE["tension"], NOISE["position"])
    rows = []
    for until in PLANNED:
        information = np.zeros((len(FREE), len(FREE)))
        for number, sigma in enumerate(noise):
            part = slopes[number][times[number] <= until].reshape(-1, len(FREE)) / sigma
            information += part.T @ part
        rows.append({"until_s": until, "errors": np.sqrt(np.diag(np.linalg.inv(information))).tolist()})
    return rows


def fitted(truth: Looks, noise: float, seed: int) -> Found:
    """Values, standard errors, and whether the intervals of 90 % hold the truth."""
    result = fit_channels(measurement(truth, noise, seed), flume(**START), FREE)
    off = np.asarray(result.values) - list(TRUTH.values())
    errors = np.asarray(result.errors.std_error)
    found: dict[str, Any] = {"seed": seed, "noise": noise, "status": result.status}
    found |= {"values": list(map(float, result.values)), "std_errors": errors.tolist()}
    found["inside"] = (np.abs(off) <= NINETY * errors).tolist()
    return found | {"warnings": list(result.warnings)}


@command({}, seeds="0:20")
def main(args) -> None:
    ends = ((1, False), (2, True))
    truth = looks_at(flume(**TRUTH), THEIR_STEP, DURATION, SAMPLE, ends, ((1, True),))
    planned = plan(truth)
    say(planned)
    rows = []
    for seed in seeds_of(args.seeds):
        rows.append(fitted(truth, 1.0, seed))
        say(rows[-1])
    exact = fitted(truth, 0.0, 0)
    say(exact)
    store("flume_test", {"truth": TRUTH, "planned": planned, "rows": rows, "exact": exact, **versions("moordyn")})
