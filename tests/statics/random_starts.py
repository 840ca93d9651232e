"""Static starts of random lifted droppers: is an equilibrium found for each?

Two kinds of draws: the rigs of `random_droppers`, and lifted droppers of uneven links between hooks at different
heights, pulled up and sideways at up to three nodes."""

import numpy as np
from random_droppers import GRAVITY, draw_rig

import dropper_jax as dj


def uneven(seed: int) -> dj.Scene:
    """A lifted dropper of uneven links between hooks at different heights."""
    rng = np.random.default_rng([seed, 322])
    links = int(rng.integers(3, 13))
    length, mass = rng.uniform(0.05, 0.16, links), rng.uniform(0.02, 0.05, links)
    gap, tilt = rng.uniform(0.05, 0.9) * length.sum(), rng.uniform(-1.0, 1.0)
    lifted = min(int(rng.integers(1, 4)), links - 1)
    nodes = sorted(int(i) for i in rng.choice(np.arange(1, links), lifted, replace=False))
    lift = rng.uniform(0.2, 1.2, lifted) * mass.sum() * GRAVITY
    side = rng.uniform(-0.6, 0.6, lifted)
    force = np.stack([lift * np.sin(side), np.zeros(lifted), lift * np.cos(side)], axis=1)
    hook = {"name": "left", "position": [0.0, 0.0, 0.0]}
    end = {"name": "right", "position": [float(gap * np.cos(tilt)), 0.0, float(gap * np.sin(tilt))]}
    line = {"name": "rig", "from": "left", "to": "right", "links": links}
    return dj.load_scene(
        {
            "run": {"dt": 0.002, "duration": 1.0},
            "point": [hook, end],
            "line": [line | {"length": length.tolist(), "mass": mass.tolist()}],
            "effects": {"weight": {}},
            "start": {"kind": "static", "release_nodes": nodes, "release_force": force.tolist()},
        }
    )


def scene_of(kind: str, seed: int) -> dj.Scene:
    """The start of a seed."""
    return uneven(seed) if kind == "uneven" else draw_rig(seed, np.random.default_rng([seed, 36])).scene


def status_of(kind: str, seed: int) -> str:
    """How the search ends."""
    return dj.equilibrium(scene_of(kind, seed)).status
