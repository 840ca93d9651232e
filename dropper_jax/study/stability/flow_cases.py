"""Strong currents, coefficients that follow the flow, turning tides, rows of wakes, against closed forms and SciPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.simulate import simulate
from dropper_jax.run.wakes import scene_wakes
from dropper_jax.study.stability.case import Case, Outcome, Watched, relative_drift, watch
from dropper_jax.study.stability.energy_cases import ROUNDING
from dropper_jax.study.stability.scenes import G
from dropper_jax.study.stability.sea_cases import RHO

#: A light rope with a weight in a current [m/s]; rope: length, diameter [m], drag coefficient.
CURRENT, ROPE, WIDE, DRAG, HEAVY = 5.0, 10.0, 0.05, 1.2, 50.0


def streaming() -> Scene:
    """A weight on one link in a current that accelerates the link to the water velocity within 0.1 % of a step."""
    neutral = RHO * 0.25 * np.pi * WIDE**2
    return load_scene(
        {
            "name": "strong-current",
            "run": {"dt": 0.1, "duration": 60.0},
            "line_type": [{"name": "rope", "mass": neutral, "diameter": WIDE, "EA": 1e6, "cdn": DRAG, "cdt": 0.0}],
            "point": [
                {"name": "top", "position": [0.0, 0.0, -5.0]},
                {"name": "weight", "kind": "free", "position": [0.0, 0.0, -5.0 - ROPE], "mass": HEAVY},
            ],
            "line": [{"name": "rope", "from": "top", "to": "weight", "type": "rope", "length": ROPE, "links": 1}],
            "sea": {"depth": 30.0, "density": RHO, "current": {"kind": "uniform", "speed": CURRENT}},
            "effects": {"weight": {"gravity": G}, "buoyancy": {}, "morison_drag": {}},
            "start": {"kind": "points"},
        }
    )


def _streams(short: bool) -> Watched:
    return Watched(streaming(), 0.1, 60.0, "weight", _last_angle(DRAG))


def _last_angle(drag: float) -> Callable[[np.ndarray, np.ndarray], float]:
    """Error of the angle [rad] at the end: half of the link's drag `c cos^2 a` across it carries the weight `m g sin
    a`."""
    force = 0.25 * RHO * drag * WIDE * ROPE * CURRENT**2
    sine = brentq(lambda s: force * (1.0 - s * s) - HEAVY * G * s, 0.0, 1.0)
    return lambda t, positions: abs(float(np.arctan2(positions[-1, 0], -positions[-1, 2] - 5.0) - np.arcsin(sine)))


def beside_a_rope(name: str, body: dict[str, Any], **more: Any) -> Scene:
    """A body that no line holds; scenes have a line, which is far off."""
    rope = {"length": 2.0, "mass": 1.0, "diameter": 0.02, "axial": {"law": "rope", "EA": 1e4}}
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 1.0},
            "point": [{"name": "a", "position": [50.0, 0.0, -5.0]}, {"name": "b", "position": [53.0, 0.0, -5.0]}],
            "line": [{"name": "rope", "from": "a", "to": "b", "links": 2, **rope}],
            "body": [body],
            "start": {"kind": "points"},
            **more,
        }
    )


def tumbling() -> Scene:
    """A body turned about its middle axis, about which it turns over and over."""
    body = {"name": "stone", "position": [0.0, 0.0, 0.0], "mass": 10.0, "centre_of_mass": [0.1, 0.2, -0.3]}
    motion = {"inertia": [1.0, 2.0, 3.0], "angular_velocity": [0.01, 3.0, 0.01]}
    return beside_a_rope("tumbling-body", {**body, **motion}, effects={"weight": {"gravity": 0.0}})


def dropped_spar() -> Scene:
    """A ballasted spar released horizontally 3 m above the water: it falls in, submerges, surfaces and rights
    itself."""
    cylinder = {"from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, 6.0], "diameter": 0.8, "slices": 4, "cdn": 0.0, "can": 0.0}
    body = {
        "name": "spar",
        "position": [0.0, 0.0, 3.0],
        "attitude": [0.1, 1.4, 0.0],
        "mass": 1500.0,
        "centre_of_mass": [0.0, 0.0, 1.2],
        "inertia": [4000.0, 4000.0, 120.0],
        "cylinders": [cylinder],
    }
    return beside_a_rope("dropped-spar", body, sea={"depth": 50.0}, effects={"weight": {}})


def _energy(make: Any, dt: float, span: float, brief: float) -> Any:
    def measure(short: bool) -> Outcome:
        return relative_drift(simulate(make(), dt=dt, duration=brief if short else span))

    return measure


BODY_CASES = [
    Case("tumbling-body", "a rigid body turns over and over about its middle axis, 60 s at dt 0.01 s, drift of the "
         "energy balance", ROUNDING, "of the scale", _energy(tumbling, 0.01, 60.0, 4.0)),
    Case("dropped-spar", "a ballasted spar falls lying into the water, goes under and rights itself, 30 s at dt "
         "0.01 s, drift of the energy balance", 1e-4, "of the scale", _energy(dropped_spar, 0.01, 30.0, 3.0)),
]  # fmt: skip


#: Drag coefficient of cylinders with marine growth in a current (API RP 2A-WSD), and a roughness [m].
ROUGH, HEIGHT = 1.05, 0.002
#: Peak [m/s] and period [s] of a tide that turns.
PEAK, CYCLE, DRAG = 2.0, 40.0, 1.2
#: Droppers behind each other: how many, how far apart [m], in which current [m/s].
ROWS, SPACING, SLOW = 40, 2.0, 0.3


def rough() -> Scene:
    """A weight on one link in a current that alone decides its drag coefficient."""
    table = streaming().to_dict()
    table["effects"]["morison_drag"] = {"coefficients": "rough_cylinder", "roughness": HEIGHT}
    return load_scene({**table, "name": "flow-coefficients"})


def _rough(short: bool) -> Outcome:
    ran = simulate(rough(), dt=0.1, duration=60.0)
    return Outcome(_last_angle(ROUGH)(ran.t, ran.point_path("weight")), ran.status)


def turning() -> Scene:
    """The same link in a tide that turns round every 20 s, 3000 times as fast as a real one."""
    table = streaming().to_dict()
    table["sea"]["current"] = {"speed": PEAK, "amplitude": [1.0], "period": [CYCLE], "phase": [0.0]}
    return load_scene({**table, "name": "turning-tide"})


def _turns(short: bool) -> Outcome:
    """`(m + m_l/2) L a'' = -m g sin a + rho/4 C D L |w| w`, `w = U cos a - L a'`; the link weighs nothing in water."""
    moving = HEAVY + 0.5 * RHO * 0.25 * np.pi * WIDE**2 * ROPE

    def swing(t: float, y: np.ndarray) -> list[float]:
        w = PEAK * np.cos(2 * np.pi * t / CYCLE) * np.cos(y[0]) - ROPE * y[1]
        force = -HEAVY * G * np.sin(y[0]) + 0.25 * RHO * DRAG * WIDE * ROPE * abs(w) * w
        return [y[1], force / (moving * ROPE)]

    ran = simulate(turning(), dt=0.02, duration=10.0 if short else 2 * CYCLE)
    positions = ran.point_path("weight")
    angle = np.arctan2(positions[:, 0], -(positions[:, 2] + 5.0))
    exact = solve_ivp(swing, (0.0, ran.t[-1]), [angle[0], 0.0], t_eval=ran.t, rtol=1e-9, atol=1e-9, max_step=0.05).y[0]
    return Outcome(float(np.max(np.abs(angle - exact))), ran.status)


