"""Twin experiments: does the calibration find the truth, and do its errors mean what they say?

The truth is the lab dropper of scenario A with b_l = 0.002 and b_q = 0.001, integrated by energy_momentum at
1/9600 s (the fit runs rattle_4 at 1/120 s), seen at 60 Hz for 48 s with 0.005 rad of noise. Fits start at (0.02, 0.02).

    python benchmarks/calibration.py coverage|dry|dry-small|bias [--seeds N]
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from study import Found, command, say, store, stored

from dropper_jax import Scene, load_scene
from fitting import Camera, FitResult, Trace, observe, prepare, simulate_truth
from fitting.calibration.fit import estimate, summarise
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.shooting import fit_shooting, level_of
from fitting.estimate.windows import Windows, cut, first_starts

SCENE, DURATION, NOISE = "dropper-release-a", 48.0, 0.005
FREE = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
DRY = "effects.joint_friction.dry"
TRUTH = {FREE[0]: 0.002, FREE[1]: 0.001, DRY: 1e-5}
START = {FREE[0]: 0.02, FREE[1]: 0.02, DRY: 1e-4}


#: A smaller twin with dry friction: the first three links of the lab dropper, hanging, 12 s.
DRY_SCENE = {
    "run": {"dt": 0.002, "duration": 12.0},
    "point": [
        {"name": "pivot", "position": [0.0, 0.0, 0.0]},
        {"name": "end", "kind": "free", "position": [0.3141, 0.0, 0.0]},
    ],
    "line": [
        {
            "name": "dropper",
            "from": "pivot",
            "to": "end",
            "links": 3,
            "length": [0.1040, 0.1061, 0.1040],
            "mass": [0.0324, 0.0334, 0.0324],
        }
    ],
    "effects": {
        "weight": {},
        "linear_damping": {"b_l": TRUTH[FREE[0]]},
        "quadratic_damping": {"b_q": TRUTH[FREE[1]]},
        "joint_friction": {"dry": TRUTH[DRY], "axis": [0.0, 1.0, 0.0]},
    },
    "start": {"kind": "angles", "zero": "down", "polar": [1.2, 0.8, 0.3]},
}


def dry_dropper() -> Scene:
    """The lab dropper of scenario A with dry friction in all eight joints."""
    table = load_scene(SCENE).to_dict()
    table["effects"]["joint_friction"] = {"dry": TRUTH[DRY], "axis": [0.0, 1.0, 0.0]}
    return load_scene(table)


#: Steps of the truth in a frame of the camera: joined windows are so sharp that 40 of them, 1/2400 s, move `b_l` by
#: 0.37 of their standard errors; 80 move it by 0.07, 160 by 0.01.
SUBSTEPS = 160
#: Twins with dry friction: scene, duration [s], and steps of the truth in a frame.
DRY_TWINS = {"7 links": (dry_dropper, DURATION, 40), "3 links": (lambda: load_scene(DRY_SCENE), 12.0, SUBSTEPS)}


#: Draws of noise to which linear theory is applied where the fits are few.
DRAWS = 1000


class Twin:
    """Fits of many noisy copies of one truth, sharing one compiled simulator."""

    def __init__(self, free: tuple[str, ...] = FREE, scene=SCENE, duration: float = DURATION, substeps: int = SUBSTEPS):
        self.free = free
        self.scene = load_scene(scene)
        self.motion = simulate_truth(self.scene, duration, substeps=substeps)
        self.simulator = None
        self.truth = np.array([TRUTH[name] for name in free])

    def prepare(self, seed: int):
        """Everything ready for an estimator, on the noise of this seed."""
        trace = observe(self.motion, Camera(angle_noise=NOISE), seed)
        start = {name: START[name] for name in self.free}
        prepared = prepare(trace, self.scene, list(self.free), start=start, simulator=self.simulator)
        self.simulator = prepared.simulator
        return prepared

    def fit(self, seed: int, method: str, begin: FitResult | None = None):
        """The result of one method on one seed; `begin` is that of another method on the same seed to go on from."""
        prepared = self.prepare(seed)
        if begin is not None:
            at = zip(prepared.parameters, begin.values, strict=True)
            parameters = tuple(replace(p, value=float(v)) for p, v in at)
            prepared = replace(prepared, parameters=parameters, starts=begin.solution.starts)
        return summarise(prepared, method, estimate(prepared, method))


def statistics(twin: Twin, results: list) -> Found:
    """Errors over standard errors: RMS, mean in units of its own error, coverage, median relative standard errors."""
    values = np.array([r.values for r in results])
    errors = np.array([r.uncertainty.std_error for r in results])
    inside = [(r.uncertainty.low <= twin.truth) & (twin.truth <= r.uncertainty.high) for r in results]
    z = (values - twin.truth) / errors
    return {
        "parameters": list(twin.free),
        "converged": sum(r.status == "ok" for r in results),
        "fits": len(results),
        **_moments(z),
        "covered_90": np.mean(inside, axis=0).tolist(),
        "median_relative_std_error": np.median(errors / twin.truth, axis=0).tolist(),
        "z": z.round(3).tolist(),
        "substeps": [r.windows.substeps for r in results],
        "seconds_median": float(np.median([r.seconds["run"] for r in results])),
    }


def _moments(z: np.ndarray) -> Found:
    return {
        "z_rms": np.sqrt((z**2).mean(axis=0)).tolist(),
        "z_mean_in_its_error": (z.mean(axis=0) * np.sqrt(len(z))).tolist(),
        "covered_90": (np.abs(z) < 1.645).mean(axis=0).tolist(),
    }


def run_coverage(seeds: int) -> Found:
    """The statistics of both methods; those of the first 20 draws of noise are stored as well."""
    twin = Twin()
    fits = {"windows": [twin.fit(seed, "windows") for seed in range(seeds)]}
    fits["shooting"] = [twin.fit(seed, "shooting", fits["windows"][seed]) for seed in range(seeds)]
    store("calibration_twin", {method: statistics(twin, results[:20]) for method, results in fits.items()})
    return {method: statistics(twin, results) for method, results in fits.items()}


def run_dry(seeds: int, which: str) -> Found:
    """Three coefficients: Cramer and Rao's bound, then what the fits reach."""
    scene, duration, substeps = DRY_TWINS[which]
    twin = Twin((*FREE, DRY), scene(), duration, substeps)
    theory = linearise(twin)
    draws = np.array([theory["windows"].error(seed) for seed in range(DRAWS)])
    bounds = {method: own.std_error / twin.truth for method, own in theory.items()}
    mine: Found = {
        "cramer_rao_relative": {method: bound.tolist() for method, bound in bounds.items()},
        "linear_theory_of_windows": [{"draws": n, **_moments(draws[:n])} for n in (seeds, DRAWS)],
    }
    begun: list = [None] * seeds
    for method, bound in bounds.items():
        fits = []
        for seed in range(seeds):  # slow: every fit is stored
            fits.append(twin.fit(seed, method, begun[seed]))
            mine[method] = statistics(twin, fits)
            mine[f"{method}_over_bound"] = (np.array(mine[method]["median_relative_std_error"]) / bound).tolist()
            store("calibration_dry", {**stored("calibration_dry", {}), which: mine})
        begun = fits
    return stored("calibration_dry")


