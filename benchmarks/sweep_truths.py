"""How well a sweep names the true pair of damping coefficients, and what the fit does with the same traces.

    python benchmarks/sweep_truths.py [--duration 50] [--out benchmarks/results/sweep_truths.json]

Each of the 15 pairs of the thesis' Table E.1 is the truth once: the lab dropper of scenario A from the scene's start,
by SciPy's DOP853 (`closed_chain`), 60 Hz, white noise of 5 mrad. All 15 pairs are scored against it by head, middle and
tail, and b_l and b_q fitted to it.
"""

import tempfile
from functools import partial

import numpy as np
from closed_chain import Chain
from study import RESULTS, Found, collect, command, describe, timed

import dropper_jax as dj
from fitting import Convention, Trace, fit
from fitting.cli.sweep import use_cores
from fitting.sweep import sweep_against_trace
from fitting.sweep.scores import TRACE_PARTS

#: Thesis Table E.1: b_l [kg/s] and b_q [kg/m].
PAIRS = {
    "b_l": [0.002, 0.002, 0.05, 0.01, 0.004, 0.004, 0.05, 0.01, 0.001, 0.001, 0.05, 0.01, 0.002, 0.004, 0.001],
    "b_q": [0.5, 0.1, 0.01, 0.01, 0.5, 0.1, 0.03, 0.03, 0.5, 0.1, 0.001, 0.001, 0.01, 0.03, 0.05],
}
SCENE = "dropper-release-a"
RATE = 60.0
NOISE = 0.005
MEASURES = ("angle", "spectrum")


def truth(scene: str | Found, b_l: float, b_q: float, duration: float, seed: int) -> Trace:
    """A noisy trace of a dropper between two ends, released from its scene's start."""
    model, start = dj.build(scene)
    nodes = np.asarray(model.nodes(start.r, model.ends(0.0)))[:, [0, 2]]
    link = np.diff(nodes, axis=0)
    mass = np.broadcast_to(dj.load_scene(scene).to_dict()["line"][0]["mass"], len(link))
    chain = Chain(np.asarray(model.line.length), mass[:-1], nodes[-1] - nodes[0], b_l, b_q)
    t = np.arange(round(duration * RATE) + 1) / RATE
    theta = chain.angles(chain.swing(np.arctan2(-link[:, 1], link[:, 0]), t))
    theta = theta + NOISE * np.random.default_rng(seed).standard_normal(theta.shape)
    return Trace(f"truth-{b_l:g}-{b_q:g}", t, theta, convention=Convention("horizontal", 1, "rad"))


def rank(score: np.ndarray, case: int) -> Found:
    """Rank of a case (1: best), its score and the best other one [rad]."""
    others = np.delete(score, case)
    return {"rank": 1 + int(np.sum(others < score[case])), "true": score[case], "other": np.nanmin(others)}


def fitted(trace: Trace, pair: np.ndarray) -> Found:
    """The fit of both coefficients from the scene's own values, and its distance from the truth in standard errors."""
    result = fit(trace, SCENE, list(PAIRS))
    off = (np.asarray(result.values) - pair) / np.asarray(result.uncertainty.std_error)
    return {
        "status": result.status,
        "values": list(map(float, result.values)),
        "std_errors": list(map(float, result.uncertainty.std_error)),
        "off": list(map(float, off)),
    }


@command(duration=50.0, out=RESULTS / "sweep_truths.json")
def main(args) -> None:
    use_cores(None)
    pairs = list(zip(*PAIRS.values(), strict=True))
    traces = [truth(SCENE, *pair, args.duration, case) for case, pair in enumerate(pairs)]

    def row(case: int, folder: str) -> Found:
        given = SCENE, PAIRS, traces[case], f"{folder}/pairs.zarr"
        # all truths have one sweep, which the first one runs
        scores, times = timed(partial(sweep_against_trace, *given, listed=True, chunk=8, quantities=[]))
        ranks = {
            name: {by: rank(getattr(scores, by)[:, part], case) for by in MEASURES}
            for part, name in enumerate(TRACE_PARTS)
        }
        fit_, fit_times = timed(partial(fitted, traces[case], np.array(pairs[case])))
        cost = {"sweep_cpu_s": times["processor_s"], "fit_cpu_s": fit_times["processor_s"]}
        return {"b_l": pairs[case][0], "b_q": pairs[case][1], **ranks, "fit": fit_, **cost}

    with tempfile.TemporaryDirectory() as folder:
        rows = (row(case, folder) for case in range(len(pairs)))
        collect(args.out, {"rows": rows}, machine=describe(), noise_rad=NOISE, duration_s=args.duration)
