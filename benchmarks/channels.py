"""Fits to channels against known truth of other schemes and other programs: whether intervals cover.

    python benchmarks/channels.py [sea] [cable] [runs] [cameras] [--draws N]

Writes `benchmarks/results/channels.json`. A row per case and parameter: how many of the draws' 90 % intervals hold the
truth, the root mean square of error over standard error, the median standard error as a share of the truth. Noise is
drawn anew for every draw, on one truth; what is known beforehand (the current) is drawn anew too.

sea      a longline of ropes with two droppers, 600 s at 10 Hz; tension at both anchors (noise 1 %), depth of floats
         and middle (0.02 m), current known to 2 %; drag and EA started two times off. Truth by a finer step of another
         scheme. Taut, where tension feels EA; slack, where depths feel it; stiff, where nothing does. The first draw is
         fitted by whole runs, all of them in the linear model where that ended.
cable    a hanging cable with bending stiffness between two ends that move; nodes in space, 3 mm; truth by SciPy's
         DOP853 on equations of motion written here. Stiff, with markers on every node as far apart as the bending
         length sqrt(EI/T), and limp, a sixth of it, with one marker.
runs     five releases of a hanging chain whose damping differs by 5 % from run to run; truth by SciPy.
cameras  the same chain kicked out of its plane at 0.15 m/s, in two cameras, the second's delay and rate free.
"""

import dataclasses
import time
from collections.abc import Mapping, Sequence

import numpy as np
from channel_truths import CABLE, CHAIN, LONGLINES, cable_scene, cable_truth, chain_scene, chain_truth, longline, shaken
from scipy.interpolate import CubicSpline
from study import Found, command, describe, say, store, stored

import dropper_jax as dj
from fitting import ChannelFit, fit_channels
from fitting.channels.fit import first_point, pose, settle_noise
from fitting.channels.problem import Evaluation, Problem
from fitting.channels.result import errors_of
from fitting.channels.sensors import projection
from fitting.estimate.problem import Solution


class Tally:
    """Estimates, errors, intervals and verdicts of draws, by parameter."""

    def __init__(self, truth: Mapping[str, float]) -> None:
        self.truth = dict(truth)
        self.rows: dict[str, list[tuple]] = {name: [] for name in truth}
        self.failed = 0
        self.begun = time.perf_counter()

    def add(self, found, silent: bool = False) -> None:
        """One fit, printed unless `silent`."""
        e = found.errors
        each = zip(found.values, e.std_error, e.low, e.high, e.determined, strict=True)
        own = dict(zip((p.name for p in found.parameters), each, strict=True))
        if not silent:
            off = {name: round(float((own[name][0] - v) / own[name][1]), 2) for name, v in self.truth.items()}
            say({"status": found.outcome, "seconds": round(found.seconds, 1), "off": off, "warnings": found.warnings})
        if found.status != "ok":
            self.failed += 1
            return
        for name, rows in self.rows.items():
            rows.append(own[name])

    def table(self, **more) -> Found:
        """The rows of the result."""
        table = {name: judge(self.truth[name], rows) for name, rows in self.rows.items() if rows}
        draws = len(next(iter(self.rows.values())))
        spent = time.perf_counter() - self.begun
        return {"draws": draws, "not_converged": self.failed, "seconds": round(spent, 1), **more, "parameters": table}


def judge(truth: float, rows: list[tuple]) -> Found:
    """A parameter's estimates, standard errors, ends of intervals and verdicts against its truth."""
    *numbers, verdicts = zip(*rows, strict=True)
    v, s, low, high = np.array(numbers, float)
    return {
        "truth": truth,
        "cover": int(np.sum((low <= truth) & (truth <= high))),
        "rms_of_error_over_std_error": float(np.sqrt(np.mean(((v - truth) / s) ** 2))),
        "mean_of_error_over_std_error": float(np.mean((v - truth) / s)),
        "median_std_error": float(np.median(s)),
        "median_relative_error": float(np.median(s) / abs(truth)) if truth else None,
        "not_determined": verdicts.count("no"),
        "upper_bound": verdicts.count("upper bound"),
    }


def sea(draws: int) -> Found:
    """The longline, taut, slack, and of stiff rope."""
    return {kind: _sea(kind, draws) for kind in LONGLINES}


#: What is free, and what is known to 2 %.
STIFFNESS, DRAG, CURRENT = "line_type.rope.EA", "line_type.sock.cdn", "sea.current.speed"


