"""Energy bookkeeping on a motion whose energies and powers are known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropper_jax.analysis import balance_drift, effect_power, energy_table


@pytest.fixture
def braked() -> SimpleNamespace:
    """A mass of 2 kg with v = exp(-t), braked by F = -2 v: power -2 exp(-2 t), work exp(-2 t) - 1; a fan adds 3 W."""
    t = np.linspace(0.0, 2.0, 201)
    fan = 3.0 * t
    return SimpleNamespace(
        t=t,
        kinetic=np.exp(-2 * t),
        potential=fan,
        work=np.column_stack([np.exp(-2 * t) - 1.0, fan]),
        work_names=("brake", "fan"),
    )


def test_power_is_the_rate_of_work(braked):
    power = effect_power(braked, braked.t)
    middle = 0.5 * (braked.t[1:] + braked.t[:-1])
    np.testing.assert_allclose(power["brake"], -2 * np.exp(-2 * middle), rtol=2e-5)  # (2 dt)^2/24 of the midpoint rule
    np.testing.assert_allclose(power["fan"], 3.0, rtol=1e-12)


def test_balance_closes_where_energy_and_work_agree(braked):
    assert np.max(np.abs(balance_drift(braked))) < 1e-14
    table = energy_table(braked)
    assert table["work"]["fan"] == pytest.approx(6.0)
    assert table["scale"] == pytest.approx(6.0)


def test_missing_energy_is_seen_as_drift(braked):
    braked.kinetic = braked.kinetic - 0.01 * (braked.t > 1.0)
    assert energy_table(braked)["drift"]["largest"] == pytest.approx(0.01, rel=1e-9)
