"""Is a wrong damping law reported, and a right one not? On truth that SciPy integrates, without this project's code.

    python benchmarks/wrong_laws.py [--seeds 0:48] [--every] [--out FILE]

A draw is a chain of 2 to 5 links that hangs from a hook, or between two, with both kinds of drag. Seen with white
noise, it is fitted twice from drag that is five times off: without a fault, and with one of `FAULTS` that the scene
does not have; with `--every`, with each fault in turn. The size of a fault is 8 to 300 times the standard error that
the fit of the right trace gives it, which is close to the Cramer-Rao bound, and at most `MOST`. Written are status, the
law that is named, and the errors of b_l and b_q in standard errors and relative to the truth. Writes
results/wrong_laws.json.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.integrate import solve_ivp
from study import RESULTS, Found, collect, command, seeds_of, timed

from dropper_jax import SceneError
from fitting import Convention, FitResult, Trace, prepare
from fitting.calibration.summarise import summarise
from fitting.estimate.simulator import Simulator
from fitting.windows.method import estimate
from fitting.windows.sound_windows import with_sound_windows

GRAVITY = 9.81
#: Rate [rad/s] within which the dry friction of the truth turns, and of the correction of closed chains [1/s].
TURNS = 5e-3
CLOSES = 20.0
NAMES = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
#: Faults, and the law that should be named; empty where no law of the list is right.
FAULTS = {
    "dry": "dry friction",
    "viscous": "viscous friction",
    "springs": "springs",
    "added_mass": "added mass",
    "only_linear": "linear drag",
    "only_quadratic": "quadratic drag",
    "loose_hook": "",
}
#: Faults of rigs with one kind of drag, fitted by the other one.
OTHER_LAW = ("only_linear", "only_quadratic")
#: Sizes of faults in standard errors, as powers of ten.
TIMES = (0.9, 2.5)
#: Largest sizes: torques in weights of a link times its length, added mass in masses of a node.
MOST = {"dry": 0.03, "viscous": 0.03, "springs": 0.3, "added_mass": 0.3}
#: Displacement of a loose hook [m] under the weight of the chain.
LOOSE = (5e-4, 5e-3)


@dataclass(frozen=True)
class Rig:
    """A chain of point masses, its drag and its faults.

    Attributes:
        gap: distance of the two hooks [m]; None if it hangs from one.
        dry, viscous, springs: torques in all joints [N m, N m s/rad, N m/rad].
        added_mass: of every node [kg].
        loose: stiffness of the first hook, which moves sideways [N/m]; None if it does not.
    """

    links: int
    length: float
    mass: float
    gap: float | None
    b_l: float
    b_q: float
    dry: float = 0.0
    viscous: float = 0.0
    springs: float = 0.0
    added_mass: float = 0.0
    loose: float | None = None

    @property
    def torque(self) -> float:
        """Weight of a link times its length [N m]."""
        return self.mass * GRAVITY * self.length


@dataclass(frozen=True)
class Camera:
    """Rate [1/s], duration [s] and noise [rad] of a trace."""

    rate: float
    duration: float
    noise: float


def swing(rig: Rig, phi: np.ndarray, camera: Camera) -> np.ndarray:
    """Angles (frames, n) from straight down of a chain released from phi (n,)."""
    start = np.concatenate([[0.0], phi, np.zeros(len(phi) + 1)])
    t = np.arange(round(camera.duration * camera.rate) + 1) / camera.rate
    found = solve_ivp(slope_of(rig), (0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-9, atol=1e-10)
    return found.y[1 : rig.links + 1].T


def slope_of(rig: Rig) -> Callable[[float, np.ndarray], np.ndarray]:
    """Right side of Lagrange's equations in the hook's displacement and the angles.

    M q'' + A' lam = Q - J' m J.q', with the ends of a closed chain held by A q'' = -A.q' - 2 w C' - w^2 C (Baumgarte).
    """
    n = rig.links
    closed = rig.gap is not None
    nodes = n - closed
    inertia = np.full(nodes, rig.mass + rig.added_mass)
    below = np.tril(np.ones((n, n)))  # the links that a node hangs on

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        q, rate = np.split(y, 2)
        sine = np.sin(q[1:])
        cosine = np.cos(q[1:])
        jacobian = np.zeros((n, 2, n + 1))
        jacobian[:, 0, 0] = rig.loose is not None
        jacobian[:, 0, 1:] = below * rig.length * cosine
        jacobian[:, 1, 1:] = below * rig.length * sine
        turning = rig.length * np.stack([below @ (-sine * rate[1:] ** 2), below @ (cosine * rate[1:] ** 2)], axis=1)
        velocity = jacobian @ rate
        own = jacobian[:nodes]
        v = velocity[:nodes]
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        force = -rig.b_l * v - rig.b_q * speed * v - inertia[:, None] * turning[:nodes]
        force[:, 1] -= rig.mass * GRAVITY
        matrix = np.einsum("icj,i,ick->jk", own, inertia, own)
        loads = np.einsum("icj,ic->j", own, force)
        loads[1:] += joint_torques(rig, q[1:], rate[1:])
        matrix[0, 0] += 0.2 * rig.mass if rig.loose is not None else 1.0
        if rig.loose is not None:
            loads[0] -= rig.loose * q[0] + 0.1 * np.sqrt(rig.loose * rig.mass) * rate[0]
        if not closed:
            return np.concatenate([rate, np.linalg.solve(matrix, loads)])
        tip = rig.length * np.array([sine.sum(), -cosine.sum()]) - np.array([rig.gap, 0.0])
        tip[0] += q[0]
        A = jacobian[-1]
        right = -turning[-1] - 2 * CLOSES * velocity[-1] - CLOSES**2 * tip
        whole = np.block([[matrix, A.T], [A, np.zeros((2, 2))]])
        return np.concatenate([rate, np.linalg.solve(whole, np.concatenate([loads, right]))[: n + 1]])

    return slope


def joint_torques(rig: Rig, phi: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Torques (n,) on the links by friction in all joints and springs in the inner ones."""
    after = [0.0] if rig.gap is not None else []
    w = np.diff(np.concatenate([[0.0], rate, after]))
    torque = -rig.viscous * w - rig.dry * np.tanh(w / TURNS)
    torque[1 : rig.links] -= rig.springs * np.diff(phi)
    return torque[: rig.links] - np.append(torque[1:], [0.0] * (rig.links + 1 - len(torque)))