def row_of_droppers(count: int) -> Scene:
    """Droppers exactly behind each other in a slow current, each in the wakes of all before it."""
    points, lines = [], []
    for i in range(count):
        x = SPACING * i
        points += [
            {"name": f"top-{i}", "position": [x, 0.0, -1.0]},
            {"name": f"end-{i}", "kind": "free", "position": [x, 0.0, -9.0], "mass": 200.0},
        ]
        line = {"name": f"dropper-{i}", "from": f"top-{i}", "to": f"end-{i}", "type": "sock", "length": 8.0}
        lines.append({**line, "links": 2})
    return load_scene(
        {
            "name": "row-of-wakes",
            "run": {"dt": 0.05, "duration": 2.0},
            "line_type": [{"name": "sock", "mass": 21.8, "diameter": 0.15, "EA": 4e5, "cdn": 1.3, "cdt": 0.0}],
            "point": points,
            "line": lines,
            "sea": {"depth": 12.0, "density": RHO, "current": {"kind": "uniform", "speed": SLOW}},
            "effects": {"weight": {"gravity": G}, "buoyancy": {}, "morison_drag": {"wakes": "porous"}},
        }
    )


def _row(short: bool) -> Outcome:
    """Momentum that the water has lost behind the row, by quadrature over a plane across it, against the row's drag."""
    scene = row_of_droppers(3 if short else ROWS)
    wakes = scene_wakes(scene).wakes
    y = np.linspace(-40.0, 40.0, 8001)
    nodes, weight = np.polynomial.legendre.leggauss(40)
    deficit = wakes.plane(float(wakes.elements.x.max()) + 5.0).deficit(y, 0.5 * wakes.depth * (nodes - 1.0))
    lost = float(np.sum((wakes.speed - deficit) * deficit @ (0.5 * wakes.depth * weight)) * (y[1] - y[0]))
    ran = simulate(scene, duration=0.5 if short else 2.0)
    slowed = bool(np.all(wakes.met > 0.0) and np.all(wakes.met <= wakes.speed))
    return Outcome(abs(lost / float(np.sum(wakes.drag)) - 1.0) if slowed else np.inf, ran.status)


FLOW_CASES = [
    watch("strong-current", "a weight on one link in 5 m/s, dt 0.1 s: error of its angle after 60 s", 1e-4, "rad",
          _streams),
    Case("flow-coefficients", "a weight on one rough link in 5 m/s whose drag coefficient follows the flow, dt 0.1 s: "
         "error of its angle after 60 s", 1e-4, "rad", _rough),
    Case("turning-tide", "a weight on one link in a tide of 2 m/s that turns every 20 s, 80 s at dt 0.02 s: distance "
         "of its angle from SciPy", 0.01, "rad", _turns),
    Case("row-of-wakes", "40 droppers behind each other, each in the wakes of all before: momentum lost behind them "
         "against their drag", 0.01, "relative", _row),
]  # fmt: skip

CASES = [*BODY_CASES, *FLOW_CASES]
