"""What several test files share: scenes as plain values, and one compiled program per scheme for any step size."""

from functools import partial

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.integrate import begin


@partial(jax.jit, static_argnames=("stepper", "saves"))
def _march(stepper, model, s, dt, every, saves):
    def save(s, _):
        def one(_, carry):
            after, report = dj.step(stepper, model, carry[0], dt)
            return after, carry[1] & (report.residual <= stepper.limit(model))

        s, good = jax.lax.fori_loop(0, every, one, (s, True))
        return s, (s.r, s.v, s.tension, good)

    return jax.lax.scan(save, begin(stepper, model, s).state, None, length=saves)[1]


@pytest.fixture(scope="session")
def march():
    """`march(stepper, model, s, duration, steps, saves)`: saved r, v (saves, nodes, 3), T; every step must converge.

    The number of steps is an argument of the compiled program, so that all step sizes share one compilation.
    """

    def run(stepper, model, s, duration, steps, saves=1):
        assert steps % saves == 0
        r, v, tension, good = _march(stepper, model, s, duration / steps, steps // saves, saves)
        assert np.all(good), "a step did not converge"
        return np.asarray(r), np.asarray(v), np.asarray(tension)

    return run


@pytest.fixture(scope="session")
def chain():
    """`chain(lengths, masses, start, ...)`: the plain values of a scene with one line between `left` and `right`."""

    def make(length, mass, start, right=None, effects=None, dt=0.01, duration=1.0, **line):
        length = [float(x) for x in length]
        far = [sum(length), 0.0, 0.0] if right is None else right
        return {
            "run": {"dt": dt, "duration": duration},
            "point": [
                {"name": "left", "position": [0.0, 0.0, 0.0]},
                {"name": "right", "kind": "free" if right is None else "fixed", "position": far},
            ],
            "line": [
                {"name": "line", "from": "left", "to": "right", "links": len(length), "length": length, "mass": mass}
                | line
            ],
            "effects": {"weight": {}} if effects is None else effects,
            "start": start,
        }

    return make
