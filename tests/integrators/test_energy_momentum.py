"""What the energy-momentum scheme keeps."""

import numpy as np
import pytest
from release_by_scipy import MASS

import dropper_jax as dj
from dropper_jax.model import work_names


@pytest.mark.parametrize(
    ("dt", "duration", "drift"), [(0.01, 50.0, 1e-9), (0.02, 600.0, 1e-6)], ids=["50 s", "10 minutes, coarse"]
)
def test_undamped_release_keeps_energy_and_lengths(dt, duration, drift):
    solution = dj.simulate("dropper-release-a-undamped", dt=dt, duration=duration, save_every=10)
    assert solution.status == "ok"
    assert solution.t[-1] == pytest.approx(duration)
    assert solution.energy_drift < drift
    assert solution.max_closure_error < 1e-10


@pytest.mark.parametrize(
    "scene", ["dropper-release-a-compound-undamped", pytest.param("string", marks=pytest.mark.check)]
)
def test_compound_links_and_free_ends_keep_energy_to_rounding(scene):
    solution = dj.simulate(scene, dt=0.01, duration=10.0, halvings=0)
    assert solution.status == "ok"
    assert solution.energy_drift < 1e-10 * solution.energy_scale
    assert solution.max_closure_error < 1e-10


def test_energy_of_a_solution_is_that_of_its_masses_heights_and_speeds():
    """At rest and at the first saved times, from positions alone (central differences for the speed)."""
    solution = dj.simulate("dropper-release-a-undamped", dt=0.0005, duration=0.1)
    r = solution.positions[:, 1:-1]
    speed = np.linalg.norm(r[2:] - r[:-2], axis=-1) / 0.001
    kinetic = 0.5 * np.sum(MASS * speed**2, axis=1)
    potential = 9.81 * np.sum(MASS * r[..., 2], axis=1)
    np.testing.assert_allclose(solution.potential, potential, rtol=1e-12)
    np.testing.assert_allclose(solution.kinetic[1:-1], kinetic, atol=1e-4 * np.max(kinetic))


def test_loss_of_energy_is_the_work_of_the_damping():
    solution = dj.simulate("dropper-release-a", dt=0.01, duration=20.0)
    assert solution.work_names == work_names(dj.build(solution.scene)[0]) == ("linear_damping", "quadratic_damping")
    assert solution.energy_drift < 1e-9
    assert np.all(np.diff(solution.work, axis=0) <= 0)
    assert np.all(np.diff(solution.energy) <= 1e-12)


# --- axial vibrations: a mass on one link, h omega over its steps; the link's own limit is Omega = 2 omega ---

RING_STEP = 1e-2


def ring_stiffness(turn):
    """EA [N] of the link of `ring` on which its mass turns by `turn` [rad] per step."""
    return 0.5 * 0.4 * (turn / RING_STEP) ** 2


def test_unresolved_axial_vibrations_shrink_by_the_root_of_two_fifths_per_step(ring):
    # EA -> infinity: the factors per step are the roots of (y + 1/3) (y^2 + y + 2/5), 1/3 and sqrt(2/5) in size
    swing = ring("energy_momentum", ring_stiffness(1000.0), RING_STEP, 12)
    predicted = -4 / 3 * swing[2:-1] - (1 / 3 + 2 / 5) * swing[1:-2] - 2 / 15 * swing[:-3]
    np.testing.assert_allclose(swing[3:] / np.abs(predicted).max(), predicted / np.abs(predicted).max(), atol=1e-4)
    assert np.max(np.abs(swing[-3:])) < 0.05 * np.max(np.abs(swing[:3]))


def test_a_resolved_axial_vibration_is_not_damped_and_has_the_frequency_of_second_order(ring):
    turn, steps = 0.2, 1000
    swing = ring("energy_momentum", ring_stiffness(turn), RING_STEP, steps)
    # the midpoint scheme turns by 2 atan(omega h/2) per step; steps that resolve a line have no ringing force
    scheme = 2.0 * np.arctan(0.5 * turn)
    assert scheme == pytest.approx(turn * (1.0 - turn**2 / 12.0), abs=0.02 * turn**3)
    expected = np.cos(scheme * (np.arange(steps) + 0.5))
    np.testing.assert_allclose(swing / np.max(swing), expected, atol=2e-3)
