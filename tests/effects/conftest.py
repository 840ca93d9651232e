"""What tests of several effects share: one instant of a bent line, and lines that hang in water."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scene_parts as parts

import dropper_jax as dj

#: A line of three links of 0.5 m with a free end, bent, and its velocities.
POSE = [[0.0, 0.0, 0.0], [0.3, 0.0, -0.4], [0.7, 0.3, -0.4], [0.7, 0.3, -0.9]]
SPEEDS = [[0, 0, 0], [0.4, 0.1, 0.3], [0.4, 0.1, 0.3], [0.9, 0.1, 0.3]]


@pytest.fixture(scope="session")
def instant(chain):
    """`instant(effects)`: the model of three links of 0.5 m with a free end in a fixed pose, and its kinematics."""

    def make(effects, **line):
        start = {"kind": "positions", "positions": POSE, "velocities": SPEEDS}
        model, s = dj.build(chain([0.5] * 3, [0.2, 0.1, 0.3], start, effects=effects, **line))
        return model, model.kinematics(s.r, s.v, s.t)

    return make


@pytest.fixture(scope="session")
def hanging():
    """`hanging(effects, sea, ...)`: a line of `links` from (0, 0, -5) straight down, its end free."""

    def make(effects, sea, length=1.0, mass=10.0, diameter=0.05, links=1, start=None, **line):
        own = {"mass": mass, "diameter": diameter, **line}
        own = {key: value for key, value in own.items() if value is not None}
        return parts.system(
            [parts.fixed("top", 0.0, 0.0, -5.0), parts.free("end", 0.0, 0.0, -5.0 - length * links)],
            [parts.line_of("line", "top", "end", links, length, **own)],
            dt=0.001,
            effects=effects,
            start=start or {"kind": "angles", "zero": "down", "polar": [0.0] * links},
            sea={"depth": 50.0, "density": 1000.0, **sea},
        )

    return make


@partial(jax.jit, static_argnames=("stepper", "steps", "every"))
def _run(stepper, model, state, dt, steps, every=1):
    return dj.integrate(stepper, model, state, dt, steps, save_every=every)


@pytest.fixture(scope="session")
def runs():
    """`runs(scene, dt, steps)`: the model, and the saved states of a run without retries."""

    def make(scene, dt, steps, integrator="energy_momentum", every=1):
        model, state = dj.build(scene)
        return model, _run(dj.make_stepper(model, integrator, halvings=0), model, state, dt, steps, every)[1]

    return make


@pytest.fixture(scope="session")
def in_water():
    """`in_water(model, r, v, t)`: one instant with its water."""

    def make(model, r, v, t):
        k = model.kinematics(jnp.asarray(r), jnp.asarray(v), jnp.asarray(t))
        return model.kinematics(k.r, k.v, k.t, prepared=model.prepare(k))

    return make


@pytest.fixture(scope="session")
def afloat():
    """`afloat(shapes, mass, ...)`: a rigid body in water and, far below it, a light rope that does not touch it."""

    def afloat(shapes, *, mass, centre, inertia, sea=None, position=(0.0, 0.0, 0.0), run=None, **body):
        own = {"mass": 1e-3, "diameter": 1e-3, "axial": {"law": "rope", "EA": 1e3}}
        afloat = {"name": "float", "position": list(position), "mass": mass, "centre_of_mass": list(centre)}
        return parts.system(
            [parts.fixed("a", 0.0, 0.0, -50.0), parts.fixed("b", 1.0, 0.0, -50.0)],
            [parts.line_of("rope", "a", "b", 2, 2.0, **own)],
            run={"dt": 0.02, "duration": 20.0, **(run or {})},
            body=[{**afloat, "inertia": list(inertia), **shapes, **body}],
            sea={"depth": 100.0, **(sea or {})},
            start={"kind": "points"},
        )

    return afloat


@pytest.fixture(scope="session")
def spar(afloat):
    """`spar(diameter, height, draught, centre, ...)`: an upright cylinder that floats at its draught."""

    def spar(diameter=1.0, height=9.0, draught=5.0, centre=2.0, *, slices=40, ends="from", coefficients=None, **scene):
        mass = 1025.0 * np.pi / 4 * diameter**2 * draught
        turned = mass * height**2 / 12.0
        cylinder = {"from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, height], "diameter": diameter}
        cylinder |= {"slices": slices, "ends": ends, **(coefficients or {})}
        return afloat(
            {"cylinders": [cylinder]},
            mass=mass,
            centre=(0.0, 0.0, centre),
            inertia=(turned, turned, mass * diameter**2 / 8.0),
            **{"position": (0.0, 0.0, -draught), **scene},
        )

    return spar
