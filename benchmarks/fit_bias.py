"""Bias of fits: how far from the truth does a fit end without noise, and on average over noise?

    python benchmarks/fit_bias.py [--seeds 0:20] [--pairs 2] [--out FILE]

Rigs are drawn as in `random_droppers`, every third one seen at 60 Hz. SciPy integrates the
truth (`closed_chain.rigid_line`), so that it has no error of a fit's step. A trace with noise is fitted; its weights,
windows, step and gap weight are kept, and the same fit continues on the samples without noise, and with further noise
and its negative, whose mean has no error of first order. Written are these errors in standard errors of the first fit,
and the error without noise with half the step. Writes results/fit_bias.json.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from closed_chain import rigid_line, still
from random_droppers import NAMES, TRIES, Rig, draw_rig
from study import RESULTS, Found, collect, command, seeds_of, timed

from dropper_jax import SceneError
from dropper_jax.modelling.build import build
from fitting import Convention, Trace, prepare
from fitting.calibration.summarise import summarise
from fitting.estimate.least_squares import descend
from fitting.estimate.objective import objective_at
from fitting.estimate.solution import Solution
from fitting.estimate.window_problem import Problem
from fitting.windows.method import estimate
from fitting.windows.sound_windows import with_sound_windows

#: Rate of the camera of every third draw [1/s].
SLOW_CAMERA = 60.0
#: Evaluations of a fit that continues on other samples.
CONTINUED = 40


@dataclass(frozen=True)
class Draw:
    """A rig, its noise-free angles (frames, n) from the horizontal at times t, and the fastest rate seen [rad/s]."""

    rig: Rig
    t: np.ndarray
    theta: np.ndarray
    peak: float


def swing(rig: Rig, t: np.ndarray, free_end: bool) -> np.ndarray:
    """Angles (frames, n) of a rig released from its static pose."""
    model, state = build(rig.scene)
    nodes = np.asarray(model.nodes(state.r, model.ends(0.0)))
    line = rig.scene.line
    ends = [still(nodes[0])]
    if not free_end:
        ends.append(still(nodes[-1]))
    masses = np.full(len(nodes) - len(ends), np.mean(line.mass))
    lengths = np.full(len(nodes) - 1, np.mean(line.length))
    damping = dict(zip(("b_l", "b_q"), rig.truth, strict=True))
    path = rigid_line(t, nodes, np.zeros_like(nodes), lengths, masses, **damping, ends=tuple(ends))
    link = np.diff(path[..., [0, 2]], axis=1)
    return np.unwrap(np.arctan2(-link[..., 1], link[..., 0]), axis=0)


def draw(seed: int) -> Draw:
    """The draw of a seed: the first rig that can be released."""
    rng = np.random.default_rng([seed, 61])
    for _ in range(TRIES):
        with suppress(SceneError, RuntimeError):
            rig = draw_rig(seed, rng)
            if seed % 3 == 0:
                rig = replace(rig, rate=SLOW_CAMERA)
            t = np.arange(round(rig.duration * rig.rate) + 1) / rig.rate
            theta = swing(rig, t, seed % 4 == 3)
            return Draw(rig, t, theta, float(np.abs(np.diff(theta, axis=0)).max() * rig.rate))
    raise RuntimeError(f"seed {seed}: no rig of {TRIES} can be released")


@dataclass(frozen=True)
class Refit:
    """Continues a fit on other samples at the same times.

    Attributes:
        solution: the end of the fit.
        seen: samples (frames, n) of the fit.
        frame: number of the frame of every slot (K, S).
    """

    solution: Solution
    seen: np.ndarray
    frame: np.ndarray

    def on(self, theta: np.ndarray, finer: bool = False) -> tuple[np.ndarray, str]:
        """Parameters (k,) fitted to samples (frames, n), and the status of the fit."""
        windows = self.solution.windows
        moved = windows.theta + (theta - self.seen)[self.frame]
        known = windows.weight > 0
        problem: Problem = replace(self.solution.problem, windows=replace(windows, theta=np.where(known, moved, 0.0)))
        if finer:
            problem = problem.finer()
        evaluation = problem.evaluate(self.solution.values, self.solution.starts)
        begin = replace(self.solution, problem=problem, evaluation=evaluation, history=[])
        found = descend(objective_at(problem, self.solution.gap_weight), begin, CONTINUED)
        return found.values, found.status


def measure(seed: int, pairs: int) -> Found:
    """The row of a seed."""
    d = draw(seed)
    rng = np.random.default_rng([seed, 62])
    noises = d.rig.noise * rng.standard_normal((pairs + 1, *d.theta.shape))
    seen = d.theta + noises[0]
    trace = Trace(f"rig-{seed}", d.t, seen, convention=Convention("horizontal", 1, "rad"))
    start = dict(zip(NAMES, d.rig.truth * d.rig.low_or_high, strict=True))

    def fitted():
        prepared = with_sound_windows(prepare([trace], d.rig.scene, list(NAMES), start=start))
        return summarise(prepared, "shooting", estimate(prepared))

    result, times = timed(fitted)
    solution = result.solution
    error = result.uncertainty.std_error
    frame = np.rint((solution.windows.times() - d.t[0]) * d.rig.rate).astype(int)
    refit = Refit(solution, seen, np.clip(frame, 0, len(d.t) - 1))
    clean, clean_status = refit.on(d.theta)
    finer, _ = refit.on(d.theta, finer=True)
    both = []
    for noise in noises[1:]:
        ends = [refit.on(d.theta + sign * noise)[0] for sign in (1, -1)]
        both.append(((np.mean(ends, axis=0) - clean) / error).tolist())
    windows = solution.windows
    return {
        **{"seed": seed, "links": d.theta.shape[1], "free_end": seed % 4 == 3, "peak": d.peak, "rate": d.rig.rate},
        **{"duration": d.rig.duration, "noise": d.rig.noise, "status": result.status, "message": result.message},
        **{"errors": ((result.values - d.rig.truth) / error).tolist(), "std_error": error.tolist()},
        **{"relative_error": (error / d.rig.truth).tolist()},
        **{"without_noise": ((clean - d.rig.truth) / error).tolist(), "clean_status": clean_status},
        **{"half_the_step": ((finer - d.rig.truth) / error).tolist(), "by_noise": both},
        **{"step_bias": np.asarray(solution.step_bias).tolist(), "gap_weight": solution.gap_weight},
        **{"substeps": windows.substeps, "dt": windows.dt, "windows": windows.count},
        **{"least_p": min((test.p for test in result.laws.tests), default=1.0), "seconds": times["processor_s"]},
    }


@command(seeds="0:20", pairs=2, out=RESULTS / "fit_bias.json")
def main(args) -> None:
    collect(args.out, {"rigs": (measure(seed, args.pairs) for seed in seeds_of(args.seeds))}, by="seed")
