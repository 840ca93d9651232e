"""Rigid bodies that tumble, fall into the water and roll over: the energy balance shows whether the run is correct."""

from __future__ import annotations

from typing import Any

from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.run.simulate import simulate
from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.energy_cases import ROUNDING


def beside_a_rope(name: str, body: dict[str, Any], **more: Any) -> Scene:
    """A body that no line holds; scenes have a line, which is far off."""
    rope = {"length": 2.0, "mass": 1.0, "diameter": 0.02, "axial": {"law": "rope", "EA": 1e4}}
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 1.0},
            "point": [{"name": "a", "position": [50.0, 0.0, -5.0]}, {"name": "b", "position": [53.0, 0.0, -5.0]}],
            "line": [{"name": "rope", "from": "a", "to": "b", "links": 2, **rope}],
            "body": [body],
            "start": {"kind": "points"},
            **more,
        }
    )


def tumbling() -> Scene:
    """A body turned about its middle axis, about which it turns over and over."""
    body = {"name": "stone", "position": [0.0, 0.0, 0.0], "mass": 10.0, "centre_of_mass": [0.1, 0.2, -0.3]}
    motion = {"inertia": [1.0, 2.0, 3.0], "angular_velocity": [0.01, 3.0, 0.01]}
    return beside_a_rope("tumbling-body", {**body, **motion}, effects={"weight": {"gravity": 0.0}})


def dropped_spar() -> Scene:
    """A ballasted spar released horizontally 3 m above the water: it falls in, submerges, surfaces and rights
    itself."""
    cylinder = {"from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, 6.0], "diameter": 0.8, "slices": 4, "cdn": 0.0, "can": 0.0}
    body = {
        "name": "spar",
        "position": [0.0, 0.0, 3.0],
        "attitude": [0.1, 1.4, 0.0],
        "mass": 1500.0,
        "centre_of_mass": [0.0, 0.0, 1.2],
        "inertia": [4000.0, 4000.0, 120.0],
        "cylinders": [cylinder],
    }
    return beside_a_rope("dropped-spar", body, sea={"depth": 50.0}, effects={"weight": {}})


def _energy(make: Any, dt: float, span: float, brief: float) -> Any:
    def measure(short: bool) -> Outcome:
        ran = simulate(make(), dt=dt, duration=brief if short else span)
        return Outcome(ran.energy_drift / ran.energy_scale, ran.status)

    return measure


CASES = [
    Case("tumbling-body", "a rigid body turns over and over about its middle axis, 60 s at dt 0.01 s, drift of the "
         "energy balance", ROUNDING, "of the scale", _energy(tumbling, 0.01, 60.0, 4.0)),
    Case("dropped-spar", "a ballasted spar falls lying into the water, goes under and rights itself, 30 s at dt "
         "0.01 s, drift of the energy balance", 1e-4, "of the scale", _energy(dropped_spar, 0.01, 30.0, 3.0)),
]  # fmt: skip
