"""The thesis' claims on Euler's methods, measured: explicit Euler gains energy, implicit Euler loses it."""

from __future__ import annotations

import jax.numpy as jnp

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import parse_toml_text
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import build
from dropper_jax.study.march import grid_run
from dropper_jax.study.schemes import Scheme

#: Scheme, claim of the thesis (sections 2.3, 4.3.1 and its conclusion), and the corresponding sign.
CLAIMS = (
    (Scheme("theta", 0.0), "explicit Euler gains energy", 1),
    (Scheme("theta", 1.0), "implicit Euler loses energy", -1),
    (Scheme("semi_implicit_euler"), "semi-implicit Euler does neither", 0),
)
EULER_DURATION = 5.0
#: A pendulum of 1 m and 1 kg released at 45 degrees, in a plane.
SINGLE_PENDULUM = """
name = "single-pendulum"

[run]
dt = 0.01
duration = 5.0

[[point]]
name = "pivot"
position = [0.0, 0.0, 0.0]

[[point]]
name = "bob"
kind = "free"
position = [0.7071067811865476, 0.0, -0.7071067811865476]

[[line]]
name = "pendulum"
from = "pivot"
to = "bob"
links = 1
length = 1.0
mass = 1.0

[effects.weight]

[start]
kind = "angles"
zero = "down"
polar = [0.7853981633974483]
"""
#: A change smaller than this fraction of the mean of the other two is neither gain nor loss.
SMALL_CHANGE = 0.1


def euler_claims(dts: tuple[float, ...] = (0.01, 0.005, 0.0025)) -> list[Table]:
    """Energy gained in `EULER_DURATION` by the three schemes at each step, over the energy scale, and whether the claim
    holds.

    Returns:
        rows of {scene, label, claim, dt, status, energy_gained, holds}; energies over the potential energy released.
    """
    rows = []
    for scene in (load_scene(parse_toml_text(SINGLE_PENDULUM)), load_scene("double-pendulum-periodic")):
        for dt in dts:
            gained = [_gain(scene, scheme, dt) for scheme, _, _ in CLAIMS]
            typical = SMALL_CHANGE * 0.5 * (abs(gained[0][1]) + abs(gained[1][1]))
            for (scheme, claim, sign), (status, gain) in zip(CLAIMS, gained, strict=True):
                holds = status == "ok" and _has_sign(gain, sign, typical)
                row = {"scene": scene.name, "label": scheme.label, "claim": claim, "dt": dt, "status": status}
                rows.append({**row, "energy_gained": gain, "holds": bool(holds)})
    return rows


def _has_sign(gain: float, sign: int, typical: float) -> bool:
    """Whether an energy is gained (1), lost (-1), or neither (0): smaller than `typical`."""
    if sign == 0:
        return abs(gain) < typical
    return sign * gain > 0


def _gain(scene: Scene, scheme: Scheme, dt: float) -> tuple[str, float]:
    """Status of a run, and the energy that it gains over the potential energy released."""
    model, s = build(scene)
    steps = round(EULER_DURATION / dt)
    run = grid_run(scheme.stepper(model, halvings=0), model, s, steps * dt, steps, 1)
    lowest = jnp.sum(model.line.mass * GRAVITY * -jnp.cumsum(model.line.length))
    start = model.potential_energy(model.kinematics(s.r, s.v, s.t))
    return run.status, -run.energy_loss[-1] / float(start - lowest)
