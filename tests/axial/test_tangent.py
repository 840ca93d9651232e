"""Law of slack ropes in derivatives: runs and taut ropes are unchanged, slack ones forget, both modes agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.axial import DampedRope, Tabulated

DT = 0.004
STEPS = 250
#: Height [m] from which the chain is dropped, that it snaps; or a stretch, with which it stays taut.
DROPPED = 0.05
STRETCHED = -0.0035
#: Of a table of tensions, for two links.
ROWS = jnp.array([[0.0, 1.0]] * 2)


def hanging(high: float) -> dj.Scene:
    """A weight on four links of rope below a fixed point, at a height [m] above its rest."""
    links = 4
    length = 0.4
    rope = {"law": "rope", "EA": 2e4, "damping": 20.0}
    end = (links * length - high) * np.array([0.06, 0.0, -1.0]) / np.hypot(0.06, 1.0)
    positions = np.linspace(np.zeros(3), end, links + 1)
    ends = [fixed("top", 0.0, 0.0, 0.0), free("end", *positions[-1].tolist(), mass=3.0)]
    lines = [line_of("l", "top", "end", links, length, mass=0.5, axial=rope)]
    start = {"kind": "positions", "positions": positions.tolist()}
    return dj.load_scene(system(ends, lines, dt=DT, duration=STEPS * DT, start=start))


def height_of(high: float, tangent: dj.SlackTangent | None) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Mean height of the weight by a factor on all masses, and tensions (steps, links)."""
    model, start = dj.build(hanging(high))
    stepper = dj.make_stepper(model, track_work=False, halvings=0, tangent=tangent)

    def height(heavier: jax.Array) -> tuple[jax.Array, jax.Array]:
        changed = replace(model, lines=(replace(model.line, mass=heavier * model.line.mass),))
        rows = dj.integrate(stepper, changed, start, DT, STEPS, warn=False)[1]
        return jnp.mean(rows.r[:, -1, 2]), rows.tension

    return height


@cache
def forward(high: float, tangent: dj.SlackTangent | None) -> tuple[float, float, np.ndarray]:
    """Height, its derivative in forward mode, tensions."""
    height = height_of(high, tangent)
    (value, tension), (slope, _) = jax.jit(lambda x: jax.jvp(height, (x,), (1.0,)))(1.0)
    return float(value), float(slope), np.asarray(tension)


@pytest.mark.check
def test_the_law_of_derivatives_leaves_runs_unchanged():
    for high in (STRETCHED, DROPPED):
        value, _, tension = forward(high, dj.SlackTangent())
        assert value == forward(high, None)[0]
        assert np.any(tension == 0.0) == (high == DROPPED)


def test_derivatives_of_taut_ropes_are_exact():
    exact = forward(STRETCHED, None)[1]
    assert forward(STRETCHED, dj.SlackTangent())[1] == pytest.approx(exact, rel=1e-9)


def test_both_modes_agree_where_ropes_are_slack():
    reverse, _ = jax.jit(jax.grad(height_of(DROPPED, dj.SlackTangent()), has_aux=True))(1.0)
    assert float(reverse) == pytest.approx(forward(DROPPED, dj.SlackTangent())[1], rel=1e-8)


@pytest.mark.parametrize("law", [DampedRope, partial(Tabulated, strain=ROWS, force=ROWS, slope=ROWS)])
def test_kinds_of_rope_with_laws_of_their_own_keep_their_derivatives(law):
    rope = law(jnp.ones(2), jnp.ones(2))
    assert rope.with_tangent(dj.SlackTangent()) is rope
