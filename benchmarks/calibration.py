"""Twin experiments: does the calibration find the truth, and do its errors mean what they say?

The truth is the lab dropper of scenario A with b_l = 0.002 and b_q = 0.001, integrated by energy_momentum at
1/9600 s (the fit runs rattle_4 at 1/120 s), seen at 60 Hz for 48 s with 0.005 rad of noise. Fits start at (0.02, 0.02).

    python benchmarks/calibration.py coverage|dry|dry-small|bias [--seeds N]
"""

from dataclasses import dataclass, replace

import numpy as np
from study import command, say, store, stored

from dropper_jax import Scene, load_scene
from fitting import FitResult, prepare
from fitting.calibration.fit import estimate, summarise
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import fit_shooting, level_of
from fitting.estimate.windows import Windows, cut, first_starts
from fitting.traces.synthetic import Camera, observe, simulate_truth

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


def statistics(twin: Twin, results: list) -> dict:
    """Errors over standard errors: RMS, mean in units of its own error, coverage, median relative standard errors."""
    values = np.array([r.values for r in results])
    errors = np.array([r.uncertainty.std_error for r in results])
    z = (values - twin.truth) / errors
    inside = [(r.uncertainty.low <= twin.truth) & (twin.truth <= r.uncertainty.high) for r in results]
    return {
        "parameters": list(twin.free),
        "converged": sum(r.status == "ok" for r in results),
        "fits": len(results),
        "z_rms": np.sqrt((z**2).mean(0)).tolist(),
        "z_mean_in_its_error": (z.mean(0) * np.sqrt(len(z))).tolist(),
        "covered_90": np.mean(inside, axis=0).tolist(),
        "median_relative_std_error": np.median(errors / twin.truth, axis=0).tolist(),
        "z": z.round(3).tolist(),
        "gap_weights": [r.solution.gap_weight for r in results],
        "substeps": [r.windows.substeps for r in results],
        "largest_step_bias": [float(np.abs(r.solution.step_bias).max()) if r.status == "ok" else None for r in results],
        "seconds_median": float(np.median([r.seconds["run"] for r in results])),
    }


def run_coverage(seeds: int) -> dict:
    """The statistics of both methods; those of the first 20 draws of noise are stored as well."""
    twin = Twin()
    fits = {"windows": [twin.fit(seed, "windows") for seed in range(seeds)]}
    fits["shooting"] = [twin.fit(seed, "shooting", fits["windows"][seed]) for seed in range(seeds)]
    store("calibration_twin", {method: statistics(twin, results[:20]) for method, results in fits.items()})
    return {method: statistics(twin, results) for method, results in fits.items()}


def run_dry(seeds: int, which: str) -> dict:
    """Three coefficients: Cramer and Rao's bound, then what the fits reach."""
    scene, duration, substeps = DRY_TWINS[which]
    twin = Twin((*FREE, DRY), scene(), duration, substeps)
    theory = linearise(twin, NOISE)
    bounds = {"windows": theory.std_error / twin.truth, "shooting": theory.joined_std_error / twin.truth}
    draws = np.array([theory.z(seed) for seed in range(DRAWS)])
    mine = {
        "cramer_rao_relative": {method: bound.tolist() for method, bound in bounds.items()},
        "linear_theory_of_windows": [{"draws": n, **_moments(draws[:n])} for n in (seeds, DRAWS)],
    }
    fits = {method: [] for method in bounds}
    for method, bound in bounds.items():
        for seed in range(seeds):  # slow: every fit is stored
            fits[method].append(twin.fit(seed, method, fits["windows"][seed] if method == "shooting" else None))
            mine[method] = statistics(twin, fits[method])
            mine[f"{method}_over_bound"] = (np.array(mine[method]["median_relative_std_error"]) / bound).tolist()
            found = {**stored("calibration_dry", {}), which: mine}
            store("calibration_dry", found)
    return found


def run_bias(seeds: int) -> dict:
    """Is the mean error of the twin's fits chance or bias? Linear theory on the same draws of noise, and on more."""
    twin = Twin()
    theory = linearise(twin, NOISE)
    fits = stored("calibration_coverage")
    found = {
        "parameters": list(twin.free),
        "cramer_rao_relative": (theory.std_error / twin.truth).tolist(),
        "cramer_rao_relative_joined": (theory.joined_std_error / twin.truth).tolist(),
    }
    own = {"windows": theory.own, "shooting": theory.joined_own}
    for method, error in (("windows", theory.z), ("shooting", theory.joined_z)):
        z, mine = np.array([error(seed) for seed in range(seeds)]), np.array(fits[method]["z"])
        same = z[: len(mine)]
        found[method] = {
            "error_without_noise_in_std_errors": own[method].tolist(),
            "linear_theory": [{"draws": n, **_moments(z[:n])} for n in (20, len(mine), seeds)],
            "fits_less_linear_theory_in_std_errors": (mine - same).mean(axis=0).tolist(),
            "correlation_of_fits_with_theory": [float(np.corrcoef(same[:, i], mine[:, i])[0, 1]) for i in (0, 1)],
        }
    return found


