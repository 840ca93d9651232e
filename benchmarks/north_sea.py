"""What each effect of the water does to the dropper in the North Sea, what the sea costs, and a pendulum in waves.

    python benchmarks/north_sea.py [--hour | --effects]

Prints three tables: extreme angles, spectral peaks and tensions with the effects switched on one by one, and under the
thesis' forces, at two steps (four where the motion is chaotic); cost per step of 231 components, one component and the
interpolated sea (and with --hour one hour of storm); the wet pendulum around its resonance (thesis 6.1): mean shift,
phase, answer to 10 % more amplitude, submergence.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from study import describe, say, store

import dropper_jax as dj
from dropper_jax.analysis.spectrum import amplitude_spectrum

LINK = 10
DRAG = {"morison_drag": {"cdn": 2.0}}
#: Name, changes of the scene, and the effects on top of weight and linear damping.
STAGES = (
    ("weight, no water", {}, {}),
    ("+ buoyancy", {}, {"buoyancy": {}}),
    ("+ drag", {}, {"buoyancy": {}, **DRAG}),
    ("+ inertia rho V u' (dropper-north-sea)", {}, {"buoyancy": {}, **DRAG, "morison_inertia": {}}),
    ("+ added mass, C_A = 1", {}, {"buoyancy": {}, **DRAG, "morison_inertia": {"can": 1.0}}),
    ("+ Du/Dt", {}, {"buoyancy": {}, **DRAG, "morison_inertia": {"can": 1.0, "fluid_acceleration": "material"}}),
    ("stated sea, Hs 8.20 m, 120 s", {"packaged": "north-sea-25-year-jonswap", "ramp": 10.0}, None),
)


#: Steps [s] of all rows, and further ones of the motion that is chaotic; that of the thesis.
STEPS, FURTHER, THESIS_STEP = (0.0075, 0.00375), (0.03, 0.015), 0.03
THESIS = "dropper-north-sea-thesis"
#: The same under the thesis' forces: name, scene, steps, scheme.
THESIS_ROWS = (
    ("thesis (6.13), relative velocity (dropper-north-sea-thesis-relative)", f"{THESIS}-relative", STEPS, {}),
    ("thesis (C.22), absolute velocity (dropper-north-sea-thesis)", THESIS, (*FURTHER, *STEPS), {}),
    *(
        (
            f"thesis {equation}, `thesis_angles` at 0.03 s",
            scene,
            (THESIS_STEP,),
            {"integrator": "thesis_angles"},
        )
        for equation, scene in (("(6.13)", f"{THESIS}-relative"), ("(C.22)", THESIS))
    ),
)


def summary(solution: dj.Solution) -> dict[str, Any]:
    """Of one run link `LINK`'s angles [rad], tensions of all links [N]."""
    polar, azimuth = solution.polar[:, LINK - 1], solution.azimuth[:, LINK - 1]
    frequency, size = amplitude_spectrum(solution.t, azimuth)
    tension = solution.tension[1:]
    return {
        "dt_s": solution.settings["dt"],
        "duration_s": float(solution.t[-1]),
        "polar_min_rad": float(polar.min()),
        "polar_max_rad": float(polar.max()),
        "azimuth_max_rad": float(np.abs(azimuth).max()),
        "azimuth_peak_hz": float(frequency[1 + int(np.argmax(size[1:]))]) if size[1:].max() > 1e-6 else None,
        "tension_first_max_n": float(tension[:, 0].max()),
        "tension_last_max_n": float(tension[:, -1].max()),
        "tension_min_n": float(tension.min()),
        "speed_max_m_s": float(solution.max_speed),
        "status": solution.status,
        "retried_steps": int(solution.retried_steps),
    }