def _sea(kind: str, draws: int) -> Found:
    scene = longline(kind)
    *_, (step, scheme), off = LONGLINES[kind]
    true = dj.simulate(scene, integrator=scheme, dt=step, save_every=round(0.02 / step))
    assert true.status == "ok", true.failure
    t = np.arange(30.0, 600.0, 0.1)
    last = next(s for s in true.lines if s.name == "east-leg").links.stop - 1
    clean = {
        "west": CubicSpline(true.t_tension, true.tension[:, 0])(t),
        "east": CubicSpline(true.t_tension, true.tension[:, last])(t),
        **{p: CubicSpline(true.t, -true.point_path(p)[:, 2])(t) for p in ("w", "m", "e")},
    }
    noise = {"west": 0.01 * clean["west"], "east": 0.01 * clean["east"], "w": 0.02, "m": 0.02, "e": 0.02}
    place = dj.load_scene(scene)
    truth = {name: place.value(name) for name in (STIFFNESS, DRAG, CURRENT)}
    rng, whole, linear = np.random.default_rng(1), Tally(truth), Tally(truth)

    def drawn() -> tuple[Found, Found]:
        """Noisy data, and what a fit is given: starts two times off, and the current as it is known."""
        noisy = {name: y + noise[name] * rng.normal(size=len(t)) for name, y in clean.items()}
        known = truth[CURRENT] * (1 + 0.02 * rng.normal())
        start = {STIFFNESS: off * truth[STIFFNESS], DRAG: 0.5 * truth[DRAG], CURRENT: known}
        return _sea_data({"t": t, **noisy}), {"start": start, "priors": {CURRENT: (known, 0.02 * truth[CURRENT])}}

    every = [drawn() for _ in range(draws)]
    data, given = every[0]
    # the first one by runs of its own; all draws in the linear model where it ends
    first = fit_channels(data, scene, list(truth), check_step=kind != "slack", **given)
    whole.add(first)
    again = [_in_line(first, data, place, given) for data, given in every]
    for found in again:
        linear.add(found, silent=True)
    names = [p.name for p in first.parameters]
    table = linear.table(
        sensitivity=dict(zip(names, first.errors.sensitivity.tolist(), strict=True)),
        step_s=first.solution.problem.dt,
        step_bias=None if first.step_bias is None else dict(zip(names, first.step_bias.tolist(), strict=True)),
        said=list(first.errors.why),
        linear_from_whole_std_errors=[float(np.max(np.abs(again[0].values - first.values) / first.errors.std_error))],
    )
    return {**table, "whole": whole.table()}


def _sea_data(columns: dict[str, np.ndarray]) -> Found:
    tension = {"kind": "tension", "unit": "N", "noise": 1.0, "noise_unit": "%"}
    depth = {"kind": "depth", "unit": "m"}
    return {
        "run": [{"file": columns}],
        "channel": [
            *({"name": f"anchor {p}", "column": p, "point": p, **tension} for p in ("west", "east")),
            *({"name": f"depth {p}", "column": p, "point": p, **depth} for p in ("w", "m", "e")),
        ],
    }


@dataclasses.dataclass(frozen=True)
class InLine(Problem):
    """A problem whose motion is the linear one where a fit ended; noise, priors, errors are those of the fit."""

    there: Solution | None = None

    def evaluate(self, values: np.ndarray, starts=None) -> Evaluation:
        ahead = self.there.evaluation
        move = values - self.there.values
        shown = (
            tuple(y + x @ move for y, x in zip(*run, strict=True))
            for run in zip(ahead.shown, ahead.slopes, strict=True)
        )
        return self.whiten_residuals(ahead._replace(shown=tuple(shown)))


def _in_line(first, data: Found, scene, given: Found):
    problem = pose(data, scene, list(given["start"]), [], given["start"], {}, given["priors"])
    fields = {f.name: getattr(problem, f.name) for f in dataclasses.fields(problem)}
    problem = InLine(**fields, there=first.solution)
    point = settle_noise(first_point(problem), 40)
    return ChannelFit(scene=scene, solution=point, uncertainty=errors_of(point))