def _moments(z: np.ndarray) -> dict:
    return {
        "z_rms": np.sqrt((z**2).mean(axis=0)).tolist(),
        "z_mean_in_its_error": (z.mean(axis=0) * np.sqrt(len(z))).tolist(),
        "covered_90": (np.abs(z) < 1.645).mean(axis=0).tolist(),
    }


@dataclass(frozen=True)
class Linear:
    """Linear theory of the `windows` estimator on one twin.

    Attributes:
        slope: P' (rows, k) [1/parameter].
        covariance: C (k, k).
        std_error: Cramer and Rao's bound (k,), and `joined_std_error` of windows joined with next to no gap, one run
            that is never interrupted.
        windows: of the noise-free angles.
        own: error (k,) in standard errors that the simulator's step makes without noise; `joined_own` that of the
            fit to joined windows, the steps of fit and truth.
        found: the fit without noise, joined.
    """

    twin: Twin
    noise: float
    slope: np.ndarray
    covariance: np.ndarray
    std_error: np.ndarray
    windows: Windows
    own: np.ndarray
    joined_std_error: np.ndarray
    joined_own: np.ndarray
    found: Solution

    def z(self, seed: int) -> np.ndarray:
        """Error over standard error (k,) that this draw of noise makes, to first order."""
        return self.covariance @ (self.slope.T @ self._draw(seed).ravel()) / self.std_error

    def joined_z(self, seed: int) -> np.ndarray:
        """The same (k,) for joined windows: what the draw adds to their step from the noise-free fit."""
        noisy, still = (self._joined_step(size * self._draw(seed)) for size in (1.0, 0.0))
        return (noisy - still) / self.joined_std_error

    def _draw(self, seed: int) -> np.ndarray:
        noisy = _windows(self.twin, self.noise, seed, self.windows.length, self.windows.dt)
        return (noisy.theta - self.windows.theta) * self.windows.weight

    def _joined_step(self, draw: np.ndarray) -> np.ndarray:
        level = level_of(self.found.problem, self.found.gap_weight)
        evaluation = self.found.evaluation._replace(residual=-draw)
        return level.undamped_step(evaluation, self.found.values, np.inf).dp


def linearise(twin, noise: float) -> Linear:
    """The theory of a twin of calibration.py with white noise [rad]."""
    prepared = twin.prepare(0)
    simulator, m2 = prepared.simulator, prepared.simulator.freedoms
    windows = _windows(twin, 0.0, 0, prepared.windows.length, prepared.windows.dt, weight=noise)
    clean = _trace(twin, 0.0, 0)
    guess = first_starts(simulator.model_at(twin.truth), [clean], windows, prepared.sigma)
    problem = replace(prepared.problem(frozen=np.ones(len(twin.truth), bool)), windows=windows)
    found = fit_windows(problem, twin.truth, guess)
    evaluation = found.evaluation
    jacobian = evaluation.jacobian.reshape(windows.count, -1, m2 + len(twin.truth))
    z, p = jacobian[..., :m2], jacobian[..., m2:]
    turn = np.swapaxes(z, 1, 2)
    slope = (p - z @ np.linalg.solve(turn @ z, turn @ p)).reshape(-1, len(twin.truth))
    covariance = np.linalg.inv(slope.T @ slope)
    error = np.sqrt(np.diag(covariance))
    own = -covariance @ (slope.T @ evaluation.residual.ravel()) / error
    joined = fit_shooting(replace(found, problem=replace(problem, frozen=None)), continuity="tight")
    joined_error = np.sqrt(np.diag(np.linalg.inv(joined.information)))
    joined_own = (joined.values - twin.truth) / joined_error
    return Linear(twin, noise, slope, covariance, error, windows, own, joined_error, joined_own, joined)


def _trace(twin, noise: float, seed: int):
    trace = observe(twin.motion, Camera(angle_noise=noise), seed)
    return trace.in_model_convention(trace.convention)


def _windows(twin, noise: float, seed: int, length: float, dt: float, weight: float | None = None) -> Windows:
    trace = _trace(twin, noise, seed)
    return cut([trace], length, dt, [np.full(trace.links, noise if weight is None else weight)])


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
