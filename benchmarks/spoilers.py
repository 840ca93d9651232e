"""What spoils a fit, on truth that SciPy integrates: is it named, and do the errors hold once it is freed?

    python benchmarks/spoilers.py [--draws 20] [--only lengths roll ...] [--out FILE]

A chain of four links between two held ends hangs still for 1.5 s, is moved by hand, which is not seen, let go and
watched for 12 s at 60 Hz with noise of 4 mrad (`closed_chain`). Every draw has a release pose, noise and a spoiler of
its own. Each trace is fitted from damping that is twice off with `--auto-free --rest 0:1.9`; nothing else is told.
Written are the first name given, the 90 % intervals of b_l and b_q, and their standard errors against the Cramer-Rao
bound of the model with the true spoiler free, of one uninterrupted run with the true noise. Writes
results/spoilers.json.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from closed_chain import Chain
from scipy.interpolate import CubicSpline
from study import RESULTS, Found, command, say, store, timed

from fitting import Convention, FitSettings, Trace, prepare
from fitting.calibration.candidate import omitted_parameter_bias
from fitting.calibration.free_by_advice import free_by_advice
from fitting.calibration.possible_faults import candidate_simulator, with_freed
from fitting.calibration.summarise import summarise
from fitting.estimate.noise import Noise
from fitting.estimate.objective import objective_at
from fitting.estimate.residual_noise import ResidualNoiseModel
from fitting.estimate.simulator import Simulator
from fitting.windows.method import estimate
from fitting.windows.prepared import Prepared
from fitting.windows.sound_windows import with_sound_windows

LENGTH = np.array([0.15, 0.14, 0.16, 0.15])
MASS = np.array([0.05, 0.06, 0.05, 0.05])
END = np.array([0.38, 0.0])
LINEAR = 4e-3
QUADRATIC = 4e-3
RATE = 60.0
REST = 1.5
BEGIN = 2.0
DURATION = 12.0
NOISE = 0.004
FREE = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]
TRUTH = np.array([LINEAR, QUADRATIC])
SETTINGS = FitSettings(window=1.5, rest=((0.0, BEGIN - 0.1),))  # eight windows are one program's
POLAR = np.array([1.3, -0.2, 0.2, -0.9])
#: Gap weight at which joined windows are one run.
CLOSED = 1e-6


@dataclass(frozen=True)
class Draw:
    """What a rig and its camera really are, what would have to be free, and its name."""

    length: np.ndarray = field(default_factory=lambda: LENGTH)
    rate: float = 1.0
    turn: np.ndarray = field(default_factory=lambda: np.zeros(4))
    node: tuple[int, np.ndarray] | None = None
    lost: int | None = None
    outliers: float = 0.0
    jitter: float = 0.0
    kept: float = 0.0
    free: tuple[str, ...] = ()
    name: str = ""


def lengths(rng: np.random.Generator) -> Found:
    length = LENGTH * (1 + 0.01 * rng.standard_normal(4))
    return {"length": length, "free": ("line.0.length",), "name": "lengths of links"}


def roll(rng: np.random.Generator) -> Found:
    turn = np.full(4, np.deg2rad(2.0) * _share(rng))
    return {"turn": turn, "free": ("camera.offset",), "name": "roll of the camera"}


def rate(rng: np.random.Generator) -> Found:
    return {"rate": 1 + 0.005 * _share(rng), "free": ("clock.rate",), "name": "rate of the clock"}


def lost_frames(rng: np.random.Generator) -> Found:
    lost = int(rng.integers(round(0.15 * DURATION * RATE), round(0.9 * DURATION * RATE)))
    # counted from the first frame at rest on
    return {"lost": lost, "free": (f"clock.lost.0.{round(REST * RATE) + lost}",), "name": "lost frames"}


def marker_of_a_link(rng: np.random.Generator) -> Found:
    link = int(rng.integers(4))
    turn = np.deg2rad(1.0) * _share(rng) * np.eye(4)[link]
    return {"turn": turn, "free": (f"marker.offset.{link}",), "name": f"marker of link {link + 1}"}


def marker_of_a_node(rng: np.random.Generator) -> Found:
    node = int(rng.integers(1, 4))
    way = rng.uniform(0, 2 * np.pi)
    beside = 3e-3 * abs(_share(rng)) * np.array([np.cos(way), np.sin(way)])
    return {"node": (node, beside), "free": (f"marker.node.{node}",), "name": f"marker of node {node}"}


def lengths_and_roll(rng: np.random.Generator) -> Found:
    both = (lengths(rng), roll(rng))
    named = {"free": ("line.0.length", "camera.offset"), "name": "lengths of links and roll of the camera"}
    return {**both[0], **both[1], **named}


#: Systematic errors: values of a draw, or a function of a generator that draws them.
SPOILERS: dict[str, Found | Callable[[np.random.Generator], Found]] = {
    "clean": {}, "lengths": lengths, "roll": roll, "rate": rate, "lost frames": lost_frames,
    "marker of a link": marker_of_a_link, "marker of a node": marker_of_a_node,
    "outliers": {"outliers": 0.01, "name": "outliers"}, "jitter": {"jitter": 0.004, "name": "jitter"},
    "AR(1)": {"kept": 0.9, "name": "correlated"}, "lengths and roll": lengths_and_roll,
}  # fmt: skip


def _share(rng: np.random.Generator) -> float:
    """Of the size of a spoiler, either way."""
    return float(rng.choice([-1, 1]) * rng.uniform(0.8, 1.2))


def draw(kind: str, number: int) -> tuple[Draw, Trace]:
    """A spoiled rig and what its camera told."""
    rng = np.random.default_rng([list(SPOILERS).index(kind), number])
    spoiler = SPOILERS[kind]
    d = Draw(**(spoiler(rng) if callable(spoiler) else spoiler))
    chain = Chain(d.length, MASS[:-1], END, LINEAR, QUADRATIC)
    polar = POLAR + np.array([*rng.uniform(-0.25, 0.25, 2), 0.0, 0.0])
    missing = 0 if d.lost is None else 12
    frame = np.arange(round(DURATION * RATE))
    resting = np.arange(round(REST * RATE))
    fine = np.arange(-4, 4 * (len(frame) + missing) + 8) / (4 * RATE) * max(d.rate, 1.0)
    t = np.r_[0.0, fine[fine > 0]]
    spline = CubicSpline(t, chain.angles(chain.swing(polar, t)))
    seen = (frame + missing * (frame >= (d.lost or 0))) / RATE * d.rate
    theta = spline(np.maximum(seen + d.jitter * rng.standard_normal(len(frame)), 0.0))
    still = np.repeat(chain.angles(chain.hanging(POLAR)[None]), len(resting), axis=0)
    theta = _seen(d, np.concatenate([still, theta])) + d.turn
    e = rng.standard_normal(theta.shape)
    for i in range(1, len(e)):
        e[i] = d.kept * e[i - 1] + np.sqrt(1 - d.kept**2) * e[i]
    off = rng.random(theta.shape) < d.outliers
    theta = theta + NOISE * e + np.where(off, rng.choice([-1, 1], off.shape) * rng.uniform(0.05, 0.3, off.shape), 0.0)
    t = np.concatenate([resting / RATE, BEGIN + frame / RATE])
    return d, Trace("film", t, theta, convention=Convention("horizontal", 1, "rad"))


def _seen(d: Draw, theta: np.ndarray) -> np.ndarray:
    """Angles (k, 4) between the markers of nodes, one of which is glued beside its node to the link before it."""
    if d.node is None:
        return theta
    node, beside = d.node
    link = d.length[:, None] * np.stack([np.cos(theta), -np.sin(theta)], axis=-1)
    along = np.stack([np.cos(theta[:, node - 1]), -np.sin(theta[:, node - 1])], axis=-1)
    across = np.stack([-np.sin(theta[:, node - 1]), -np.cos(theta[:, node - 1])], axis=-1)
    moved = beside[0] * along + beside[1] * across
    link[:, node - 1] += moved
    link[:, node] -= moved
    return np.unwrap(np.arctan2(-link[..., 1], link[..., 0]), axis=0)


def scene() -> Found:
    """What the researcher believes, with damping twice off."""
    return {
        "run": {"dt": 1 / RATE, "duration": DURATION},
        "point": [
            {"name": "left", "position": [0.0, 0.0, 0.0]},
            {"name": "right", "position": [float(END[0]), 0.0, float(END[1])]},
        ],
        "line": [
            {
                "name": "chain",
                "from": "left",
                "to": "right",
                "links": 4,
                "length": LENGTH.tolist(),
                "mass": MASS.tolist(),
            }
        ],
        "effects": {"weight": {}, "linear_damping": {"b_l": 2 * LINEAR}, "quadratic_damping": {"b_q": 2 * QUADRATIC}},
        "start": {"kind": "static"},
        # the place is known, and the gap to 0.1 mm: time, gravity and size could not be told apart without
        "fit": {
            "prior": [
                {"of": "effects.weight.gravity", "sigma": 0.01, "unit": "%"},
                {"of": "rig.scale", "sigma": 0.03, "unit": "%"},
            ]
        },
    }


def bound(prepared: Prepared, d: Draw, simulator: Simulator) -> np.ndarray:
    """Standard errors of b_l and b_q by the Cramer-Rao bound of the true model, its windows joined to one run."""
    true = with_freed(replace(prepared, noise=None), d.free, simulator, 0.2 if d.lost is not None else None)
    true = replace(true, begin=np.concatenate([TRUTH, true.values[2:]]))
    solution = estimate(true, "windows")
    decay = -np.log(d.kept) * RATE if d.kept else np.inf
    claimed = np.array(prepared.sigma)
    noise = Noise(NOISE / claimed, np.full(claimed.shape, decay), np.array([d.jitter]))
    point = ResidualNoiseModel(solution, prepared.claimed_windows(solution), prepared.traces, prepared.floor).at(noise)
    step = objective_at(point.problem, CLOSED).undamped_step(point.evaluation, point.values, np.inf)
    try:
        return np.sqrt(np.diag(np.linalg.inv(step.information)))[:2]
    except np.linalg.LinAlgError:  # the model with the true error did not fit: no bound
        return np.full(2, np.nan)


def one(kind: str, number: int, shared: list[Simulator]) -> Found:
    """One trace, fitted."""
    d, trace = draw(kind, number)
    prepared = prepare(trace, scene(), FREE, settings=SETTINGS, simulator=shared[0] if shared else None)
    shared[:] = shared or [candidate_simulator(prepared)]
    # as `fit` does first
    prepared = with_sound_windows(with_freed(prepared, [], shared[0]), keep_jumps=True)
    at = free_by_advice(prepared, estimate, "shooting", simulator=shared[0])
    solution = at.solution
    known = replace(solution.problem.known, doubt=omitted_parameter_bias(at.freed, solution.problem.parameters))
    solution.problem = replace(solution.problem, known=known)
    result = summarise(at.prepared, "shooting", solution)
    u = result.uncertainty
    if solution.problem.noise is None:
        kind_of_noise = "white"
    else:
        kind_of_noise = solution.problem.noise.kind
    names = [candidate.name for candidate in at.freed]
    first = next(iter([*([] if kind_of_noise == "white" else [kind_of_noise]), *names]), "")
    return {
        "spoiler": kind, "draw": number, "truth": d.name, "first": first, "names": names, "noise": kind_of_noise,
        "status": result.status, "values": solution.values[:2].tolist(), "std_error": u.std_error[:2].tolist(),
        "low": u.low[:2].tolist(), "high": u.high[:2].tolist(), "bound": bound(prepared, d, shared[0]).tolist(),
        "gap_weight": solution.gap_weight, "gains": [c.gain for c in at.freed],
        "law": result.laws.wrong.name if result.laws.wrong else "",
        "least_p": min((test.p for test in result.laws.tests), default=1.0),
    }  # fmt: skip


@command(draws=20, first=0, only=list(SPOILERS), out=RESULTS / "spoilers.json")
def main(args) -> None:
    shared: list[Simulator] = []
    rows: list[Found] = []
    for number in range(args.first, args.first + args.draws):
        for kind in args.only:
            row, seconds = timed(lambda kind=kind, number=number: one(kind, number, shared))
            rows.append({**row, "seconds": seconds["processor_s"]})
            say(rows[-1])
            store(args.out, rows)
