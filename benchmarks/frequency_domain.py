"""Tensions of `dropper frequency` next to runs in time with the same wave components, of two longlines.

    python benchmarks/frequency_domain.py [--states N] [--rows]     # runs; --rows prints the stored table

The components are evenly spaced, so that the variance of a run over one period of their differences has no sampling
error. A run starts with a ramp of 15 s; the 45 s after it are left out.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from study import RESULTS, command, show, stored

import dropper_jax as dj

FILE = RESULTS / "frequency_domain.json"
SCENES = Path(dj.__file__).parent / "data" / "scenes"
#: Significant heights [m] and peak periods [s].
STATES = (
    *((0.5, 4.0), (0.5, 6.0), (1.0, 5.0), (1.0, 7.0), (1.5, 6.0), (1.5, 8.0)),
    *((2.0, 7.0), (2.0, 9.0), (2.5, 8.0), (3.0, 8.0), (3.0, 10.0), (4.0, 10.0)),
)
#: Scene: direction of the waves [rad], line ends that are compared.
LONGLINES = {"looped-longline": (0.0, ("west-leg", "backbone")), "edulis-longline": (-np.pi / 2, ("west-leg", "backbone"))}
#: Number of frequencies, end of the ramp and start of the compared part of a run [s].
COUNT, RAMP, START = 40, 15.0, 60.0


def scene_in(name: str, direction: float, hs: float, tp: float) -> dict[str, Any]:
    """Plain values of a scene with the sea of a state."""
    scene = tomllib.loads((SCENES / f"{name}.toml").read_text())
    waves = {"kind": "spectrum", "hs": hs, "tp": tp, "direction": direction, "count": COUNT, "frequencies": "even"}
    sea = {key: value for key, value in scene["sea"].items() if key != "packaged"}
    depth = sea.get("depth", 30.0)
    return {**scene, "name": name, "sea": {**sea, "depth": depth, "ramp": RAMP, "waves": waves}}


def run(name: str, direction: float, hs: float, tp: float) -> dict[str, Any]:
    """Mean, standard deviation, extremes and slack of each end of a line in time."""
    again = 2 * np.pi / (3.5 / COUNT * 2 * np.pi / tp)
    scene = dj.load_scene(scene_in(name, direction, hs, tp))
    solution = dj.simulate(scene, duration=START + again, save_every=2)
    inside = solution.t_tension > START
    tension = solution.tension[inside]
    return {"status": solution.status, "mean": tension.mean(0), "deviation": tension.std(0), "least": tension.min(0), "most": tension.max(0)}
