"""Random lab droppers that nobody tuned a fit for: does the default `fit` find their damping, or say that it does not?

    python benchmarks/random_droppers.py [--seeds 0:60] [--kind plain] [--window S] [--out FILE]

A draw is a chain of 3 to 12 links between two hooks, every fourth one with a free end. It is lifted at one or two
nodes, released, and seen by a camera with white noise. Both damping coefficients start five times off. Every third draw
moves faster than 40 rad/s, the others do not. The truth is simulated by another scheme at a much finer step than a fit
takes. Each row compares the estimates, standard errors and noise of the default command with the truth. Writes
results/random_droppers.json.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from study import RESULTS, Found, collect, command, seeds_of, timed

from dropper_jax import Scene, SceneError, load_scene
from fitting import Camera, FitSettings, Trace, fit, observe, simulate_truth
from fitting.estimate.uncertainty import degrees_of_freedom

NAMES = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
GRAVITY = 9.81
#: Peak rate [rad/s] that every third draw exceeds, and how many rigs are tried at most.
FAST = 40.0
TRIES = 200
#: Steps of the truth per second; by a fourth-order scheme the truth is then exact to 1e-6 rad over a window.
TRUTH_STEPS = 4800.0
#: Kinds of draws, and what the table calls them.
KINDS = {
    "plain": "60 to 240 Hz",
    "slow-camera": "30 Hz",
    "missing": "5 % of the samples and 0.2 s missing",
    "still": "held still for 2 s before the release",
}
STILL = 2.0


@dataclass(frozen=True)
class Draw:
    """A rig, what the camera saw of it, and the truth.

    Attributes:
        scene: with the true damping.
        start: where the fit starts, by parameter.
        trace: noisy angles.
        truth: (b_l [kg/s], b_q [kg/m]).
        noise: deviation of the angles [rad].
        peak: largest rate of a link [rad/s].
    """

    seed: int
    scene: Scene
    start: dict[str, float]
    trace: Trace
    truth: np.ndarray
    noise: float
    peak: float


def draw(seed: int, kind: str = "plain") -> Draw:
    """The draw of a seed, drawn again until every third one moves faster than `FAST`, and the others do not."""
    rng = np.random.default_rng([seed, 36])
    for _ in range(TRIES):
        with suppress(SceneError):
            found = _one(seed, rng, kind)
            if (found.peak > FAST) == (seed % 3 == 0):
                return found
    raise RuntimeError(f"seed {seed}: {TRIES} rigs on the wrong side of {FAST:g} rad/s")


@dataclass(frozen=True)
class Rig:
    """A drawn dropper before it is seen: with its damping, where a fit starts, and the camera's rate and noise."""

    scene: Scene
    truth: np.ndarray
    low_or_high: np.ndarray
    rate: float
    duration: float
    noise: float


def draw_rig(seed: int, rng: np.random.Generator, kind: str = "plain") -> Rig:
    """The next rig of a seed."""
    links = int(rng.integers(3, 13))
    length = float(rng.uniform(0.04, 0.15))
    mass = float(rng.uniform(0.01, 0.08))
    truth = np.array([mass * 10 ** rng.uniform(-1.6, -0.8) for _ in NAMES])
    lifted = min(int(rng.integers(1, 3)), links - 1)
    nodes = sorted(int(i) for i in rng.choice(np.arange(1, links), lifted, replace=False))
    lift = rng.uniform(0.3, 1.0, lifted) * links * mass * GRAVITY
    free_end = seed % 4 == 3
    # a free end hangs straight below any vertical force: it is pulled sideways
    if free_end:
        tilt = rng.uniform(0.5, 1.2, lifted) * rng.choice([-1, 1])
    else:
        tilt = np.zeros(lifted)
    gap = float(rng.uniform(0.2, 0.7)) * links * length
    rate = float(rng.choice([60, 80, 100, 120, 160, 200, 240]))
    duration = float(rng.uniform(6, 14))
    noise = float(rng.uniform(2e-3, 6e-3))
    low_or_high = rng.choice([0.2, 5.0], 2)
    if kind == "slow-camera":
        rate = 30.0
    hook = {"name": "left", "position": [0.0, 0.0, 0.0]}
    end = {"name": "right", "position": [gap, 0.0, 0.0]}
    if free_end:
        end |= {"position": [0.0, 0.0, -links * length], "kind": "free"}
    line = {"name": "rig", "from": "left", "to": "right", "links": links, "length": length, "mass": mass}
    force = np.stack([lift * np.sin(tilt), np.zeros(lifted), lift * np.cos(tilt)], axis=1)
    scene = load_scene(
        {
            "run": {"dt": 0.002, "duration": duration},
            "point": [hook, end],
            "line": [line],
            "effects": {"weight": {}, "linear_damping": {"b_l": truth[0]}, "quadratic_damping": {"b_q": truth[1]}},
            "start": {"kind": "static", "release_nodes": nodes, "release_force": force.tolist()},
        }
    )
    return Rig(scene, truth, low_or_high, rate, duration, noise)


