"""The ringing force of the default scheme: what it takes of axial vibrations, and how perturbations of a run grow."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_weight

import dropper_jax as dj
from dropper_jax.axial.elastic import UNRESOLVED_FREQUENCY
from dropper_jax.model import state

LENGTH, WEIGHT, G = 10.0, 100.0, 10.0


def hanging(EA, rope, links):
    """A rope of `rope` [kg/m] with a weight of 100 kg below."""
    kind = {"mass": rope, "diameter": 0.03, "EA": EA, "law": "rope"}
    return hung_weight(WEIGHT, kind, LENGTH, links, effects={"weight": {"gravity": G}})


def taut(EA, rope, links, angle, speed):
    """Model and state of that rope, straight at this angle [rad] to the vertical, its end at `speed` [m/s] along it."""
    model, _ = dj.build(hanging(EA, rope, links))
    along = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    share = np.append(np.arange(1, links) / links, 1.0)[:, None]
    tension = WEIGHT * G * np.cos(angle)
    stretched = LENGTH * (1.0 + tension / EA)
    return model, state(model, stretched * share * along, speed * share * along, np.full(links, tension))


def run(model, h, steps, s):
    return dj.integrate(dj.make_stepper(model, track_work=False).plain, model, s, h, steps)


def test_a_resolved_mode_of_unresolved_links_has_the_damping_ratio_of_third_order():
    turn, h, steps = 0.3, 0.02, 3000
    EA = WEIGHT * LENGTH * (turn / h) ** 2
    model, s = taut(EA, 0.01, 2, 0.0, 0.01)
    _, path = jax.jit(partial(run, model, h, steps))(s)
    assert not np.any(path.failed)
    swing = np.abs(np.asarray(path.tension[:, -1]) - WEIGHT * G)
    window = 210  # 10 periods
    lost = np.log(np.max(swing[:window]) / np.max(swing[-window:]))
    # of the lower link: the upper half of its mass is at a free node, of half a link's mass on either side
    highest = 2.0 * EA / (LENGTH / 2.0) * (1.0 / (0.01 * LENGTH / 2.0))
    weight = (1.0 - UNRESOLVED_FREQUENCY**2 / (highest * h**2)) ** 2
    assert lost == pytest.approx(weight * turn**3 / 48.0 * turn * (steps - window), rel=0.1)


@pytest.mark.parametrize("h", [0.1, *(pytest.param(h, marks=pytest.mark.check) for h in (0.03, 0.01))])
def test_perturbations_of_a_swinging_taut_rope_do_not_grow(h):
    # 1 kg/m and 1e6 N: the links vibrate with 1400 rad/s
    model, s = taut(1e6, 1.0, 5, 0.4, 0.0)
    push = jnp.asarray(1e-3 * np.random.default_rng(0).normal(size=s.r.shape))
    steps = int(20.0 / h)

    def moved(r):
        return run(model, h, steps, replace(s, r=r))[1].r

    path, change = jax.jit(lambda r, push: jax.jvp(moved, (r,), (push,)))(s.r, push)
    size = np.sqrt(np.sum(np.asarray(change) ** 2, axis=(1, 2)))
    quarter = steps // 4
    grown = np.log(np.max(size[-quarter:]) / np.max(size[:quarter]))
    assert grown / (0.75 * 20.0) < 0.1
    assert np.all(np.isfinite(path))
