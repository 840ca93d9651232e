"""Numerical damping of schemes on the dropper of the thesis, as the linear damping that dissipates as much."""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.base.records import rows_where
from dropper_jax.load.scene import load_scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build
from dropper_jax.study.march import grid_run
from dropper_jax.study.schemes import Scheme

SCENE = "dropper-release-a-undamped"
#: Damping fitted in the thesis [kg/s], with its scheme and step [s].
THESIS_B_L = 0.002
THESIS_DT = 0.0065
THESIS = Scheme("thesis_angles", 0.51)
DAMPING_DTS = (2.0**-6, THESIS_DT, 2.0**-8, 2.0**-9, 2.0**-10, 2.0**-11)

REPORT_SCHEMES = (
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
    schemes: tuple[Scheme, ...] = REPORT_SCHEMES, dts: tuple[float, ...] = DAMPING_DTS, duration: float = 6.5
) -> Table:
    """Equivalent damping `b = E_lost / sum over nodes of the integral of |v|^2` [kg/s] of each scheme and step.

    A linear damping b on every node would dissipate the same energy along the same path. Negative values mean that the
    scheme gains energy. Failed runs have no value. Steps are not halved, so the value is that of the scheme itself.

    Returns:
        scene, duration_s, rows of {label, dt, status, failed_at_s, energy_lost_j, equivalent_linear_damping,
        share_of_thesis}; `thesis`: the row of the thesis' own scheme and step, with its fraction of the fitted b_l of
        0.002 kg/s.
    """
    model, s = build(load_scene(SCENE))
    rows = [_row(model, s, scheme, dt, duration) for scheme in schemes for dt in dts]
    found = {"scene": SCENE, "duration_s": duration, "thesis_b_l": THESIS_B_L, "rows": rows}
    return {**found, "thesis": _thesis(rows)}


def _row(model: Model, s: State, scheme: Scheme, dt: float, duration: float) -> Table:
    """The row of a scheme and step [s]."""
    steps = int(np.ceil(duration / dt - 1e-9))
    run = grid_run(scheme.stepper(model, halvings=0), model, s, steps * dt, steps, 1)
    row: Table = {"label": scheme.label, "integrator": scheme.integrator, "gamma": scheme.gamma, "dt": dt}
    row |= {"status": run.status, **dict.fromkeys(("failed_at_s", *LOSSES))}
    if run.status != "ok":
        return row | {"failed_at_s": (int(run.rows.bad[-1]) + 1) * dt}
    lost = run.energy_loss[-1]
    damping = lost / run.rows.path[-1]
    return row | dict(zip(LOSSES, (lost, damping, damping / THESIS_B_L), strict=True))


#: Numbers of a run that has ended.
LOSSES = ("energy_lost_j", "equivalent_linear_damping", "share_of_thesis")


def _thesis(rows: list[Table]) -> Table:
    """The row of the thesis' scheme and step, and what it means in words; empty if it was not run."""
    own = rows_where(rows, "label", THESIS.label)
    at = next((row for row in own if row["dt"] == THESIS_DT), None)
    if at is None:
        return {}
    where = f"{THESIS.label} at dt {THESIS_DT:g} s on {SCENE}"
    if at["status"] == "ok":
        text = f"{where}: {100 * at['share_of_thesis']:.3g} % of b_l = {THESIS_B_L:g} kg/s is the scheme's own"
    else:
        text = f"{where}: {at['status']} at {at['failed_at_s']:.3g} s, so no share can be given"
        good = rows_where(own, "status", "ok")
        if good:
            largest = max(good, key=itemgetter("dt"))
            text += f"; at dt {largest['dt']:.4g} s, where it survives, {100 * largest['share_of_thesis']:.3g} %"
    return {**at, "text": text}
