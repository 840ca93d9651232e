"""Derivatives of a run with respect to what water depends on, through the surface: forward, reverse, differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, line_of, system

import dropper_jax as dj
from dropper_jax.sea.make import waves_on
from dropper_jax.sea.spectrum import components

NAMES = ("cdn", "can", "diameter", "hs", "tp", "direction", "current")
AT = jnp.array([1.1, 0.8, 0.08, 1.2, 6.0, 0.4, 0.5])
WATER = {"morison_drag": {"cdn": 1.1, "cdt": 0.05}, "morison_inertia": {"can": 0.8, "cat": 0.1}}
SEA = {"depth": 15.0, "waves": {"kind": "spectrum", "hs": 1.2, "tp": 6.0, "count": 8}}
SCENE = system(
    [fixed("a", 0, 0, 0.3), fixed("b", 1.0, 0.2, 0.2)],
    [line_of("l", "a", "b", 5, 0.5, mass=4.0, diameter=0.08)],
    dt=0.04,
    effects={"weight": {}, "buoyancy": {}, **WATER},
    sea=SEA | {"current": {"speed": 0.5}, "wave_current": "doppler"},
)


@pytest.mark.check
def test_gradients_agree_forward_reverse_and_with_differences_through_the_surface(slopes_of):
    model, state = dj.build(SCENE)
    stepper = dj.make_stepper(model, halvings=0)

    def changed(p):
        values = dict(zip(NAMES, p, strict=True))
        effects = tuple(
            replace(e, **{key: values[key] for key in ("cdn", "can") if hasattr(e, key)}) for e in model.effects
        )
        line = replace(model.line, diameter=values["diameter"] * jnp.ones(5))
        current = replace(model.sea.current, speed=values["current"])
        drawn = components(values["hs"], values["tp"], values["direction"], depth=15.0, count=8)
        sea = replace(model.sea, current=current, waves=waves_on(drawn, 15.0, current=current))
        return replace(model, effects=effects, lines=(line,), sea=sea)

    def final(factors):
        s, _ = dj.integrate(stepper, changed(factors * AT), state, 0.04, 40)
        return jnp.sum(s.r * jnp.array([1.0, -0.7, 0.4])) + 0.1 * jnp.sum(s.v[:, 2])

    slopes = slopes_of(final, jnp.ones(len(NAMES)), 1e-5, rel=1e-5)
    assert np.all(np.abs(slopes / AT) > 1e-6)


def test_gradients_are_finite_where_water_and_line_are_at_rest(in_water):
    model, state = dj.build({**SCENE, "sea": {"depth": 15.0}})

    @jax.jit
    @jax.grad
    def slope(r, v):
        k = in_water(model, r, v, state.t)
        return jnp.sum(model.force(k) + model.inertia(k, v))

    assert np.all(np.isfinite(slope(state.r, state.v)))
