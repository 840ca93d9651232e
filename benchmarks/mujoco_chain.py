"""The line in MuJoCo: point masses at the ends of links on ball joints, the loop closed by a `connect` constraint."""

from __future__ import annotations

from typing import Any

import numpy as np
from peer_row import peer_row, time_runs

from dropper_jax.model import Model, State
from dropper_jax.study.march import link_vectors
from dropper_jax.study.reference import Reference

NAME = "mujoco"
INTEGRATORS = ("RK4", "implicitfast", "Euler")
#: Steps [s]; 5 ms is the usual one.
DTS = (0.005, 2.0**-6, 2.0**-7, 2.0**-8, 2.0**-9, 2.0**-10, 2.0**-11, 2.0**-12)


def refuse(model: Model, s: State) -> str | None:
    """Why MuJoCo cannot run the model, or None."""
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return "mujoco is not installed (extra `peers`)"
    if model.line.compound or model.line.axial.elastic:
        return "only rigid links with point masses are described in MuJoCo"
    others = [e.name for e in model.effects if e.name != "weight"]
    if others or len(model.effects) != 1 or model.effects[0].wet_weight is not None:
        return f"only weight in air is described in MuJoCo, the scene has {', '.join(others) or 'no such weight'}"
    if float(np.max(np.abs(s.v))) > 0:
        return "only starts at rest are described in MuJoCo"
    return None


def rows(model: Model, s: State, target: Reference, dts: tuple[float, ...] = DTS) -> list[dict[str, Any]]:
    """One row per integrator and step, with a stiff closing constraint, and for RK4 with the default one."""
    everies = sorted({max(1, round(target.grid / dt)) for dt in dts})
    kinds = [(integrator, True) for integrator in INTEGRATORS] + [("RK4", False)]
    return [_row(model, s, target, *kind, every) for kind in kinds for every in everies]


def _row(model: Model, s: State, target: Reference, integrator: str, hard: bool, every: int) -> dict[str, Any]:
    import mujoco

    dt = target.grid / every
    engine = mujoco.MjModel.from_xml_string(xml(model, integrator, dt, hard))
    sites = [engine.site(f"node{i}").id for i in range(model.free_nodes)]
    pose = _quaternions(link_vectors(model, np.asarray(s.r)[None], np.zeros(1))[0])

    def run() -> tuple[np.ndarray, bool]:
        data = mujoco.MjData(engine)
        data.qpos[:] = pose.ravel()
        mujoco.mj_forward(engine, data)
        seen = np.empty((len(target.t), model.free_nodes, 3))
        for k in range(len(target.t)):
            mujoco.mj_step(engine, data, every)
            mujoco.mj_kinematics(engine, data)  # sites lag a step behind otherwise
            seen[k] = data.site_xpos[sites]
        calm = not any(w.number for w in data.warning)  # a bad state resets the simulation and counts a warning
        return seen, calm

    run()
    (r, calm), wall = time_runs(run)
    label = f"mujoco {integrator}" + ("" if hard else " default")
    return peer_row(model, label, "Newton", r, every * len(target.t), wall, target, calm)


def xml(model: Model, integrator: str, dt: float, hard: bool) -> str:
    """The MuJoCo model; every link lies along x in its own frame, its mass in a point at its far end.

    `hard`: the loop closed as stiffly as the step bears; else with MuJoCo's defaults.
    """
    lengths = np.asarray(model.line.length)
    masses = np.asarray(model.line.mass)
    gravity = float(model.effects[0].gravity)
    start = np.asarray(model.points[model.geometry.members[0].start].position)
    body = ""
    for i in reversed(range(len(lengths))):
        if i:
            position = f"{lengths[i - 1]:.17g} 0 0"
        else:
            position = " ".join(f"{x:.17g}" for x in start)
        # inertia of a link about its own end, over m L^2: a ball joint would spin freely about the link without any
        spin = 1e-8 * masses[i] * lengths[i] ** 2
        body = (
            f'<body name="link{i}" pos="{position}"><joint type="ball"/>'
            f'<inertial pos="{lengths[i]:.17g} 0 0" mass="{masses[i]:.17g}" diaginertia="{spin:g} {spin:g} {spin:g}"/>'
            f'<site name="node{i}" pos="{lengths[i]:.17g} 0 0"/>{body}</body>'
        )
    closing = ""
    if model.both_ends_fixed:
        # time constant of the closing constraint over the step; below 2 MuJoCo itself raises it
        if hard:
            stiff = f'solref="{2.0 * dt:g} 1" solimp="0.999999 0.999999 0.001"'
        else:
            stiff = ""
        end = " ".join(f"{x:.17g}" for x in np.asarray(model.points[model.geometry.members[0].end].position))
        closing = f'<equality><connect site1="node{len(lengths) - 1}" site2="held" {stiff}/></equality>'
        body += f'<site name="held" pos="{end}"/>'
    return (
        f'<mujoco><compiler balanceinertia="true" boundmass="0" boundinertia="0"/>'
        f'<option timestep="{dt:.17g}" gravity="0 0 {-gravity:.17g}" integrator="{integrator}" solver="Newton" '
        f'tolerance="1e-12" iterations="100"><flag contact="disable"/></option>'
        f"<worldbody>{body}</worldbody>{closing}</mujoco>"
    )


def _quaternions(links: np.ndarray) -> np.ndarray:
    """Joint quaternions (n, 4) that turn each link from its parent's direction; no spin."""
    unit = links / np.linalg.norm(links, axis=1, keepdims=True)
    absolute = [_from_x(u) for u in unit]
    relative = [absolute[0]]
    for before, after in zip(absolute[:-1], absolute[1:], strict=True):
        relative.append(_product(before * np.array([1, -1, -1, -1]), after))
    return np.array(relative)


def _from_x(unit: np.ndarray) -> np.ndarray:
    """Rotation that takes the x axis to a unit vector, about the axis across both (y where they are opposite)."""
    if unit[0] < -1 + 1e-14:
        return np.array([0.0, 0.0, 1.0, 0.0])
    q = np.array([1 + unit[0], 0.0, -unit[2], unit[1]])
    return q / np.linalg.norm(q)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[w], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])
