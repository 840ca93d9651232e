"""Froude's law: a rig at another size moves in the same way, so that no constant with a unit hides in the code."""

import copy
import re

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.load.paths import describe, locate

#: Size of the larger rig. A power of four: times are scaled by a power of two, and nothing is rounded.
SIZE = 4.0
#: Powers of mass, length and time of the units that scenes declare.
DIMENSIONS = {"kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "N": (1, 1, -2), "Pa": (1, -1, -2), "rad": (0, 0, 0)}
#: Units of the axial law, which a scene does not declare key by key.
AXIAL = {"EA": "N", "damping": "N s"}


def scale_of(unit: str) -> float:
    """Factor of a quantity by Froude's law: masses by the cube of the size, times by its root; g and rho remain."""
    power = np.zeros(3)
    above, _, below = unit.partition("/")
    for sign, factors in ((1, above), (-1, below)):
        for name, exponent in re.findall(r"([A-Za-z]+)\^?(\d*)", factors):
            power += sign * int(exponent or 1) * np.array(DIMENSIONS[name])
    return SIZE ** (3 * power[0] + power[1] + 0.5 * power[2])


def enlarged(scene: dict) -> dict:
    """The scene at `SIZE` times its size."""
    large = copy.deepcopy(scene)
    for path, steps in locate(scene).items():
        key = steps[-1]
        unit = AXIAL.get(key) if "axial" in steps else describe(path).get("unit")
        given = table_at(scene, steps[:-1])
        if unit and key in given:
            table_at(large, steps[:-1])[key] = (np.asarray(given[key]) * scale_of(unit)).tolist()
    return large


def table_at(scene: dict, steps: tuple) -> dict:
    """The table of a scene at these steps; an empty one where it has none."""
    for step in steps:
        if isinstance(scene, dict) and step not in scene:
            return {}
        scene = scene[step]
    return scene


@pytest.mark.parametrize(
    ("name", "duration", "off"),
    [
        ("dropper-release-a", 0.5, 0.0),
        ("dropper-north-sea", 1.0, 0.0),
        ("ballasted-spar", 0.5, 1e-10),  # sines of other arguments are rounded otherwise
    ],
)
def test_a_run_at_four_times_the_size_is_the_same_run(name, duration, off):
    scene = dj.load_scene(name).to_dict()
    small = dj.simulate(scene, duration=duration)
    large = dj.simulate(enlarged(scene), duration=duration * SIZE**0.5)
    for key, unit in (("positions", "m"), ("velocities", "m/s"), ("tension", "N"), ("kinetic", "N m")):
        expected = getattr(small, key) * scale_of(unit)
        np.testing.assert_allclose(getattr(large, key), expected, rtol=0.0, atol=off * np.max(np.abs(expected)))
