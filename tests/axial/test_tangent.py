"""Law of slack ropes in derivatives: the run is unchanged, and taut ropes keep their exact derivatives."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.axial import SmoothTangent


def hanging(high: float) -> dj.Scene:
    """A weight on two links below a fixed point, at a height [m] above its rest."""
    points = [
        {"name": "top", "position": [0.0, 0.0, 0.0]},
        {"name": "middle", "kind": "free", "position": [0.0, 0.0, -0.5 + 0.5 * high], "mass": 0.1},
        {"name": "weight", "kind": "free", "position": [0.0, 0.0, -1.0 + high], "mass": 1.0},
    ]
    rope = {"name": "rope", "mass": 1e-6, "diameter": 0.01, "EA": 1e4}
    line = {"type": "rope", "length": 0.5, "links": 1}
    return dj.load_scene(
        {
            "name": "hanging",
            "run": {"dt": 0.001, "duration": 0.1},
            "line_type": [rope],
            "point": points,
            "line": [
                {"name": "upper", "from": "top", "to": "middle", **line},
                {"name": "lower", "from": "middle", "to": "weight", **line},
            ],
            "effects": {"weight": {"gravity": 9.81}},
            "start": {"kind": "points"},
        }
    )


def slope(high: float, tangent: SmoothTangent | None) -> tuple[float, float]:
    """Height of the weight after 0.05 s, and its derivative by all stiffnesses."""
    model, start = dj.build(hanging(high))
    stepper = replace(dj.make_stepper(model, track_work=False).plain, tangent=tangent)

    def height(stiffer: jax.Array) -> jax.Array:
        axial = replace(model.line.axial, EA=stiffer * model.line.axial.EA)
        changed = replace(model, lines=(replace(model.line, axial=axial),))
        return dj.integrate(stepper, changed, start, 0.001, 50, warn=False)[0].r[1, 2]

    value, found = jax.jit(lambda x: jax.jvp(height, (x,), (1.0,)))(1.0)
    return float(value), float(found)


@pytest.mark.check
def test_a_tangent_law_leaves_the_run_and_taut_ropes_unchanged():
    for high, taut in ((-0.01, True), (0.02, False)):
        exact, smooth = slope(high, None), slope(high, SmoothTangent())
        assert smooth[0] == exact[0]
        assert np.isfinite(smooth[1])
        assert (abs(smooth[1] - exact[1]) <= 1e-9 * abs(exact[1])) == taut
