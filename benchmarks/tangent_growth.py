"""Growth of the exact tangent of runs at constant steps, in steps in which no link is slack: e-folds per second.

    python benchmarks/tangent_growth.py edulis-longline bay.toml --dt 0.1 0.03 0.01 --seconds 20

A run whose tangent grows has no usable derivatives, and its rounding errors grow as fast. The tangent starts in a
random direction. It is measured by `|dr|^2 + (0.1 s |dv|)^2`, from a sixth of the time on.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dropper_jax as dj
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper, step

#: What a step passes on to the next one.
CARRIED = ("r", "v", "acceleration", "tension")
#: Steps of one compiled program.
CHUNK = 100
#: Tension [N] below which a link is slack.
SLACK = 1e-6


@partial(jax.jit, static_argnums=0)
def march(stepper: Stepper, model: Model, start: tuple[State, Any], h: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
    """State and tangent after `CHUNK` steps; of each step the growth (e-folds) and the lowest tension [N]."""

    def advance(carry: tuple[State, Any], _: None) -> tuple[Any, tuple[jax.Array, ...]]:
        s, tangent = carry

        def following(*values: jax.Array) -> tuple[Any, State]:
            after, _ = step(stepper, model, replace(s, **dict(zip(CARRIED, values, strict=True))), h)
            return tuple(getattr(after, name) for name in CARRIED), after

        values = tuple(getattr(s, name) for name in CARRIED)
        _, tangent, after = jax.jvp(following, values, tangent, has_aux=True)
        size = jnp.sqrt(jnp.sum(tangent[0] ** 2) + 0.01 * jnp.sum(tangent[1] ** 2))
        return (after, jax.tree.map(lambda x: x / size, tangent)), (jnp.log(size), jnp.min(after.tension))

    return jax.lax.scan(advance, start, None, length=CHUNK)


def growth(name: str, dt: float, seconds: float) -> tuple[float, float]:
    """E-folds per second in taut steps, and seconds of them."""
    scene = dj.load_scene(name)
    model, s = dj.build(scene)
    stepper = dj.make_stepper(model, track_work=False).plain
    direction = 1e-3 * np.random.default_rng(0).normal(size=s.r.shape)
    tangent = tuple(jnp.zeros_like(getattr(s, name)) for name in CARRIED)
    carry = jax.tree.map(jnp.asarray, s), (jnp.asarray(direction), *tangent[1:])
    rows = []
    for _ in range(int(np.ceil(seconds / dt / CHUNK))):
        carry, row = march(stepper, model, carry, jnp.asarray(dt))
        rows.append(row)
    grown, tension = (np.concatenate(column) for column in zip(*rows, strict=True))
    taut = (tension > SLACK) & (dt * np.arange(len(grown)) > seconds / 6)
    time = float(dt * np.sum(taut))
    return float(np.sum(grown[taut])) / max(time, dt), time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--dt", nargs="+", type=float, default=[0.1, 0.03, 0.01], help="[s]")
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    for name in args.scenes:
        for dt in args.dt:
            rate, time = growth(name, dt, args.seconds)
            print(f"{name}  dt {dt:g} s  {rate:+.3f} e-folds per second in {time:.1f} s of taut steps", flush=True)


if __name__ == "__main__":
    main()