def pose(rig: Rig, rng: np.random.Generator) -> np.ndarray:
    """Angles (n,) from straight down at the release: tilted; or two straight parts with the kink above the hooks."""
    n = rig.links
    if rig.gap is None:
        return rng.uniform(0.5, 1.4) + 0.15 * rng.standard_normal(n)
    parts = [k for k in range(1, n) if abs(2 * k - n) * rig.length < 0.95 * rig.gap]
    k = int(rng.choice(parts))
    one = k * rig.length
    two = (n - k) * rig.length
    cosine = (one**2 + rig.gap**2 - two**2) / (2 * one * rig.gap)
    apex = one * np.array([cosine, np.sqrt(1 - cosine**2)])
    along = np.array([rig.gap, 0.0]) - apex
    return np.repeat([np.arctan2(apex[0], -apex[1]), np.arctan2(along[0], -along[1])], [k, n - k])


@dataclass(frozen=True)
class Draw:
    """A rig without fault, its pose, its camera, where a fit starts, and which fault follows."""

    rig: Rig
    phi: np.ndarray
    camera: Camera
    start: np.ndarray
    fault: str
    times: float
    seed: int


def draw(seed: int) -> Draw:
    """The draw of a seed."""
    rng = np.random.default_rng([seed, 59])
    fault = list(FAULTS)[seed % len(FAULTS)]
    links = int(rng.integers(2, 6))
    length = rng.uniform(0.06, 0.15)
    mass = rng.uniform(0.01, 0.06)
    closed = links > 2 and rng.random() < 0.6
    gap = rng.uniform(0.4, 0.75) * links * length if closed else None
    b_l, b_q = (mass * 10 ** rng.uniform(-1.6, -0.8) for _ in NAMES)
    rig = Rig(links, length, mass, gap, b_l * (fault != "only_quadratic"), b_q * (fault != "only_linear"))
    rate = float(rng.choice([60, 80, 100]))
    camera = Camera(rate, rng.uniform(6, 10), rng.uniform(2e-3, 6e-3))
    start = np.array([b_l, b_q]) * rng.choice([0.2, 5.0], 2)
    return Draw(rig, pose(rig, rng), camera, start, fault, 10 ** rng.uniform(*TIMES), seed)


def with_fault(d: Draw, right: FitResult) -> tuple[Rig, float]:
    """The rig with its fault, and the fault's size in standard errors of the right fit."""
    rng = np.random.default_rng([d.seed, 60])
    if d.fault == "loose_hook":
        weight = d.rig.links * d.rig.mass * GRAVITY
        return replace(d.rig, loose=weight / float(10 ** rng.uniform(*np.log10(LOOSE)))), np.nan
    error = {test.name: test.error for test in right.laws.tests}
    mine = next((e for name, e in error.items() if name.startswith(FAULTS[d.fault])), None)
    if d.fault not in MOST:
        return d.rig, drag_noncentrality(right)
    if mine is None:
        return d.rig, np.nan
    unit = {"springs": 1 / d.rig.length, "added_mass": d.rig.mass}.get(d.fault, 1.0)
    most = MOST[d.fault] * {"added_mass": d.rig.mass}.get(d.fault, d.rig.torque)
    size = min(d.times * mine * unit, most)
    return replace(d.rig, **{d.fault: size}), size / (mine * unit)


def drag_noncentrality(right: FitResult) -> float:
    """Size of the one coefficient of drag in standard errors of a fit with both kinds of drag.

    With b fitted alone, c the other one, S the information of both:

        var(b | c free) = var(b) + (db/dc)^2 var(c | b free),     db/dc = -S_bc/S_bb
    """
    other = next(
        (test for test in right.laws.tests if test.name in (FAULTS["only_linear"], FAULTS["only_quadratic"])), None
    )
    if other is None:
        return np.nan
    slope = next(iter(other.moves.values())) / other.change
    error = np.hypot(right.uncertainty.std_error[0], slope * other.error)
    return float(right.values[0] / error)


