"""Strong currents, coefficients that follow the flow, turning tides, rows of wakes, against closed forms and SciPy."""

from typing import Any

import numpy as np
from energy_cases import ROUNDING
from hard_scenes import G, by_a_rope
from rows import exact, path, row, steps
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from sea_cases import RHO

from dropper_jax.load.scene import Scene, load_scene

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


#: Where the link is tied [m].
TIED = -5.0


def _last_angle(drag: float) -> dict[str, list]:
    """The angle [rad] at the end: half of the link's drag `c cos^2 a` across it carries the weight `m g sin a`."""
    force = 0.25 * RHO * drag * WIDE * ROPE * CURRENT**2
    sine = brentq(lambda s: force * (1.0 - s * s) - HEAVY * G * s, 0.0, 1.0)
    return exact(np.array([60.0]), np.arcsin([sine]), digits=17)


def beside_a_rope(name: str, body: dict[str, Any], **more: Any) -> Scene:
    """A body that no line holds."""
    return load_scene({"name": name} | by_a_rope(body, **more))


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


def turning() -> Scene:
    """The same link in a tide that turns round every 20 s, 3000 times as fast as a real one."""
    table = streaming().to_dict()
    table["sea"]["current"] = {"speed": PEAK, "amplitude": [1.0], "period": [CYCLE], "phase": [0.0]}
    return load_scene({**table, "name": "turning-tide"})


def _turned(t: np.ndarray) -> np.ndarray:
    """`(m + m_l/2) L a'' = -m g sin a + rho/4 C D L |w| w`, `w = U cos a - L a'`; the link weighs nothing in water."""
    moving = HEAVY + 0.5 * RHO * 0.25 * np.pi * WIDE**2 * ROPE

    def swing(t: float, y: np.ndarray) -> list[float]:
        w = PEAK * np.cos(2 * np.pi * t / CYCLE) * np.cos(y[0]) - ROPE * y[1]
        force = -HEAVY * G * np.sin(y[0]) + 0.25 * RHO * DRAG * WIDE * ROPE * abs(w) * w
        return [y[1], force / (moving * ROPE)]

    return solve_ivp(swing, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-9, max_step=0.05).y[0]


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


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    turns = exact(steps(0.02, 2 * CYCLE), _turned)

    return [
        row(
            "tumbling-body",
            "a rigid body turns over and over about its middle axis, 60 s at dt 0.01 s, drift of the energy balance",
            ROUNDING,
            "of the scale",
            "balance",
            tumbling(),
            0.01,
            60.0,
            4.0,
        ),
        row(
            "dropped-spar",
            "a ballasted spar falls lying into the water, goes under and rights itself, 30 s at dt "
            "0.01 s, drift of the energy balance",
            1e-4,
            "of the scale",
            "balance",
            dropped_spar(),
            0.01,
            30.0,
            3.0,
        ),
        path(
            "strong-current",
            "a weight on one link in 5 m/s, dt 0.1 s: error of its angle after 60 s",
            1e-4,
            "rad",
            "angle",
            streaming(),
            0.1,
            60.0,
            level=TIED,
            exact=_last_angle(DRAG),
        ),
        path(
            "flow-coefficients",
            "a weight on one rough link in 5 m/s whose drag coefficient follows the flow, dt 0.1 s: "
            "error of its angle after 60 s",
            1e-4,
            "rad",
            "angle",
            rough(),
            0.1,
            60.0,
            level=TIED,
            exact=_last_angle(ROUGH),
        ),
        path(
            "turning-tide",
            "a weight on one link in a tide of 2 m/s that turns every 20 s, 80 s at dt 0.02 s: distance "
            "of its angle from SciPy",
            0.01,
            "rad",
            "angle",
            turning(),
            0.02,
            2 * CYCLE,
            10.0,
            level=TIED,
            exact=turns,
        ),
        row(
            "row-of-wakes",
            "40 droppers behind each other, each in the wakes of all before: momentum lost behind them "
            "against their drag",
            0.01,
            "relative",
            "wake",
            row_of_droppers(ROWS),
            0.05,
            2.0,
            0.5,
            short_scene=row_of_droppers(3),
        ),
    ]
