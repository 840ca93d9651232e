"""Energy bookkeeping on a motion whose energies and powers are known in closed form."""

from types import SimpleNamespace

import numpy as np

from dropper_jax.analysis import balance_drift, effect_power, energy_table


def test_power_is_the_rate_of_work():
    """A mass of 2 kg with v = exp(-t), braked by F = -2 v: power -2 exp(-2 t), work exp(-2 t) - 1; a fan adds 3 W."""
    t = np.linspace(0.0, 2.0, 201)
    work = np.column_stack([np.exp(-2 * t) - 1.0, 3.0 * t])
    power = effect_power(SimpleNamespace(kinetic=np.exp(-2 * t), work=work, work_names=("brake", "fan")), t)
    middle = 0.5 * (t[1:] + t[:-1])
    np.testing.assert_allclose(power["brake"], -2 * np.exp(-2 * middle), rtol=2e-5)  # (2 dt)^2/24 of the midpoint rule
    np.testing.assert_allclose(power["fan"], 3.0, rtol=1e-12)


def test_energy_table_of_a_fall_with_drag_closes():
    # 2 kg fall from rest with 4 m/s^2 net of a drag that takes 5.81 of 9.81 m/s^2.
    t = np.linspace(0, 1, 11)
    fall, speed = 2 * t**2, 4 * t
    work = np.stack([-2 * 5.81 * fall, 0 * t], axis=1)
    run = SimpleNamespace(
        kinetic=speed**2, potential=-2 * 9.81 * fall, work=work, work_names=("linear_damping", "moving_ends")
    )
    table = energy_table(run)
    assert table["initial"] == {"kinetic": 0.0, "potential": 0.0, "total": 0.0}
    np.testing.assert_allclose(table["final"]["total"], 16 - 39.24)
    np.testing.assert_allclose(table["work"]["linear_damping"], -23.24)
    assert table["work"]["moving_ends"] == 0.0
    np.testing.assert_allclose(table["scale"], 39.24)
    assert table["drift"]["largest"] < 1e-13
    assert table["relative_drift"] < 1e-14


def without_work(kinetic, potential):
    work = np.zeros((len(kinetic), 0))
    return SimpleNamespace(kinetic=np.array(kinetic), potential=np.array(potential), work=work, work_names=())


def test_energy_table_of_a_run_that_blew_up_has_no_finite_drift():
    assert not np.isfinite(energy_table(without_work([1.0, np.inf], [0.0, -np.inf]))["relative_drift"])


def test_balance_drift_shows_energy_that_no_work_explains():
    run = without_work([1.0, 1.5, 1.2], [0.0, 0.0, 0.0])
    np.testing.assert_allclose(balance_drift(run), [0.0, 0.5, 0.2])
    table = energy_table(run)
    np.testing.assert_allclose([table["drift"]["final"], table["drift"]["largest"]], [0.2, 0.5])
    assert table["work"] == {}
