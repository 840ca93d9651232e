"""In and out of the water, steep waves and many floats, against closed forms and SciPy."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from hard_scenes import G, weight_on_thread
from rows import exact, path, steps
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from dropper_jax.base.constants import SEA_WATER
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.sea.steady import GivenWave
from dropper_jax.sea.stream_function import stream_function

RHO = SEA_WATER


def _wet(height: np.ndarray | float, diameter: float) -> Any:
    """Wet fraction of a body at `height` [m] below the surface with a vertical extent [m], as in the water effects."""
    s = np.clip(0.5 + height / diameter, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def _diameter(volume: float) -> float:
    return float(np.cbrt(6 * volume / np.pi))


#: A float: mass [kg], volume [m^3], drag area [m^2], coefficient of added mass.
BALL = {"mass": 200.0, "volume": 0.5, "drag_area": 0.15, "added_mass": 0.5}
DROP = 2.0


def _ball_by_scipy(t: np.ndarray) -> np.ndarray:
    """Height of a ball that falls into the water, pops out and falls in again."""
    mass, volume, area, added = (BALL[key] for key in ("mass", "volume", "drag_area", "added_mass"))

    def fall(_: float, y: np.ndarray) -> list[float]:
        wet = _wet(-y[0], _diameter(volume))
        force = -mass * G + RHO * G * volume * wet - 0.5 * RHO * area * wet * abs(y[1]) * y[1]
        return [y[1], force / (mass + RHO * volume * wet * added)]

    return solve_ivp(fall, (0.0, t[-1]), [DROP, 0.0], t_eval=t, rtol=1e-10, atol=1e-10, max_step=0.01).y[0]


def dropped_ball() -> Scene:
    """A ball released above the water."""
    return weight_on_thread("dry-wet", BALL, [0.0, 0.0, DROP], {}, sea={"depth": 30.0, "density": RHO})


#: A spar: mass [kg], diameter, height [m] and drag coefficient of its base; how high its base starts [m].
SPAR = {"mass": 1000.0, "diameter": 0.8, "height": 4.0, "cdn": 0.0, "cdt": 0.3, "can": 0.0, "cat": 0.0}
ABOVE = 4.0


def dropped_spar() -> Scene:
    """A spar buoy that falls into the water, goes under and comes out again."""
    table = weight_on_thread("buoy-under", {}, [0.0, 0.0, ABOVE], {}, sea={"depth": 60.0, "density": RHO}).to_dict()
    table["buoy"] = [{"name": "spar", "point": "weight", **SPAR}]
    return Scene.from_dict(table)


def _spar_by_scipy(t: np.ndarray) -> np.ndarray:
    area = 0.25 * np.pi * SPAR["diameter"] ** 2

    def fall(_: float, y: np.ndarray) -> list[float]:
        wet = np.clip(-y[0], 0.0, SPAR["height"])
        drag = 0.5 * RHO * SPAR["cdt"] * area * abs(y[1]) * y[1] if wet > 0.0 else 0.0
        return [y[1], -G + (RHO * G * area * wet - drag) / SPAR["mass"]]

    return solve_ivp(fall, (0.0, t[-1]), [ABOVE, 0.0], t_eval=t, rtol=1e-9, atol=1e-9, max_step=0.01).y[0]


#: Waves at a share of the height at which they break: depth [m], period [s].
DEPTH, PERIOD, NEARLY = 10.0, 6.0, 0.95
DRIFTER = {"mass": 20.0, "volume": 0.03, "drag_area": 0.1, "added_mass": 0.5}


def _regular_sea(amplitude: float) -> dict[str, Any]:
    return {"depth": DEPTH, "density": RHO, "waves": {"kind": "regular", "amplitude": amplitude, "period": PERIOD}}


@cache
def _wave_number() -> float:
    omega = 2 * np.pi / PERIOD
    return float(brentq(lambda k: G * k * np.tanh(k * DEPTH) - omega**2, 1e-4, 10.0))


def _amplitude() -> float:
    """Half of `NEARLY` times Miche's height, 0.142 L tanh kd [m]."""
    k = _wave_number()
    return 0.5 * NEARLY * 0.142 * 2 * np.pi / k * float(np.tanh(k * DEPTH))


