"""Truth of another simulator for fits: Lagrange's equations of a chain of two rods, integrated by SciPy.

With angles phi from straight down, a_ij = L_j (j < i) or y_i (j = i) the lever of link j on link i's centre of mass,
and p_n the nodes:

    sum_k A_jk cos(phi_j - phi_k) phi_k'' = -sum_k A_jk sin(phi_j - phi_k) phi_k'^2 - g sin(phi_j) sum_i m_i a_ij + Q_j
    A_jk = sum_i m_i a_ij a_ik + I_j delta_jk
    Q_j = T(w_j - w_{j-1}) - T(w_{j+1} - w_j) - b_q sum_{n >= j} |p_n'| p_n' . dp_n/dphi_j
    T(w) = -c w - tau tanh(w / 0.005 rad/s)
"""

from types import SimpleNamespace

import numpy as np
import pytest
from jax._src import compiler
from jaxlib.mlir import ir
from scipy.integrate import solve_ivp

from fitting import Convention, FitSettings, Trace, prepare
from fitting.calibration.summarise import summarise
from fitting.windows.method import as_method, estimate

LENGTH, MASS = np.array([0.3, 0.25]), np.array([0.12, 0.09])
CENTRE, INERTIA = np.array([0.2, 0.11]), np.array([7e-4, 4e-4])
VISCOUS, QUADRATIC = 4e-4, 0.02
TRUTH = np.array([VISCOUS, QUADRATIC])
FREE = ["effects.joint_friction.viscous", "effects.quadratic_damping.b_q"]
G, RATE, DURATION, NOISE, WINDOW = 9.81, 30.0, 9.6, 0.005, 1.2
SETTINGS = FitSettings(window=WINDOW)


def torque(w, dry, viscous):
    """Torque of a joint whose links turn at w relative to each other."""
    return -viscous * w - dry * np.tanh(w / 5e-3)


def acceleration(phi, w, quadratic, dry=0.0, viscous=VISCOUS):
    """phi'' of the two rods."""
    lever = np.array([[CENTRE[0], 0.0], [LENGTH[0], CENTRE[1]]])
    square = np.einsum("i,ij,ik->jk", MASS, lever, lever) + np.diag(INERTIA)
    apart = phi[:, None] - phi[None, :]
    force = -(square * np.sin(apart)) @ w**2 - G * np.sin(phi) * (MASS @ lever)
    joints = torque(np.array([w[0], w[1] - w[0]]), dry, viscous)
    force += np.array([joints[0] - joints[1], joints[1]])
    turn = LENGTH[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    speed = np.cumsum(w[:, None] * turn, axis=0)
    drag = -quadratic * np.linalg.norm(speed, axis=1, keepdims=True) * speed
    force += turn[0] @ drag.sum(axis=0) * np.array([1.0, 0.0]) + turn[1] @ drag[1] * np.array([0.0, 1.0])
    return np.linalg.solve(square * np.cos(apart), force)


def swing(phi0, duration=DURATION, quadratic=QUADRATIC, rate=RATE, dry=0.0, viscous=VISCOUS):
    """Times and angles (k, 2) from straight down."""
    t = np.arange(round(duration * rate) + 1) / rate
    slope = lambda t, y: np.concatenate([y[2:], acceleration(y[:2], y[2:], quadratic, dry, viscous)])  # noqa: E731
    found = solve_ivp(slope, (0, t[-1]), [*phi0, 0, 0], method="DOP853", t_eval=t, rtol=1e-11, atol=1e-12)
    return t, found.y[:2].T


def seen(motion, seed, size=NOISE):
    """The motion as a noisy trace."""
    t, phi = motion
    noise = size * np.random.default_rng(seed).standard_normal(phi.shape)
    return Trace("rods", t, phi + noise, convention=Convention("down", 1, "rad"))


#: Programs of windows and of the loss of a trace.
RUN_LONG = ("jit_window", "jit__gauss_newton", "jit__move_starts")


@pytest.fixture(scope="module")
def optimised():
    """Programs that run for seconds are optimised a little: they run twice as fast, and compile in twice the time."""
    compile_program = compiler.compile_or_get_cached

    def optimise(backend, computation, devices, options, *more, **named):
        flags = options.executable_build_options.debug_options
        name = ir.StringAttr(computation.operation.attributes["sym_name"]).value
        if name in RUN_LONG and flags.xla_backend_optimization_level == 0:
            flags.xla_backend_optimization_level = 1
        return compile_program(backend, computation, devices, options, *more, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "compile_or_get_cached", optimise)
        yield


@pytest.fixture(scope="session")
def two():
    """Numbers of the two rods, `two.swing(angles)` and `two.seen(motion, seed)`."""
    return SimpleNamespace(
        TRUTH=TRUTH, FREE=FREE, QUADRATIC=QUADRATIC, NOISE=NOISE, RATE=RATE, SETTINGS=SETTINGS, swing=swing, seen=seen
    )


@pytest.fixture(scope="session")
def rods(chain):
    effects = {
        "weight": {},
        "joint_friction": {"viscous": 10 * VISCOUS, "axis": [0.0, 1.0, 0.0]},
        "quadratic_damping": {"b_q": 10 * QUADRATIC},
    }
    start = {"kind": "angles", "zero": "down", "polar": [1.2, 0.6]}
    return chain(
        LENGTH, MASS.tolist(), start, effects=effects, centre_of_mass=CENTRE.tolist(), inertia=INERTIA.tolist()
    )


@pytest.fixture(scope="session")
def motion():
    return swing([1.2, 0.6])


@pytest.fixture(scope="session")
def ready(rods):
    """`ready(traces)`: a prepared fit ten times off; all of them share one compiled simulator."""
    shared = []

    def make(traces, **options):
        prepared = prepare(traces, rods, FREE, settings=SETTINGS, simulator=shared[0] if shared else None, **options)
        shared[:] = [prepared.simulator]
        return prepared

    return make


@pytest.fixture(scope="session")
def difference():
    """`difference(result, field, i, step)`: derivative of an evaluation's field by parameter i, by central ones."""

    def run(result, field, i=-1, step=1e-5):
        simulator, starts, windows = result.solution.problem.simulator, result.solution.starts, result.windows
        change = np.zeros(len(result.values))
        change[i] = step
        ahead, behind = (simulator(result.values + side * change, starts, windows) for side in (1, -1))
        return (getattr(ahead, field) - getattr(behind, field)) / (2 * step)

    return run


@pytest.fixture(scope="session")
def fitted():
    """`fitted(prepared, method, ...)`: the result of an estimator, with its further arguments."""

    def run(prepared, method="windows", *more, **options):
        solution = estimate(prepared, method, *more, **options)
        return summarise(prepared, as_method(method).name, solution)

    return run


@pytest.fixture(scope="session")
def prepared(ready, motion):
    return ready(seen(motion, 0))


@pytest.fixture(scope="session")
def first_fit(ready, motion, fitted):
    return fitted(ready(seen(motion, 0)))


@pytest.fixture(scope="session")
def ten(ready, motion, fitted, first_fit):
    return [first_fit, *(fitted(ready(seen(motion, seed))) for seed in range(1, 10))]
