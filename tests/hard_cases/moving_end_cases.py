"""Ends that start and stop moving suddenly, compared with closed forms and SciPy."""

from typing import Any

import numpy as np
from hard_scenes import G, weight_on_rope
from rows import exact, path, row, steps
from scipy.integrate import solve_ivp

from dropper_jax.load.scene import Scene, load_scene

MASS, PERIOD, LENGTH = 100.0, 0.5, 2.0
OMEGA = 2 * np.pi / PERIOD
REST = G / OMEGA**2


def on_moving_top(motion: dict[str, Any]) -> Scene:
    """A weight at rest on a rope that stays taut while its top moves up and down."""
    effects = {"end_motion": {"point": "top", **motion}}
    return weight_on_rope("moving-end", MASS, MASS * OMEGA**2, LENGTH, LENGTH + REST, effects=effects)


#: A top that swings from the first instant on: amplitude [m], period [s].
HEAVE, SLOW = 0.02, 1.7


def _forced(t: np.ndarray) -> np.ndarray:
    """Forced swing: `z = a w^2/(w^2 - W^2) (sin W t - W/w sin w t)`."""
    omega = 2 * np.pi / SLOW
    share = HEAVE * OMEGA**2 / (OMEGA**2 - omega**2)
    return share * (np.sin(omega * t) - omega / OMEGA * np.sin(OMEGA * t))


#: A top that moves evenly for a while, from and to 0.3 of a step: speed [m/s], step [s].
LIFT, STEP = 0.1, 0.005
BEGIN, END = 0.1 + 0.3 * STEP, 0.42 + 0.3 * STEP


def _swung(t: np.ndarray) -> np.ndarray:
    """Each kink starts a swing: `z = V (s - sin w s/w)` from the first one on, less the same from the second on."""

    def swing(s: np.ndarray) -> np.ndarray:
        s = np.maximum(s, 0.0)
        return LIFT * (s - np.sin(OMEGA * s) / OMEGA)

    return swing(t - BEGIN) - swing(t - END)


#: The rigid pendulum: length [m], and the speed of its point [m/s].
ROD, SIDEWAYS = 1.0, 0.5


def pendulum() -> Scene:
    """A pendulum at rest whose point moves evenly to the side for a while, from and to 0.3 of a step."""
    rows = [[0.0] * 3, [SIDEWAYS * (END - BEGIN), 0.0, 0.0]]
    return load_scene(
        {
            "name": "kinked-pendulum",
            "run": {"dt": STEP, "duration": 1.5},
            "point": [
                {"name": "top", "position": [0.0, 0.0, 0.0]},
                {"name": "end", "kind": "free", "position": [0.0, 0.0, -ROD]},
            ],
            "line": [{"name": "rod", "from": "top", "to": "end", "links": 1, "length": ROD, "mass": 1.0}],
            "effects": {
                "weight": {"gravity": G},
                "end_motion": {"point": "top", "time": [BEGIN, END], "displacement": rows},
            },
        }
    )


def _tension_after(times: np.ndarray) -> np.ndarray:
    """Tension after the stop, `m (L rate^2 + g cos)` [N]: along the rod it would alternate for ever, were it rung.

    The point's acceleration is nothing between its kinks; each turns the rod by `-V cos/L` more or less at once.
    """
    fine = {"rtol": 1e-11, "atol": 1e-12}
    fall = lambda _, y: [y[1], -G / ROD * np.sin(y[0])]  # noqa: E731
    angle, rate = solve_ivp(fall, (BEGIN, END), [0.0, -SIDEWAYS / ROD], **fine).y[:, -1]
    start = [angle, rate + SIDEWAYS * np.cos(angle) / ROD]
    angle, rate = solve_ivp(fall, (END, times[-1] + 1e-9), start, t_eval=times, **fine).y
    return ROD * rate**2 + G * np.cos(angle)


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    # Tensions are those of the middle of a step.
    middles = STEP * (np.arange(round(1.5 / STEP)) + 0.5)
    after = exact(middles[middles > END + STEP], _tension_after)
    heaved = on_moving_top({"amplitude": [0.0, 0.0, HEAVE], "period": SLOW})
    kinked = on_moving_top({"time": [BEGIN, END], "displacement": [[0.0] * 3, [0.0, 0.0, LIFT * (END - BEGIN)]]})

    return [
        path(
            "end-starts-at-speed",
            "the top of a rope heaves from the first instant at its full speed, 2 s at dt "
            "0.005 s: distance of the weight from the closed form over the heave",
            0.02,
            "relative",
            "distance",
            heaved,
            0.005,
            2.0,
            exact=exact(steps(0.005, 2.0), _forced),
            size=HEAVE,
            from_start=True,
        ),
        path(
            "end-kinks-rope",
            "the top of a rope moves off and stops at 0.3 of a step: distance of the weight from the "
            "closed form over its swing",
            0.02,
            "relative",
            "distance",
            kinked,
            STEP,
            1.5,
            exact=exact(steps(STEP, 1.5), _swung),
            size=LIFT / OMEGA,
            from_start=True,
        ),
        row(
            "end-kinks-rod",
            "the point of a pendulum moves off sideways and stops at 0.3 of a step: error of the tension "
            "after it, against SciPy",
            0.01,
            "of the weight",
            "tension",
            pendulum(),
            STEP,
            1.5,
            exact=after,
            size=G,
        ),
    ]