def scene_of(d: Draw, free: list[int]) -> Found:
    """What a fit is given: the rig without its fault, with these coefficients of drag."""
    rig = d.rig
    end: Found = {"name": "end", "position": [rig.gap or 0.0, 0.0, 0.0]}
    if rig.gap is None:
        end |= {"kind": "free", "position": [0.0, 0.0, -rig.links * rig.length]}
    line = {"name": "chain", "from": "hook", "to": "end", "links": rig.links, "length": rig.length, "mass": rig.mass}
    effects: Found = {"weight": {}}
    for i in free:
        _, effect, field = NAMES[i].split(".")
        effects[effect] = {field: float(d.start[i])}
    return {
        "run": {"dt": 0.002, "duration": d.camera.duration},
        "point": [{"name": "hook", "position": [0.0, 0.0, 0.0]}, end],
        "line": [line],
        "effects": effects,
        "start": {"kind": "static"},
    }


def seen(d: Draw, rig: Rig, stream: int) -> Trace:
    """A noisy trace of a rig."""
    phi = swing(rig, d.phi, d.camera)
    noise = d.camera.noise * np.random.default_rng([d.seed, stream]).standard_normal(phi.shape)
    t = np.arange(len(phi)) / d.camera.rate
    return Trace(f"chain-{d.seed}", t, phi + noise, convention=Convention("down", 1, "rad"))


def fitted(d: Draw, trace: Trace, free: list[int], simulator: Simulator | None) -> FitResult:
    """The default fit of a trace, by programs that a fit of the same scene has compiled."""
    prepared = prepare([trace], scene_of(d, free), [NAMES[i] for i in free], simulator=simulator)
    prepared = with_sound_windows(prepared)
    return summarise(prepared, "shooting", estimate(prepared))


def judge(d: Draw, trace: Trace, free: list[int], simulator: Simulator | None = None) -> tuple[Found, FitResult]:
    """A row on the fit of a trace with these coefficients free, and its result."""
    truth = np.array([d.rig.b_l, d.rig.b_q])[free]
    result, times = timed(lambda: fitted(d, trace, free, simulator))
    error = result.values - truth
    wrong = result.laws.wrong
    first = next(iter(result.laws.tests), None)
    return {
        **{"status": result.status, "message": result.message, "warnings": result.warnings},
        **{"named": wrong.name if wrong else "", "alike": list(wrong.alike) if wrong else []},
        **{"first": first.name if first else "", "first_p": first.p if first else 1.0},
        **{"least_p": min((test.p for test in result.laws.tests), default=1.0)},
        **{"matters": any(test.matters and test.p < 0.01 for test in result.laws.tests)},
        **{"values": result.values.tolist(), "std_error": result.uncertainty.std_error.tolist()},
        **{"errors": (error / result.uncertainty.std_error).tolist()},
        **{"relative": (error / np.where(truth > 0, truth, np.nan)).tolist()},
        **{"chi2": result.chi2_per_dof, "gap_weight": result.solution.gap_weight},
        **{"seconds": times["processor_s"]},
    }, result


def measure(seed: int, every: bool = False) -> Iterator[Found]:
    """The rows of a draw without and with its fault.

    Args:
        every: with each fault in turn, of rigs with both kinds of drag; their fits share the programs of the first one.
    """
    d = draw(seed)
    rig = d.rig
    used = [i for i, b in enumerate((rig.b_l, rig.b_q)) if b > 0]
    try:
        right, result = judge(d, seen(d, rig, 0), used)
    except SceneError as error:
        yield {**head_of(d), "refused": str(error)}
        return
    faults = [d.fault]
    if every and len(used) == 2:
        faults = [fault for fault in FAULTS if fault not in OTHER_LAW]
    for number, fault in enumerate(faults):
        one = d
        if every:
            times = 10 ** np.random.default_rng([seed, 63, number]).uniform(*TIMES)
            one = replace(d, fault=fault, times=times)
        faulty, times = with_fault(one, result)
        other = [1 - i for i in used] if len(used) == 1 else used  # the other law, where only one is true
        try:
            shared = result.solution.problem.simulator if other == used else None
            wrong = judge(one, seen(one, faulty, number + 1), other, shared)[0]
        except SceneError as error:
            wrong = {"status": "refused", "message": str(error)}
        size = getattr(faulty, fault, faulty.loose)
        yield {**head_of(one), "size": size, "times": times, **({} if number else {"right": right}), "wrong": wrong}


def head_of(d: Draw) -> Found:
    """What a row is of."""
    head = {"draw": f"{d.seed} {d.fault}", "seed": d.seed, "fault": d.fault, "law": FAULTS[d.fault]}
    return {**head, "links": d.rig.links, "closed": d.rig.gap is not None}


@command(seeds="0:48", every=False, out=RESULTS / "wrong_laws.json")
def main(args) -> None:
    rows = (measure(seed, args.every) for seed in seeds_of(args.seeds))
    collect(args.out, {"draws": chain.from_iterable(rows)}, by="draw")
