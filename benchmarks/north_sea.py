"""What each effect of the water does to the dropper in the North Sea.

    python benchmarks/north_sea.py

Extreme angles, spectral peaks and tensions with the effects switched on one by one, and under the thesis' forces, at
two steps (four where the motion is chaotic).
"""

import numpy as np
from study import Found, collect, command, describe

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
STEPS = (0.0075, 0.00375)
FURTHER = (0.03, 0.015)
THESIS_STEP = 0.03
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


def summary(solution: dj.Solution) -> Found:
    """Of one run link `LINK`'s angles [rad], tensions of all links [N]."""
    polar = solution.polar[:, LINK - 1]
    azimuth = solution.azimuth[:, LINK - 1]
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


@command()
def main() -> None:
    base = dj.load_scene("dropper-north-sea").to_dict()
    plain = {key: base["effects"][key] for key in ("weight", "linear_damping")}
    cases = []
    for name, sea, effects in STAGES:
        table = {**base, "effects": base["effects"] if effects is None else {**plain, **effects}}
        table["sea"] = sea or base["sea"]
        table["run"] = {**base["run"], "duration": 120.0 if sea else 30.0}
        cases.append((name, table, STEPS, {}))
    rows = (
        {"name": name, "runs": [summary(dj.simulate(scene, dt=dt, **scheme)) for dt in steps]}
        for name, scene, steps, scheme in (*cases, *THESIS_ROWS)
    )
    collect("north_sea", {"rows": rows}, schema=2, link=LINK, machine=describe())
