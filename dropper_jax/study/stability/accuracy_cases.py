"""Steps that are too large, single precision, and one bad member of a batch."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.load.source import load_scene
from dropper_jax.run.build import build
from dropper_jax.run.simulate import simulate
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.integrate import integrate
from dropper_jax.study.schemes import Scheme
from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.runner import run_case
from dropper_jax.study.step_choice import choose_step

TOLERANCE = 1e-2
BATCH = 64


def _too_large(short: bool) -> Outcome:
    """At 10 times the advised step, with the same tolerance: 0 if the status reports that it is not met."""
    scene = load_scene("dropper-release-a-undamped").with_values({"run.duration": 2.0})
    dt = 10 * choose_step(scene, TOLERANCE).dt
    found = simulate(scene, dt=dt, tolerance=TOLERANCE)
    return Outcome(float(found.status == "ok"), found.status, (scene, dt, 2.0))


def _single(short: bool) -> Outcome:
    scene = load_scene("dropper-release-a-undamped")
    ran = run_case(scene, 0.01, 5.0 if short else 50.0, Scheme("energy_momentum", dtype="float32"))
    return Outcome(ran.relative_drift, ran.status)


def _bad_member(short: bool) -> Outcome:
    """Members, of the 63 good ones, whose positions differ in any bit from those in a batch without the bad one."""
    model, s = build("dropper-release-a-undamped")
    stepper = make_stepper(model)
    rng = np.random.default_rng(0)
    v = jnp.asarray(0.01 * rng.standard_normal((BATCH, *s.v.shape)))
    steps = 20 if short else 200

    @jax.jit
    def last(v: jax.Array) -> jax.Array:
        run = partial(integrate, stepper, model, dt=0.01, steps=steps, save_every=steps)
        return jax.vmap(lambda x: run(replace(s, v=x))[0].r)(v)

    good, spoiled = np.asarray(last(v)), np.asarray(last(v.at[17].set(jnp.nan)))
    others = np.delete(np.arange(BATCH), 17)
    differ = np.sum(np.any(good[others] != spoiled[others], axis=(1, 2)))
    return Outcome(float(differ), "ok" if np.all(np.isfinite(spoiled[others])) else "non_finite")


CASES = [
    Case("ten-times-the-step", "10 times the advised step: the status reports it (1: reported as ok)", 0.0, "-",
         _too_large, expected="not_converged"),
    Case("float32", "undamped dropper in float32, 50 s at dt 0.01 s: drift of the energy balance", 1e-3, "of the scale",
         _single),
    Case("one-bad-member", "one NaN member of a batch of 64: other members that change", 0.0, "members", _bad_member),
]  # fmt: skip
