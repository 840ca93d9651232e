"""How much shorter a test of the lab dropper may be with accelerometers, by the information of the samples.

    S(T) = sum over samples before T of J' J / sigma^2,      errors = sqrt(diag(S^-1))

with the exact derivatives J of one run by b_l, b_q, the force of the release and all defects of the sensors (offsets,
turn, position and delay), at the scene's own values. Nothing is fitted.

    python benchmarks/sensor_plan.py
"""

import numpy as np
from study import command, say, store

from dropper_jax import load_scene
from fitting.channels.make_problem import make_problem

SCENE, LONGEST = "dropper-release-a", 8.0
DAMPING = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]
LINKS = 7
#: Sampling rates [1/s]; noise of angles from a film [rad], of accelerometers [m/s^2] and of gyroscopes [rad/s].
FILM_RATE, SENSOR_RATE = 60, 120
NOISE = {"angle": 0.005, "accelerometer": 0.05, "gyro": 0.01}
#: How well defects are known before the test.
PRIORS = {"offset": 0.5, "turn": 0.1, "position": 0.005, "delay": 0.01}
INSTRUMENTED = (2, 4, 6)
TIMES = (1.0, 2.0, 4.0, 8.0)


def channels() -> list[dict]:
    """All angles, and an accelerometer and a gyroscope on each of some links."""
    angles = [
        {"name": f"angle{j}", "kind": "angle", "column": f"angle{j}", "unit": "rad", "link": j}
        for j in range(1, LINKS + 1)
    ]
    found = [{**one, "noise": NOISE["angle"]} for one in angles]
    for j in INSTRUMENTED:
        columns = [f"along{j}", f"across{j}"]
        force = {"name": f"acc{j}", "kind": "accelerometer", "columns": columns, "unit": "m/s^2", "link": j}
        rate = {"name": f"gyro{j}", "kind": "gyro", "column": f"gyro{j}", "unit": "rad/s", "link": j}
        found += [{**force, "noise": NOISE["accelerometer"]}, {**rate, "noise": NOISE["gyro"]}]
    return found


def columns_of(channel: dict) -> list[str]:
    """Columns of a channel."""
    return channel.get("columns") or [channel["column"]]


def files(every: list[dict]) -> list[dict]:
    """One file of film and one of sensors, whose values do not matter."""
    found = []
    for rate, kinds in ((FILM_RATE, ("angle",)), (SENSOR_RATE, ("accelerometer", "gyro"))):
        t = np.arange(0.0, LONGEST, 1 / rate)
        names = [name for channel in every if channel["kind"] in kinds for name in columns_of(channel)]
        found.append({"t": t, **{name: np.sin(t) for name in names}})
    return found


def defects(channel: dict) -> list[str]:
    """Free numbers of a sensor."""
    kinds = {"accelerometer": ("offset", "turn", "position", "delay"), "gyro": ("offset", "delay"), "angle": ()}
    return [f"channel.{channel['name']}.{key}" for key in kinds[channel["kind"]]]


def errors(slopes, times, names, used, until: float) -> np.ndarray:
    """Standard errors of b_l and b_q from some channels before a time."""
    information = np.diag(
        [1 / PRIORS.get(name.split(".")[2], np.inf) ** 2 if "channel" in name else 0 for name in names]
    )
    for number, noise in used.items():
        part = slopes[number][times[number] < until].reshape(-1, len(names)) / noise
        information = information + part.T @ part
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.sqrt(np.diag(np.linalg.inv(information / np.outer(scale, scale)))[:2]) / scale[:2]


@command({})
def main() -> None:
    every = channels()
    scene = load_scene(SCENE).with_values({"run.dt": 1 / 240, "run.save_every": 2, "run.duration": LONGEST})
    free = [*DAMPING, "start.release_force.0.2", *(name for one in every for name in defects(one))]
    problem = make_problem(
        {"run": [{"file": files(every)}], "channel": every}, scene.with_equal_steps(), free, (), {}, {}, {}
    )
    names = [p.name for p in problem.parameters]
    evaluation = problem.evaluate(problem.values)
    slopes = evaluation.slopes[0]
    times = problem.data.runs[0].t
    sets = {
        "angles": ("angle",),
        "angles and an accelerometer": ("angle", "acc4"),
        "angles and an accelerometer with gyroscope": ("angle", "acc4", "gyro4"),
        "angles and 3 accelerometers": ("angle", "acc"),
        "3 accelerometers": ("acc",),
        "3 accelerometers with gyroscopes": ("acc", "gyro"),
    }
    fine = np.arange(0.1, LONGEST + 0.05, 0.05)
    found = {}
    for label, starts in sets.items():
        used = {i: NOISE[one["kind"]] for i, one in enumerate(every) if one["name"].startswith(starts)}
        found[label] = np.array([errors(slopes, times, names, used, until) for until in fine])
    rows = []
    for label, sizes in found.items():
        shown = sizes[np.searchsorted(fine, np.array(TIMES) - 1e-9)]
        shorter = []
        for until in TIMES[1:]:
            goal = found["angles"][np.argmin(np.abs(fine - until))]
            reached = (sizes <= goal * (1 + 1e-9)).all(axis=1)
            shorter.append(float(fine[np.argmax(reached)]) if reached.any() else None)
        rows.append({"sensors": label, "errors": shown.tolist(), "same_error_after_s": shorter})
        say(rows[-1])
    store("sensor_plan", {"times_s": TIMES, "compared_s": TIMES[1:], "failed": evaluation.failed, "rows": rows})
