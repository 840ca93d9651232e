"""Numerical damping of a scheme in an undamped motion, as a linear damping coefficient."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.load.source import load_scene
from dropper_jax.model import Model, State
from dropper_jax.run.build import build
from dropper_jax.study.march import grid_run, status_of
from dropper_jax.study.schemes import Scheme
from dropper_jax.study.work_precision import energy_loss

SCENE = "dropper-release-a-undamped"
#: Duration of the runs for the energy table of the schemes [s].
DURATION = 6.5
#: Damping fitted in the thesis [kg/s], with its scheme and step [s].
THESIS_B_L = 0.002
THESIS_DT = 0.0065
THESIS = Scheme("thesis_angles", 0.51)
DTS = (2.0**-6, THESIS_DT, 2.0**-8, 2.0**-9, 2.0**-10, 2.0**-11)

SCHEMES = (
    THESIS,
    Scheme("thesis_angles", 0.5),
    Scheme("theta", 0.51),
    Scheme("theta", 0.5),
    Scheme("theta", 1.0),
    Scheme("theta_midpoint", 0.51),
    Scheme("semi_implicit_euler"),
    Scheme("rattle"),
    Scheme("energy_momentum"),
)


def numerical_damping(
    schemes: tuple[Scheme, ...] = SCHEMES, dts: tuple[float, ...] = DTS, scene: str = SCENE, duration: float = DURATION
) -> dict[str, Any]:
    """Equivalent damping `b = E_lost / sum over nodes of the integral of |v|^2` [kg/s] of each scheme and step.

    A linear damping b on every node would dissipate the same energy along the same path. Negative values mean that the
    scheme gains energy. Failed runs have no value. Steps are not halved, so the value is that of the scheme itself.

    Returns:
        scene, duration_s, rows of {label, dt, status, failed_at_s, energy_lost_j, equivalent_linear_damping,
        share_of_thesis}; `thesis`: the row of the thesis' own scheme and step, with its fraction of the fitted b_l of
        0.002 kg/s.
    """
    model, s = build(load_scene(scene))
    rows = [_row(model, s, scheme, dt, duration) for scheme in schemes for dt in dts]
    found = {"scene": scene, "duration_s": duration, "thesis_b_l": THESIS_B_L, "rows": rows}
    return {**found, "thesis": _thesis(rows)}


def _row(model: Model, s: State, scheme: Scheme, dt: float, duration: float) -> dict[str, Any]:
    stepper = scheme.stepper(model, halvings=0)
    steps = int(np.ceil(duration / dt - 1e-9))
    run = grid_run(stepper, model, s, steps * dt, steps, 1)
    status = status_of(run, stepper)
    row = {"label": scheme.label, "integrator": scheme.integrator, "gamma": scheme.gamma, "dt": dt, "status": status}
    if status != "ok":
        failed = (int(run.bad[-1]) + 1) * dt
        nothing = {"energy_lost_j": None, "equivalent_linear_damping": None, "share_of_thesis": None}
        return {**row, "failed_at_s": failed, **nothing}
    lost = float(energy_loss(model, s, run, np.array([steps * dt]))[-1])
    b = lost / float(run.path[-1])
    return {
        **row,
        "failed_at_s": None,
        "energy_lost_j": lost,
        "equivalent_linear_damping": b,
        "share_of_thesis": b / THESIS_B_L,
    }


def _thesis(rows: list[dict[str, Any]]) -> dict[str, Any]:
    own = [row for row in rows if row["label"] == THESIS.label]
    at = next((row for row in own if row["dt"] == THESIS_DT), None)
    if at is None:
        return {}
    where = f"{THESIS.label} at dt {THESIS_DT:g} s on {SCENE}"
    if at["status"] == "ok":
        text = f"{where}: {100 * at['share_of_thesis']:.3g} % of b_l = {THESIS_B_L:g} kg/s is the scheme's own"
    else:
        text = f"{where}: {at['status']} at {at['failed_at_s']:.3g} s, so no share can be given"
        good = [row for row in own if row["status"] == "ok"]
        if good:
            largest = max(good, key=lambda row: row["dt"])
            share = 100 * largest["share_of_thesis"]
            text += f"; at dt {largest['dt']:.4g} s, where it survives, {share:.3g} %"
    return {**at, "text": text}
