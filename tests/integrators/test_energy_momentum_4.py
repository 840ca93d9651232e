"""The energy-momentum scheme composed to fourth order."""

import numpy as np
import pytest

import dropper_jax as dj


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("energy_momentum_4", (7, 8, 9)) == pytest.approx(4.0, abs=0.3)


@pytest.mark.check
@pytest.mark.parametrize("name", ["double, plane", "double, spherical", "three rods, plane", "two rods, spherical"])
def test_it_follows_lagranges_equations_to_a_micrometre(motion_error, name):
    assert motion_error("energy_momentum_4", name, 10_000) < 1e-6


@pytest.mark.check
def test_on_lines_that_stretch_it_has_its_order():
    x = np.linspace(0.0, 3.0, 5)
    nodes = np.stack([x, 0.1 * x, -0.4 * np.sin(np.pi * x / 3.0)], axis=1)
    rope = {"length": 0.8, "mass": 0.5, "axial": {"law": "elastic", "EA": 3000.0, "damping": 5.0}}
    scene = {
        "run": {"dt": 0.001, "duration": 0.2, "integrator": "energy_momentum_4"},
        "point": [{"name": name, "position": list(nodes[i])} for name, i in (("a", 0), ("b", -1))],
        "line": [{"name": "rope", "from": "a", "to": "b", "links": 4, **rope}],
        "effects": {"weight": {}},
        "start": {"kind": "positions", "positions": nodes.tolist()},
    }
    last = [dj.simulate(scene, dt=h).positions[-1] for h in (0.004, 0.002, 0.001, 0.00025)]
    coarse, middle, fine = (np.max(np.abs(one - last[-1])) for one in last[:-1])
    assert np.log2([coarse / middle, middle / fine]) == pytest.approx([4.0, 4.0], abs=0.3)