def run_bias(seeds: int) -> Found:
    """Is the mean error of the twin's fits chance or bias? Linear theory on the same draws of noise, and on more."""
    twin = Twin()
    fits = stored("calibration_coverage")
    found: Found = {"parameters": list(twin.free)}
    for method, theory in linearise(twin).items():
        z, mine = np.array([theory.error(seed) for seed in range(seeds)]), np.array(fits[method]["z"])
        same = z[: len(mine)]
        found[method] = {
            "cramer_rao_relative": (theory.std_error / twin.truth).tolist(),
            "error_without_noise_in_std_errors": theory.own.tolist(),
            "linear_theory": [{"draws": n, **_moments(z[:n])} for n in (20, len(mine), seeds)],
            "fits_less_linear_theory_in_std_errors": (mine - same).mean(axis=0).tolist(),
            "correlation_of_fits_with_theory": [float(np.corrcoef(same[:, i], mine[:, i])[0, 1]) for i in (0, 1)],
        }
    return found


class Theory(NamedTuple):
    """Linear theory of a method.

    Attributes:
        std_error: Cramer and Rao's bound (k,); of joined windows that of next to no gap, one run without interruption.
        own: error (k,) over it that the steps of fit and truth make without noise.
        error: error (k,) over it that the draw of noise of a seed makes, to first order.
    """

    std_error: np.ndarray
    own: np.ndarray
    error: Callable[[int], np.ndarray]