def _one(seed: int, rng: np.random.Generator, kind: str) -> Draw:
    rig = draw_rig(seed, rng, kind)
    scene = rig.scene
    truth = rig.truth
    rate = rig.rate
    duration = rig.duration
    noise = rig.noise
    motion = simulate_truth(scene, duration, rate, round(TRUTH_STEPS / rate), "rattle_4")
    trace = observe(motion, Camera(rate=rate, angle_noise=noise), seed, f"rig-{seed}")
    if kind == "missing":
        trace = _with_missing(trace, rng)
    if kind == "still":
        trace = _with_still_start(trace, rng, noise)
    link = np.diff(motion.nodes[..., [0, 2]], axis=1)
    theta = np.unwrap(np.arctan2(-link[..., 1], link[..., 0]), axis=0)
    peak = float(np.abs(np.diff(theta, axis=0)).max() / (motion.t[1] - motion.t[0]))
    return Draw(seed, scene, dict(zip(NAMES, truth * rig.low_or_high, strict=True)), trace, truth, noise, peak)


def _with_missing(trace: Trace, rng: np.random.Generator) -> Trace:
    """5 % of the samples and one stretch of 0.2 s missing."""
    begin = rng.uniform(trace.t[0] + 0.5, trace.t[-1] - 0.7)
    gone = (rng.random(trace.theta.shape) < 0.05) | ((trace.t >= begin) & (trace.t < begin + 0.2))[:, None]
    return replace(trace, theta=np.where(gone, np.nan, trace.theta))


def _with_still_start(trace: Trace, rng: np.random.Generator, noise: float) -> Trace:
    """Held still for 2 s before the release."""
    frames = round(STILL / trace.interval)
    still = trace.theta[0] + noise * rng.standard_normal((frames, trace.links))
    t = np.concatenate([trace.t[0] + trace.interval * np.arange(-frames, 0), trace.t]) + frames * trace.interval
    return replace(trace, t=t, theta=np.concatenate([still, trace.theta]))


def judge(d: Draw, held: float, **options: Any) -> Found:
    """A row: the default fit of a draw, held still for so long [s] before, against its truth."""
    result, times = timed(lambda: fit([d.trace], d.scene, start=d.start, **options))
    u = result.uncertainty
    solution = result.solution
    known = solution.windows.weight > 0
    moving = d.trace.theta[d.trace.t >= held]
    # by leverage: samples less what the fit has used up of them
    residual = float(np.sqrt(np.sum(solution.errors**2) / max(degrees_of_freedom(solution), 1)))
    return {
        **{"seed": d.seed, "links": d.trace.links, "free_end": d.seed % 4 == 3, "peak": d.peak},
        **{"rate": 1 / d.trace.interval, "noise": d.noise, "truth": d.truth.tolist()},
        **{"status": result.status, "message": result.message, "values": result.values.tolist()},
        **{"std_error": u.std_error.tolist(), "low": u.low.tolist(), "high": u.high.tolist()},
        **{"least_p": min((test.p for test in result.laws.tests), default=1.0)},
        **{"at_bound": u.at_bound.tolist(), "residual": residual, "chi2": result.chi2_per_dof},
        **{"printed_noise": float(np.sqrt(np.mean(np.square(result.noise_table()["sigma_rad"]))))},
        **{
            "fitted": float(known.sum() / np.isfinite(moving).sum()),
            "gap_weight": solution.gap_weight,
        },
        **{"windows": result.windows.count, "blocks": u.blocks, "warnings": result.warnings},
        **{"substeps": result.windows.substeps, "seconds": times["processor_s"]},
    }


@command(seeds="0:60", kind=tuple(KINDS), window=float, out=RESULTS / "random_droppers.json")
def main(args) -> None:
    def row(seed: int) -> Found:
        d = draw(seed, args.kind)
        try:
            return judge(d, STILL * (args.kind == "still"), settings=FitSettings(window=args.window))
        except SceneError as error:
            failed = {"status": "invalid_input", "message": str(error), "printed_noise": 0}
            return {"seed": seed, "noise": d.noise, **failed}

    collect(args.out, {KINDS[args.kind]: map(row, seeds_of(args.seeds))}, KINDS[args.kind])