def cable(draws: int) -> Found:
    """The hanging cable, as stiff as markers on every node can see, and limp with one marker."""
    return {
        "stiff": _cable(1e-3, range(1, CABLE["links"]), draws),
        "limp": _cable(3e-5, (CABLE["links"] // 2,), draws),
    }


def _cable(stiffness: float, markers: Sequence[int], draws: int) -> Found:
    t = np.arange(0.0, 6.0, 1 / 30)
    fine = np.arange(0.0, 6.3, 0.01)
    true = cable_truth(t, stiffness)
    places = {"low": np.zeros(3), "high": np.array([CABLE["span"], 0.0, 0.1])}
    moved = {name: np.array([shaken(place, i)(x)[:3] for x in fine]) for i, (name, place) in enumerate(places.items())}
    ends = {f"{name}_{axis}": 1e3 * path[:, i] for name, path in moved.items() for i, axis in enumerate("xyz")}
    marker = {"kind": "position", "unit": "mm", "noise": NOISE_3D}
    shown = {
        "channel": [
            {"name": f"marker {j}", "columns": [f"{axis}{j}" for axis in "xyz"], "node": j, **marker} for j in markers
        ],
        "motion": [{"point": p, "columns": [f"{p}_{axis}" for axis in "xyz"], "unit": "mm"} for p in places],
    }
    truth = {"effects.bending.EI": stiffness, "effects.linear_damping.b_l": CABLE["b_l"]}
    rng, tally = np.random.default_rng(2), Tally(truth)
    for _ in range(draws):
        seen = 1e3 * true + NOISE_3D * rng.normal(size=true.shape)
        columns = {f"{axis}{j}": seen[:, j, i] for j in markers for i, axis in enumerate("xyz")}
        data = {"run": [{"file": [{"t": t, **columns}, {"t": fine, **ends}]}], **shown}
        found = fit_channels(data, cable_scene(stiffness), list(truth))
        tally.add(found)
    return tally.table(step_bias=found.step_bias.tolist())


#: Noise of markers in space [mm], of angles [rad], of places in pictures [px].
NOISE_3D, NOISE_ANGLE, NOISE_PIXEL = 3.0, 3e-3, 0.7


def runs(draws: int) -> Found:
    """Five releases whose damping differs."""
    mean, spread, count = CHAIN["b_l"], 0.05, 5
    path, pose = "effects.linear_damping.b_l", np.array([0.5, 0.4, 0.3])
    rng, tally, spreads = np.random.default_rng(3), Tally({path: mean}), []
    t = np.arange(0.0, 8.0, 1 / 30)
    angle = {"kind": "angle", "unit": "rad", "zero": "down"}
    channels = [{"name": f"link {j}", "column": f"theta_{j}", "link": j, **angle} for j in (1, 2, 3)]

    def release(number: int) -> Found:
        scene = chain_scene(pose * (1 - 0.1 * number))
        d = np.diff(chain_truth(t, scene, mean * (1 + spread * rng.normal()), CHAIN["b_q"]), axis=1)
        angles = np.arctan2(d[..., 0], -d[..., 2]) + NOISE_ANGLE * rng.normal(size=d.shape[:2])
        columns = {"t": t, **{f"theta_{j + 1}": angles[:, j] for j in range(3)}}
        own = {"start.positions": scene["start"]["positions"]}
        return {"file": columns, "name": f"release {number + 1}", "scene": own}

    for _ in range(draws):
        data = {"run": [release(number) for number in range(count)], "channel": channels}
        found = fit_channels(data, chain_scene(pose), ["b_q"], own=["b_l"], check_step=False)
        b = found.between[0]
        tally.rows[path].append((b.mean, b.std_error, b.low, b.high, "yes"))
        tally.failed += found.status != "ok"
        spreads.append(b.spread / mean)
        say({"status": found.outcome, "off": round((b.mean - mean) / b.std_error, 2)})
    return tally.table(spread_between_runs={"truth": spread, "median": float(np.median(spreads))})


def cameras(draws: int) -> Found:
    """The kicked chain in two cameras that are not started together."""
    delay, rate, kick = 0.013, 59.94 / 60.0, 0.15
    scene = chain_scene(np.array([0.5, 0.4, 0.3]), kick)
    stamps = np.arange(1.0, 480.0) / 60.0
    spec = {"look_at": [0.0, 0.0, -0.45], "focal": 1400.0, "centre": [960.0, 540.0]}
    # place and times of each camera
    views = {"left": ([0.4, -2.0, -0.4], stamps), "right": ([2.0, -0.5, -0.3], rate * stamps - delay)}

    def picture(place: list[float], when: np.ndarray) -> np.ndarray:
        """Places (times, 4, 2) [px] of the nodes."""
        nodes = chain_truth(np.concatenate([[0.0], when]), scene, CHAIN["b_l"], CHAIN["b_q"])[1:]
        matrix = projection(np.array(place), np.array(spec["look_at"]), spec["focal"], np.array(spec["centre"]))
        seen = nodes @ matrix[:, :3].T + matrix[:, 3]
        return seen[..., :2] / seen[..., 2:]

    clean = {name: picture(*view) for name, view in views.items()}
    pixel = {"kind": "pixel", "unit": "px"}
    shown = {
        "channel": [
            {"name": f"{c} node {j}", "camera": c, "node": j, "columns": [f"{c}_u{j}", f"{c}_v{j}"], **pixel}
            for c in views
            for j in (1, 2, 3)
        ],
        "camera": [{"name": name, "position": place, **spec} for name, (place, _) in views.items()],
    }
    truth = {
        "effects.linear_damping.b_l": CHAIN["b_l"],
        "effects.quadratic_damping.b_q": CHAIN["b_q"],
        "start.velocities.3.1": kick,
        "camera.right.delay": delay,
        "camera.right.rate": rate,
    }
    rng, tally = np.random.default_rng(4), Tally(truth)
    for _ in range(draws):
        noisy = {name: places + NOISE_PIXEL * rng.normal(size=places.shape) for name, places in clean.items()}
        files = [
            {"t": stamps, **{f"{name}_{axis}{j}": x[:, j, i] for j in (1, 2, 3) for i, axis in enumerate("uv")}}
            for name, x in noisy.items()
        ]
        data = {"run": [{"file": files}], **shown}
        tally.add(fit_channels(data, scene, list(truth), start={"start.velocities.3.1": 0.0}))
    return tally.table()


CASES = {"sea": sea, "cable": cable, "runs": runs, "cameras": cameras}


@command({"cases": list(CASES)}, draws=100)
def main(given):
    kept = stored("channels", {})
    for name in given.cases:
        kept[name] = CASES[name](given.draws)
        store("channels", {**kept, "machine": describe()})
        say({name: kept[name]})