def _airy(x: Any, z: Any, t: float, a: float) -> tuple[Any, np.ndarray, np.ndarray]:
    """Elevation, velocity and local acceleration (..., 2) under a wave of amplitude a, stretched as Wheeler does."""
    k, omega = _wave_number(), 2 * np.pi / PERIOD
    phase = k * x - omega * t
    eta = a * np.cos(phase)
    h = np.minimum(DEPTH * (z - eta) / (DEPTH + eta), 0.0) + DEPTH
    c, s = np.cosh(k * h) / np.sinh(k * DEPTH), np.sinh(k * h) / np.sinh(k * DEPTH)
    velocity = a * omega * np.stack([c * np.cos(phase), s * np.sin(phase)], axis=-1)
    return eta, velocity, a * omega**2 * np.stack([c * np.sin(phase), -s * np.cos(phase)], axis=-1)


def _drifter_by_scipy(
    body: dict[str, float], field: Callable[[float, float, float], tuple[Any, np.ndarray, np.ndarray]]
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Path of a body in a field of elevation, velocity and acceleration over x, z and t."""
    mass, volume, area, added = (body[key] for key in ("mass", "volume", "drag_area", "added_mass"))

    def move(t: float, y: np.ndarray) -> np.ndarray:
        eta, u, change = field(y[0], y[1], t)
        wet = _wet(eta - y[1], _diameter(volume))
        w = u - y[2:]
        displaced = RHO * volume * wet
        force = 0.5 * RHO * area * wet * np.hypot(*w) * w + (1 + added) * displaced * change
        force = force + np.array([0.0, displaced * G - mass * G])
        return np.concatenate([y[2:], force / (mass + added * displaced)])

    def path(t: np.ndarray, start: np.ndarray) -> np.ndarray:
        y = np.concatenate([start, [0.0, 0.0]])
        return solve_ivp(move, (0.0, t[-1]), y, t_eval=t, rtol=1e-11, atol=1e-12, max_step=0.01).y[:2].T

    return path


def floating(name: str, sea: dict[str, Any]) -> Scene:
    """A float released at the surface."""
    return weight_on_thread(name, DRIFTER, [0.0, 0.0, 0.0], {}, sea=sea)


def _drifted(field: Callable[[float, float, float], tuple[Any, np.ndarray, np.ndarray]]) -> dict[str, list]:
    moved = _drifter_by_scipy(DRIFTER, field)
    return exact(steps(0.01, 12.0), lambda t: moved(t, np.zeros(2)))


#: Height [m] of a wave by the stream function: 0.9 of the highest of its length, 5.93 m.
HIGH = 5.34


def _steep_field() -> Callable[[float, float, float], tuple[Any, np.ndarray, np.ndarray]]:
    """Elevation, velocity and local acceleration of that wave from its harmonics."""
    wave = stream_function(GivenWave(HIGH, DEPTH, G, period=PERIOD))
    j = np.arange(1, wave.order + 1)
    k, omega = wave.wave_number, 2 * np.pi / wave.period

    def field(x: float, z: float, t: float) -> tuple[Any, np.ndarray, np.ndarray]:
        phase = j * (k * x - omega * t)
        eta = float(np.cos(phase) @ wave.surface)
        h = min(max(z, -DEPTH), eta) + DEPTH
        u = wave.speed / np.cosh(j * k * DEPTH)
        c, s = u * np.cosh(j * k * h), u * np.sinh(j * k * h)
        velocity = np.array([c @ np.cos(phase), s @ np.sin(phase)])
        return eta, velocity, omega * np.array([(j * c) @ np.sin(phase), -(j * s) @ np.cos(phase)])

    return field


def steep_sea() -> dict[str, Any]:
    waves = {"kind": "regular", "theory": "stream", "height": HIGH, "period": PERIOD}
    return {"depth": DEPTH, "density": RHO, "waves": waves}


#: A pendulum through the surface: its link (length, diameter [m], mass [kg]), its point's height [m], coefficients of
#: drag and added mass, and the amplitude of the wave that swings it [m].
ROD, ROUND, BOB, UP, ACROSS, ADDED = 1.0, 0.1, 12.0, 0.7, 1.0, 1.0
SWELL = 0.4


def pendulum() -> Scene:
    """A pendulum half in the water, which waves drench and leave dry."""
    return load_scene(
        {
            "name": "pendulum-in-waves",
            "run": {"dt": 0.01, "duration": 20.0},
            "point": [
                {"name": "pivot", "position": [0.0, 0.0, UP]},
                {"name": "bob", "kind": "free", "position": [0.0, 0.0, UP - ROD]},
            ],
            "line": [
                {"name": "rod", "from": "pivot", "to": "bob", "links": 1, "length": ROD, "mass": BOB}
                | {"diameter": ROUND}
            ],
            "sea": _regular_sea(SWELL),
            "effects": {
                "weight": {"gravity": G},
                "buoyancy": {},
                "morison_drag": {"cdn": ACROSS},
                "morison_inertia": {"can": ADDED, "cat": 0.0},
            },
            "start": {"kind": "angles", "zero": "down", "polar": [0.0]},
        }
    )


def _pendulum_by_scipy(t: np.ndarray) -> np.ndarray:
    """Angle from the vertical: what acts on the far end across the rod, over its inertia."""
    volume = 0.25 * np.pi * ROUND**2 * ROD

    def swing(t: float, y: np.ndarray) -> list[float]:
        along, across = np.array([np.sin(y[0]), -np.cos(y[0])]), np.array([np.cos(y[0]), np.sin(y[0])])
        position = np.array([0.0, UP]) + ROD * along
        eta, u, change = _airy(*position, t, SWELL)
        wet = _wet(eta - position[1], ROUND + ROD * abs(along[1]))
        w = u @ across - ROD * y[1]
        force = (RHO * volume * wet - BOB) * G * across[1] + 0.5 * RHO * ACROSS * ROUND * ROD * wet * abs(w) * w
        force = force + (1 + ADDED) * RHO * volume * wet * (change @ across)
        return [y[1], force / (BOB + ADDED * RHO * volume * wet) / ROD]

    return solve_ivp(swing, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]


#: Floats in a row, tied to one another and to an anchor at either end: their number, distance [m], stiffness [N] and
#: damping [N s] of the ropes between them, and the amplitude of the wave they ride [m].
FLOATS, SPACING, TETHER, LOSS = 24, 4.0, 1e5, 1200.0
RIDDEN = 0.6


def row_of_floats() -> Scene:
    """Floats released at the surface, with their ropes just taut."""
    positions = [[SPACING * i, 0.0, 0.0 if 0 < i <= FLOATS else -3.0] for i in range(FLOATS + 2)]
    points: list[dict[str, Any]] = [
        {"name": f"float-{i}", "kind": "free", "position": position, **DRIFTER} for i, position in enumerate(positions)
    ]
    points[0] = {"name": "float-0", "position": positions[0]}
    points[-1] = {"name": f"float-{FLOATS + 1}", "position": positions[-1]}
    sizes = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    lines = [
        {"name": f"tie-{i}", "from": f"float-{i}", "to": f"float-{i + 1}", "type": "tie", "length": size, "links": 1}
        for i, size in enumerate(sizes.tolist())
    ]
    return load_scene(
        {
            "name": "many-floats",
            "run": {"dt": 0.02, "duration": 4.0},
            "line_type": [{"name": "tie", "mass": 1e-6, "diameter": 1e-4, "EA": TETHER, "damping": LOSS}],
            "point": points,
            "line": lines,
            "sea": _regular_sea(RIDDEN),
            "effects": {"weight": {"gravity": G}},
            "start": {"kind": "points"},
        }
    )


def _row_by_scipy(t: np.ndarray) -> np.ndarray:
    """Positions (k, floats, 2) of the floats: bodies with Morison forces on damped springs without compression."""
    mass, volume, area, added = (DRIFTER[key] for key in ("mass", "volume", "drag_area", "added_mass"))
    ends = np.array([[0.0, -3.0], [SPACING * (FLOATS + 1), -3.0]])
    start = np.stack([SPACING * np.arange(1, FLOATS + 1), np.zeros(FLOATS)], axis=1)
    lengths = np.linalg.norm(np.diff(np.concatenate([ends[:1], start, ends[1:]]), axis=0), axis=1)

    def move(t: float, y: np.ndarray) -> np.ndarray:
        r, v = y.reshape(2, FLOATS, 2)
        eta, u, change = _airy(r[:, 0], r[:, 1], t, RIDDEN)
        wet = _wet(eta - r[:, 1], _diameter(volume))[:, None]
        d = np.diff(np.concatenate([ends[:1], r, ends[1:]]), axis=0)
        size = np.linalg.norm(d, axis=1)
        spring = TETHER / lengths * np.maximum(size - lengths, 0.0)
        rates = np.diff(np.concatenate([rest, v, rest]), axis=0)
        damper = LOSS / lengths * np.sum(d * rates, axis=1) / size
        link_force = ((spring + np.clip(damper, -spring, spring)) / size)[:, None] * d
        w, displaced = u - v, RHO * volume * wet
        force = 0.5 * RHO * area * wet * np.linalg.norm(w, axis=1)[:, None] * w + (1 + added) * displaced * change
        force = force + (displaced - mass) * [0.0, G] + link_force[1:] - link_force[:-1]
        return np.concatenate([v.ravel(), (force / (mass + added * displaced)).ravel()])

    rest = np.zeros((1, 2))
    y = np.concatenate([start.ravel(), np.zeros(2 * FLOATS)])
    # With `rtol` 1e-7 one rounding of the start moves the floats by 2e-7 m: the stored path must fit any processor.
    found = solve_ivp(move, (0.0, t[-1]), y, t_eval=t, method="DOP853", rtol=1e-10, atol=1e-11)
    return found.y[: 2 * FLOATS].T.reshape(-1, FLOATS, 2)


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    middle = FLOATS // 2
    near_breaking = _amplitude()

    return [
        path(
            "dry-wet-crossing",
            "a ball falls 2 m into the water, pops out and bobs, 10 s at dt 0.01 s: distance from SciPy over the fall",
            0.01,
            "relative",
            "distance",
            dropped_ball(),
            0.01,
            10.0,
            4.0,
            exact=exact(steps(0.01, 10.0), _ball_by_scipy),
            size=DROP,
        ),
        path(
            "buoy-under",
            "a spar falls into the water, goes under and comes out again, 10 s at dt 0.01 s: distance "
            "from SciPy over its way",
            0.01,
            "relative",
            "distance",
            dropped_spar(),
            0.01,
            10.0,
            4.0,
            exact=exact(steps(0.01, 10.0), _spar_by_scipy),
            size=ABOVE + SPAR["height"],
        ),
        path(
            "pendulum-in-waves",
            "a pendulum through the surface that waves drench and leave dry, 20 s at dt 0.01 s: distance from SciPy",
            0.01,
            "rad",
            "angle",
            pendulum(),
            0.01,
            20.0,
            5.0,
            point="bob",
            level=UP,
            exact=exact(steps(0.01, 20.0), _pendulum_by_scipy),
        ),
        path(
            "near-breaking-float",
            "a float in waves of 0.95 of the breaking height, 12 s at dt 0.01 s: distance from "
            "SciPy over the amplitude",
            0.01,
            "relative",
            "distance",
            floating("near-breaking", _regular_sea(near_breaking)),
            0.01,
            12.0,
            exact=_drifted(lambda x, z, t: _airy(x, z, t, near_breaking)),
            size=near_breaking,
        ),
        path(
            "steep-wave-float",
            "a float in a wave by the stream function, 0.9 of the highest, 12 s at dt 0.01 s: "
            "distance from SciPy over the height",
            0.01,
            "relative",
            "distance",
            floating("steep-wave", steep_sea()),
            0.01,
            12.0,
            4.0,
            exact=_drifted(_steep_field()),
            size=HIGH,
        ),
        path(
            "many-floats",
            "24 floats tied in a row ride a wave of 0.6 m, 4 s at dt 0.02 s: distance of one in the "
            "middle from SciPy over the amplitude",
            0.01,
            "relative",
            "distance",
            row_of_floats(),
            0.02,
            4.0,
            1.0,
            point=f"float-{middle}",
            exact=exact(steps(0.02, 4.0), lambda t: _row_by_scipy(t)[:, middle - 1]),
            size=RIDDEN,
        ),
    ]
