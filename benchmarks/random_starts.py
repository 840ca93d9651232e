"""Static starts of random lifted droppers: is an equilibrium found for each?

    python benchmarks/random_starts.py [--seeds 0:300]

Two kinds of draws: the rigs of `random_droppers`, and lifted droppers of uneven links between hooks at different
heights, pulled up and sideways at up to three nodes. Each row has the status, the largest compression of a link, and
whether the equilibrium is stable in space or within its plane only. Writes results/random_starts.json.
"""

import numpy as np
from random_droppers import GRAVITY, draw_rig
from study import Found, collect, command

import dropper_jax as dj
from dropper_jax.statics.rest_problem import rest
from dropper_jax.statics.system import stable

KINDS = ("of random droppers", "uneven")


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


def found_start(kind: str, seed: int) -> Found:
    """A row: how the search ends."""
    scene = scene_of(kind, seed)
    pose = dj.equilibrium(scene)
    at_rest = rest(dj.build_model(scene))
    return {
        **{"seed": seed, "links": scene.lines[0].links, "status": pose.status, "message": pose.message},
        **{"residual": float(pose.residual), "least_tension_n": float(pose.tension.min())},
        "stable_in_space": stable(at_rest, pose.state),
    }


@command(seeds="0:300")
def main(args) -> None:
    seeds = range(*map(int, args.seeds.split(":")))
    collect("random_starts", {kind: (found_start(kind, seed) for seed in seeds) for kind in KINDS})
