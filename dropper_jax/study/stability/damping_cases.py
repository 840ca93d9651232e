"""Hard dissipation, against closed forms."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene
from dropper_jax.study.stability import scenes
from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.runner import CaseRun, run_case

G = GRAVITY


def overdamped_pendulum() -> Scene:
    """A pendulum of 1 m and 1 kg at 1 rad; critical is b = 2 m sqrt(g/L)."""
    heavy = {"weight": {}, "linear_damping": {"b_l": 1000 * 2 * float(np.sqrt(G))}}
    return scenes.chain("heavy-damping", [1.0], effects=heavy)


def _creeping(short: bool) -> CaseRun:
    return run_case(overdamped_pendulum(), 0.1, 40.0 if short else 400.0)


def _creep_position(short: bool) -> Outcome:
    """`tan(theta/2) = tan(theta0/2) exp(-m g t / (b L))`, the motion without inertia (a share of 1e-6 here).

    Drag that stops a node within the step acts at its end, the weight in its middle: half a step late, 8e-5 of the way.
    """
    ran = _creeping(short)
    rate = G / (1000 * 2 * np.sqrt(G))
    theta = 2 * np.arctan(np.tan(0.5) * np.exp(-rate * ran.t))
    exact = np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=-1)
    worst = np.max(np.linalg.norm(ran.run.r[:, 0] - exact, axis=-1))
    return Outcome(float(worst), ran.status, (overdamped_pendulum(), 0.1, 40.0))


def _creep_energy(short: bool) -> Outcome:
    """Largest rise of the height from one saved time to the next, as energy."""
    ran = _creeping(short)
    heights = np.concatenate([np.asarray(ran.start.r)[None], ran.run.r])[:, 0, 2]
    kinetic = 0.5 * np.sum(np.concatenate([np.asarray(ran.start.v)[None], ran.run.v])[:, 0] ** 2, axis=-1)
    return Outcome(float(np.max(np.diff(G * heights + kinetic), initial=-np.inf)), ran.status)


def fast() -> Scene:
    """Without weight, at 20 m/s round a circle."""
    drag = {"quadratic_damping": {"b_q": 0.5}}
    return scenes.chain("fast-drag", [0.3], effects=drag, polar_rate=[20.0])


def _drag_speed(short: bool) -> Outcome:
    """`v(t) = v0 / (1 + b v0 t / m)`."""
    ran = run_case(fast(), 0.002, 0.4 if short else 4.0)
    speed = np.linalg.norm(ran.run.v[:, 0], axis=-1)
    exact = 20.0 / (1 + 0.5 * 20.0 * ran.t)
    return Outcome(float(np.max(np.abs(speed / exact - 1))), ran.status, (fast(), 0.002, 0.4))


def sticky(polar: list[float]) -> Scene:
    """Links of 1 m and 1 kg with dry joints, released at these angles [rad]: they swing slightly and stick."""
    friction = {"weight": {}, "joint_friction": {"dry": 1.0, "axis": [0.0, 1.0, 0.0]}}
    return scenes.chain("dry-friction", polar, effects=friction)


def _creep(polar: list[float], short: bool) -> Outcome:
    """Movement over 300 s (short: 10 s) after the first 20 s."""
    still = 20.0
    scene = sticky(polar)
    rest = run_case(scene, 0.002, still)
    ran = run_case(scene, 0.002, still + (10.0 if short else 300.0))
    moved = np.linalg.norm(ran.run.r[ran.t >= still - 1e-9] - rest.run.r[-1], axis=-1)
    status = ran.status if rest.status == "ok" else rest.status
    return Outcome(float(np.max(moved)), status, (scene, 0.002, still))


CASES = [
    Case("heavy-damping-position", "damping 1000 times critical at dt 0.1 s, 400 s: distance from the closed form",
         1e-4, "m", _creep_position),
    Case("heavy-damping-energy", "damping 1000 times critical at dt 0.1 s: largest rise of energy", 0.0, "J",
         _creep_energy),
    Case("quadratic-damping-fast", "quadratic damping from 20 m/s, 4 s at dt 0.002 s: error of the speed",
         1e-3, "relative", _drag_speed),
    Case("dry-friction-stays", "a link with a dry joint comes to rest and stays: movement in 300 s", 1e-12, "m",
         lambda short: _creep([0.6], short)),
    Case("dry-friction-two-joints", "two links with dry joints come to rest and stay: movement in 300 s", 1e-12, "m",
         lambda short: _creep([0.6, 0.2], short)),
]  # fmt: skip
