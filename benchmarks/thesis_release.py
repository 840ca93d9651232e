"""The thesis' releases of the lab dropper as the thesis ran them: 0.0065 s, 65 s, gamma 0.51, a force until 15 s.

    python benchmarks/thesis_release.py

Three tables: the thesis' equations (C.32)-(C.41) in the plane, in NumPy, corrected and with the sign of the
centripetal x-term as printed; scenario A with the dampings of Table E.1; the scenes `dropper-release-X-ramp`, with
`-ramp-14`, and those from measured poses, by the default scheme and by the thesis' own. Writes
`results/thesis_release.json`.
"""

import numpy as np
from study import Found, collect, command, describe
from sweep_truths import PAIRS

import dropper_jax as dj

STEP = 0.0065
DURATION = 65.0
RELEASE = 15.0
GAMMA = 0.51
#: Releases [s] of the scenes with a ramp, by suffix: 15 s of Figure 5.3, and the one at which the angles are met best.
RAMPS = {"ramp": RELEASE, "ramp-14": 14.1}
#: Dampings b_l [kg/s], b_q [kg/m] of the scenarios: none, and the thesis' choice.
DAMPINGS = ((0.0, 0.0), (0.002, 0.001))
#: Table E.1, and Tables 8.3 and 8.4, which it lacks.
TABLE_E_1 = tuple(zip(*PAIRS.values(), strict=True))
OTHERS = (*DAMPINGS, (0.01, 0.0))
#: Link angles [rad] of the thesis' simulation before the release (Tables E.2 to E.4, signs as those of A).
MODEL = {
    "a": (0.1577, 1.4490, 1.3606, 0.8666, -1.1492, -1.3909, -1.4571),
    "b": (1.3264, 0.2358, 1.3713, 0.8197, -1.2286, -1.4166, -1.4752),
    "c": (1.4288, 1.2475, -0.8729, 1.3243, -0.1956, -1.3396, -1.4526),
}


def run(name: str, b: tuple[float, float], dt: float = STEP, **settings) -> dj.Solution:
    """A release for 65 s (50 s from a pose, which is when a ramp releases)."""
    scene = dj.load_scene(name).with_values({"effects.linear_damping.b_l": b[0], "effects.quadratic_damping.b_q": b[1]})
    return dj.simulate(scene, dt=dt, duration=DURATION if "-ramp" in name else DURATION - RELEASE, **settings)


def end(solution: dj.Solution) -> Found:
    """How a run ended: status, time of its last good step [s], energy balance over its scale."""
    share = solution.energy_drift / solution.energy_scale
    return {"status": solution.status, "reached_s": float(solution.t[-1]), "energy_share": share}


def damped(name: str, b: tuple[float, float]) -> Found:
    """A release with a damping, by the thesis' scheme."""
    return {"b_l": b[0], "b_q": b[1], **end(run(name, b, integrator="thesis_angles", gamma=GAMMA))}


def scenario(letter: str) -> Found:
    """A scenario from the ramps and from its packaged pose."""
    found = {"scenario": letter.upper()}
    for start in ("ramp", "ramp-14", "pose"):
        if start == "pose":
            name = f"dropper-release-{letter}"
        else:
            name = f"dropper-release-{letter}-{start}"
        if name not in dj.scene_names():
            continue
        default = run(name, DAMPINGS[1])
        before = default.polar[0 if start == "pose" else np.searchsorted(default.t, RAMPS[start] - STEP)]
        found[start] = {"default": end(default), "thesis_angles": [damped(name, b) for b in DAMPINGS]}
        if letter in MODEL:
            found[start]["rms_to_model_rad"] = float(np.sqrt(np.mean((before - MODEL[letter]) ** 2)))
    return found


def damping_row(b: tuple[float, float]) -> Found:
    """Scenario A with a damping."""
    return {**damped("dropper-release-a-ramp", b), "table_e_1": b in TABLE_E_1}