def linearise(twin: Twin) -> dict[str, Theory]:
    """The theory of both methods about the fits to angles without noise."""
    prepared = twin.prepare(0)
    simulator, m2 = prepared.simulator, prepared.simulator.freedoms

    def seen(noise: float, seed: int) -> tuple[Trace, Windows]:
        trace = observe(twin.motion, Camera(angle_noise=noise), seed)
        trace = trace.in_model_convention(trace.convention)
        return trace, cut([trace], prepared.windows.length, prepared.windows.dt, [np.full(trace.links, NOISE)])

    clean, windows = seen(0.0, 0)
    guess = first_starts(simulator.model_at(twin.truth), [clean], windows, prepared.sigma)
    problem = replace(prepared.problem(frozen=np.ones(len(twin.truth), bool)), windows=windows)
    found = fit_windows(problem, twin.truth, guess)
    jacobian = found.evaluation.jacobian.reshape(windows.count, -1, m2 + len(twin.truth))
    z, p = jacobian[..., :m2], jacobian[..., m2:]
    turn = np.swapaxes(z, 1, 2)
    slope = (p - z @ np.linalg.solve(turn @ z, turn @ p)).reshape(-1, len(twin.truth))
    covariance = np.linalg.inv(slope.T @ slope)
    error = np.sqrt(np.diag(covariance))
    gain = covariance @ slope.T / error[:, None]
    joined = fit_shooting(replace(found, problem=replace(problem, frozen=None)), continuity="tight")
    joined_error = np.sqrt(np.diag(np.linalg.inv(joined.information)))

    def draw(seed: int) -> np.ndarray:
        return (seen(NOISE, seed)[1].theta - windows.theta) * windows.weight

    def joined_draw(seed: int) -> np.ndarray:
        """What the draw adds to the step from the noise-free fit."""
        level, noise = level_of(joined.problem, joined.gap_weight), draw(seed)
        residuals = (joined.evaluation._replace(residual=-size * noise) for size in (1.0, 0.0))
        noisy, still = (level.undamped_step(e, joined.values, np.inf).dp for e in residuals)
        return (noisy - still) / joined_error

    own = -gain @ found.evaluation.residual.ravel()
    return {
        "windows": Theory(error, own, lambda seed: gain @ draw(seed).ravel()),
        "shooting": Theory(joined_error, (joined.values - twin.truth) / joined_error, joined_draw),
    }


#: Parts, and their usual number of draws of noise.
PARTS = {
    "coverage": (run_coverage, 60),
    "dry": (lambda seeds: run_dry(seeds, "7 links"), 20),
    "dry-small": (lambda seeds: run_dry(seeds, "3 links"), 20),
    "bias": (run_bias, DRAWS),
}


@command({"part": tuple(PARTS)}, seeds=0)
def main(args):
    run, usual = PARTS[args.part]
    found = run(args.seeds or usual)
    store(f"calibration_{args.part.removesuffix('-small')}", found)
    say(found)