def effects_table() -> None:
    """The dropper with the effects one by one, and as the thesis has it; also as JSON in `results/`."""
    base = dj.load_scene("dropper-north-sea").to_dict()
    plain = {key: base["effects"][key] for key in ("weight", "linear_damping")}
    cases = []
    for name, sea, effects in STAGES:
        table = {**base, "effects": base["effects"] if effects is None else {**plain, **effects}}
        table["sea"] = sea or base["sea"]
        table["run"] = {**base["run"], "duration": 120.0 if sea else 30.0}
        cases.append((name, table, STEPS, {}))
    rows = []
    for name, scene, steps, scheme in (*cases, *THESIS_ROWS):
        rows.append({"name": name, "runs": [summary(dj.simulate(scene, dt=dt, **scheme)) for dt in steps]})
        say(rows[-1])
    found = {"schema": 2, "link": LINK, "machine": describe(), "rows": rows}
    store("north_sea", found)


def microseconds(scene: dj.Scene, steps: int = 500) -> float:
    """Wall time of a step [us], best of five runs."""
    model, state = dj.build(scene)
    run = jax.jit(partial(dj.integrate, dj.make_stepper(model), steps=steps, save_every=10))
    best = np.inf
    for _ in range(6):
        begun = time.perf_counter()
        jax.block_until_ready(run(model, state, jnp.asarray(0.03)))
        best = min(best, time.perf_counter() - begun)
    return 1e6 * best / steps


def cost_table(hour: bool) -> None:
    """What the sea costs."""
    scene = dj.load_scene("dropper-north-sea")
    one = {"sea.waves.amplitude": [0.9], "sea.waves.period": [9.0], "sea.waves.phase": [0.1]}
    cost = microseconds(scene.with_values(one))
    print(f"one component     {cost:7.1f} us per step")
    for name, changes in (("231 components", {}), ("231, interpolated", {"sea.interpolation": "grid"})):
        found = microseconds(scene.with_values(changes) if changes else scene)
        print(f"{name:17} {found:7.1f} us per step, {found / cost:.1f} times")
    if hour:
        solution = dj.simulate(scene, duration=3600.0, save_every=10)
        print(f"one hour: {solution.run_s:.1f} s, {solution.status}, {solution.retried_steps} steps retried")


def pendulum_table() -> None:
    """The wet pendulum around its resonance."""
    scene = dj.load_scene("wet-pendulum-wave")
    print("period s  mean rad  amplitude rad  phase rad  +10 % waves  submerged")
    for period in (2.0, 2.4, 2.7, 2.85, 3.0, 3.2, 3.6, 4.2):
        rows = []
        for factor in (1.0, 1.1):
            values = {"sea.waves.period": period, "sea.waves.amplitude": 0.08 * factor}
            rows.append(pendulum(dj.simulate(scene.with_values(values)), period))
        (mean, size, phase, wet), (_, more, _, _) = rows
        print(f"{period:8.2f} {mean:9.4f} {size:14.4f} {phase:10.2f} {100 * (more / size - 1):10.1f} % {wet:10.2f}")


def pendulum(solution: dj.Solution, period: float) -> tuple[float, float, float, float]:
    """Mean angle and first harmonic of the last 40 s, its phase against the elevation, and the mean wet fraction."""
    model, _ = dj.build(solution.scene)
    last = solution.t > solution.t[-1] - np.floor(40.0 / period) * period
    t, bob = solution.t[last], solution.positions[last, 1]
    angle = np.arctan2(bob[:, 0], solution.positions[0, 0, 2] - bob[:, 2])
    eta = np.asarray(jax.vmap(lambda t: model.sea.elevation(jnp.zeros((1, 3)), t)[0])(jnp.asarray(t)))
    s = np.clip(0.5 + (eta - bob[:, 2]) / (float(model.line.diameter[0]) + np.cos(angle)), 0.0, 1.0)
    wave = np.exp(-2j * np.pi * t / period)
    swing, surface = 2 * np.mean((angle - angle.mean()) * wave), 2 * np.mean(eta * wave)
    return float(angle.mean()), float(abs(swing)), float(np.angle(swing / surface)), float(np.mean(s * s * (3 - 2 * s)))


if __name__ == "__main__":
    effects_table()
    if "--effects" in sys.argv:
        sys.exit()
    print()
    cost_table("--hour" in sys.argv)
    print()
    pendulum_table()