class PlaneScheme:
    """(C.32)-(C.41) with phi = 0 and (E.1), undamped; unknowns theta, theta' and T of each link.

    Corrected: masses, and the sign of the centripetal acceleration in x, unless `printed`. Jacobian by complex steps.
    """

    def __init__(self, dt: float, printed: bool) -> None:
        line = dj.load_scene("dropper-release-a").lines[0]
        self.length, self.mass, self.dt = line.length, line.mass[:-1], dt
        self.sign = -1.0 if printed else 1.0

    def sides(self, y: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Of states y (..., 3, n): centripetal accelerations and forces over mass (..., 2, n - 1), x and z."""
        theta, rate, tension = np.moveaxis(y, -2, 0)
        cos = np.cos(theta)
        sin = np.sin(theta)
        bend = np.cumsum(self.length * rate**2 * np.stack([-cos, sin]), axis=-1)[..., :-1]
        force = np.diff(tension * np.stack([cos, -sin]), axis=-1)
        force[1] -= 9.81 * self.mass
        force[1, ..., 0] += min(max(0.094 * (t - 3.0), 0.0), 2.5624) if t < RELEASE else 0.0
        return bend * np.array([self.sign, 1.0]).reshape(2, *[1] * theta.ndim), force / self.mass

    def rows(self, y: np.ndarray, old: np.ndarray, t: float) -> np.ndarray:
        """Residuals (..., 3 n) of a step from t."""
        theta = y[..., 0, :]
        rate = y[..., 1, :]
        turned = (theta - old[0]) / self.dt - GAMMA * rate - (1 - GAMMA) * old[1]
        change = self.length * (rate - old[1]) / self.dt
        a = np.cumsum(change * np.stack([-np.sin(theta), -np.cos(theta)]), axis=-1)[..., :-1]
        b1, f1 = self.sides(y, t + self.dt)
        b0, f0 = self.sides(old, t)
        before = (b0 - f0).reshape(2, *[1] * (b1.ndim - 2), -1)
        motion = a + GAMMA * (b1 - f1) + (1 - GAMMA) * before
        x, z = (np.sum(self.length * part, axis=-1) for part in (np.cos(theta), np.sin(theta)))
        return np.concatenate([turned, motion[0], motion[1], (x - 0.28)[..., None], z[..., None]], axis=-1)

    def step(self, old: np.ndarray, t: float) -> np.ndarray | None:
        """The state after a step from t; None where Newton's method finds none."""
        y = old
        tiny = 1e-30
        for _ in range(30):
            tried = y.reshape(1, 3, -1) + 1j * tiny * np.eye(old.size).reshape(old.size, 3, -1)
            jacobian = np.imag(self.rows(tried, old, t)).T / tiny
            if not np.all(np.isfinite(jacobian)):
                return None
            change = np.linalg.solve(jacobian, self.rows(y, old, t))
            y = y - change.reshape(3, -1)
            if np.max(np.abs(change)) < 1e-11 * (1.0 + np.max(np.abs(y))):
                return y
        return None

    def run(self, state: np.ndarray) -> float:
        """Time of the last step that Newton's method solves, up to 65 s."""
        for i in range(round(DURATION / self.dt)):
            state = self.step(state, i * self.dt)
            if state is None:
                return i * self.dt
        return DURATION


def independent(dt: float) -> Found:
    """How far the equations run undamped, in NumPy, corrected and as printed."""
    rest = dj.simulate("dropper-release-a-ramp", duration=dt, dt=dt)
    start = np.stack([rest.polar[0], np.zeros(7), rest.tension[0]])
    return {"dt_s": dt, **{key: PlaneScheme(dt, key == "printed").run(start) for key in ("corrected", "printed")}}


@command()
def main() -> None:
    parts = {
        "independent": map(independent, (0.01, STEP)),
        "dampings": map(damping_row, (*OTHERS, *TABLE_E_1)),
        "scenarios": map(scenario, "abcde"),
    }
    collect("thesis_release", parts, schema=1, machine=describe(), dt_s=STEP, gamma=GAMMA)
