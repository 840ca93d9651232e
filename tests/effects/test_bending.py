"""Bending stiffness against the beam's closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax import equilibrium
from dropper_jax.effects import Bending
from dropper_jax.run.build import build
from dropper_jax.run.simulate import simulate


def beam(links, weight=0.1, EI=1e4):
    """A pinned beam of 10 m, so stiff that its own tension does not carry."""
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [{"name": "rod", "mass": weight / 9.81, "diameter": 0.02, "EA": 1e4, "law": "elastic"}],
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [10.0, 0.0, 0.0]}],
        "line": [{"name": "beam", "from": "a", "to": "b", "type": "rod", "length": 10.0, "links": links}],
        "effects": {"weight": {}, "bending": {"EI": EI}},
    }


def test_a_pinned_beam_sags_by_5_w_l4_over_384_ei():
    exact = 5 * 0.1 * 10.0**4 / (384 * 1e4)
    error = []
    for links in (8, 16):
        pose = equilibrium(beam(links))
        assert pose.status == "ok", pose.message
        error.append(abs(-np.min(pose.positions[:, 2]) / exact - 1))
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(4.0, abs=0.3)


def test_energy_of_a_bent_circle_is_ei_over_2_r2_per_length_and_the_force_its_gradient():
    radius, links = 5.0, 100
    model, _ = build({**beam(links), "effects": {"weight": {}, "bending": {"EI": 200.0}}})
    turn = np.linspace(0.0, 10.0 / radius, links + 1)
    circle = radius * np.stack([np.sin(turn), 0 * turn, 1 - np.cos(turn)], axis=1)
    model_at = model.kinematics(jnp.asarray(circle[1:-1]), jnp.zeros((links - 1, 3)), jnp.zeros(()))
    bending = model.effect("bending")
    assert isinstance(bending, Bending)
    # the two half links at pinned ends carry no moment; the last node is the scene's, off the circle: leave both out
    energy = jax.jit(lambda r: bending.potential(model.kinematics(r, 0 * r, jnp.zeros(()))))
    inner = float(energy(model_at.r))
    ends = model_at.nodes[-2:] - model_at.nodes[-3:-1]
    unit = ends / np.linalg.norm(ends, axis=1, keepdims=True)
    last = 200.0 / (2 * 0.1) * float(jnp.sum((unit[1] - unit[0]) ** 2))
    assert inner - last == pytest.approx(200.0 / (2 * radius**2) * 10.0 * (links - 2) / links, rel=1e-3)
    force, size = bending.force(model_at), 1e-6
    for node, axis in ((10, 0), (50, 2), (97, 1)):
        shift = jnp.zeros_like(model_at.r).at[node, axis].set(size)
        slope = (energy(model_at.r + shift) - energy(model_at.r - shift)) / (2 * size)
        assert float(force[node, axis]) == pytest.approx(-float(slope), rel=1e-5, abs=1e-4)


def test_a_line_with_bending_runs_and_keeps_its_energy():
    scene = beam(4, weight=20.0, EI=200.0)
    scene["point"][1] |= {"position": [9.9, 0.0, 0.0], "kind": "free", "mass": 1.0}
    scene["start"] = {"kind": "points"}
    solution = simulate(scene, dt=0.005, duration=0.5)
    assert solution.status == "ok", solution.failure
    # the axial law takes what it cannot resolve; bending itself is of second order, not exact
    assert solution.energy_drift < 5e-2 * solution.energy_scale
    assert np.max(np.diff(solution.balance)) < 1e-4 * solution.energy_scale
