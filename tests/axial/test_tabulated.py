"""Tension tabulated over strain: the curve, its energy, statics and modes at its rows, what is refused."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_weight

from dropper_jax import build_model, equilibrium, integrate, load_scene, make_stepper, natural_modes, state
from dropper_jax.axial import LinkStart, Rope, Tabulated
from dropper_jax.axial.force_table import ForceTable, stack_tables
from dropper_jax.model import work_names
from dropper_jax.stepping.observe import observe

STRAIN, TENSION = [0.02, 0.05, 0.10, 0.12, 0.20], [0.0, 300.0, 1300.0, 1300.0, 4500.0]
EVEN = {"law": "tabulated", "strain": [0.0, 0.05, 0.10, 0.15], "tension": [0.0, 300.0, 1000.0, 2500.0]}
TABLE = {"law": "tabulated", "strain": STRAIN, "tension": TENSION}


def law(*tables, damping=None):
    strain, force, slope = (jnp.asarray(x) for x in stack_tables(tables))
    return Tabulated(
        EA=jnp.array([t.stiffness for t in tables]), damping=damping, strain=strain, force=force, slope=slope
    )


def pull(axial, strain):
    """Tension of one link of 2 m over strain."""
    length = jnp.full(1, 2.0)
    return jax.vmap(lambda e: axial.spring(length * (1 + e), length)[0])(jnp.asarray(strain))


def test_curve_goes_through_its_rows_never_falls_and_has_a_continuous_slope():
    axial = law(ForceTable(np.array(STRAIN), np.array(TENSION)))
    np.testing.assert_allclose(pull(axial, STRAIN), TENSION, atol=1e-9)
    strain = np.linspace(-0.05, 0.25, 6001)
    found = np.asarray(pull(axial, strain))
    assert np.all(np.diff(found) >= -1e-9)
    assert np.all(found[strain < STRAIN[0] - 1e-9] == 0.0)
    beyond = strain > 0.2001  # the last secant goes on
    np.testing.assert_allclose(np.diff(found[beyond]) / np.diff(strain[beyond]), 3200.0 / 0.08, rtol=1e-6)
    slope = np.diff(found) / np.diff(strain)
    taut = strain[1:-1] > STRAIN[0] + 1e-4
    # a slope that jumped would differ by some 1e4 N between neighbours, however fine they are
    assert np.max(np.abs(np.diff(slope))[taut]) < 300.0


def test_stored_energy_is_the_integral_of_the_tension_also_of_tables_with_unequal_rows():
    axial = law(ForceTable(np.array(STRAIN), np.array(TENSION)), ForceTable.straight(2e4))
    length = jnp.array([2.0, 3.0])

    @jax.jit
    @jax.grad
    def slope(size):
        return axial.energy(jnp.zeros((2, 3)).at[:, 1].set(size), length)

    for strain in (-0.1, 0.03, 0.07, 0.11, 0.15, 0.3):
        size = length * (1 + strain)
        np.testing.assert_allclose(slope(size), axial.spring(size, length), rtol=1e-9, atol=1e-9)
    assert float(axial.spring(length * 1.3, length)[1]) == pytest.approx(2e4 * 0.3, rel=1e-12)


@pytest.mark.check
def test_two_rows_are_a_rope_of_that_stiffness_with_its_damper():
    damping = jnp.full(64, 50.0)
    table = law(*[ForceTable.straight(2e4)] * 64, damping=damping)
    rope = Rope(EA=jnp.full(64, 2e4), damping=damping)
    rng, length = np.random.default_rng(0), jnp.full(64, 1.5)
    d0, d1 = (jnp.asarray(1.5 * rng.uniform(0.4, 0.8, (64, 3))) for _ in range(2))
    start, h = LinkStart(d0, jnp.asarray(rng.uniform(-9.0, 9.0, (64, 3)))), jnp.asarray(0.01)
    # rows may differ away from their solutions, so these are compared
    law_of = lambda axial: jax.vmap(lambda T: axial.residual(start, d1, jnp.full(64, T), length, h))  # noqa: E731
    tensions = jnp.linspace(0.0, 2e4, 400_001)
    at = [tensions[jnp.argmin(jnp.abs(law_of(axial)(tensions)), axis=0)] for axial in (table, rope)]
    np.testing.assert_allclose(at[0], at[1], atol=0.1)
    assert 10 < int(jnp.sum(at[1] > 1.0)) < 54
    for name, given in (("tension", (d1, d0, length)), ("energy", (d1, length))):
        np.testing.assert_allclose(getattr(table, name)(*given), getattr(rope, name)(*given), rtol=1e-9, err_msg=name)
    works = [axial.works(start, d1, length, h) for axial in (table, rope)]
    for name in ("internal_damping", "axial_ringing"):
        assert float(works[1][name]) != 0.0
        np.testing.assert_allclose(works[0][name], works[1][name], rtol=1e-6, err_msg=name)


def hanging(kind, load):
    """A light line of 10 m with a weight of `load` [N] below."""
    light = {"mass": 1e-6, "diameter": 0.03, **kind}
    return hung_weight(load / 10.0, light, 10.0, 2, effects={"weight": {"gravity": 10.0}})


def test_hanging_weight_stretches_the_line_to_its_row_and_bounces_with_the_slope_there():
    scene = hanging(EVEN, 1000.0)
    pose = equilibrium(scene)
    assert pose.positions[-1, 2] == pytest.approx(-11.0, rel=1e-7)
    # rows at equal distances: the slope at a row is the harmonic mean of the secants beside it
    slope = 2.0 / (0.05 / 700.0 + 0.05 / 1500.0)
    omega = natural_modes(build_model(load_scene(scene)), pose.state).omega
    expected = np.sqrt(slope / 10.0 / 100.0)
    assert np.min(np.abs(omega / expected - 1)) < 1e-6


@pytest.mark.check
def test_a_weight_dropped_on_a_tabulated_line_keeps_its_energy_balance():
    model = build_model(load_scene(hanging(TABLE | {"damping": 200.0}, 1000.0)))
    node = model.geometry.point_node[1]
    s = state(model, np.where(np.arange(2)[:, None] == node, [0.0, 0.0, -10.0], [0.0, 0.0, -5.0]))
    path = jax.jit(partial(integrate, make_stepper(model), steps=200))(model, s, 0.02)[1]
    assert np.max(path.failed) == 0
    assert np.max(path.tension) > 2000.0
    seen = jax.jit(jax.vmap(partial(observe, model)))(path.r, path.v, 0.02 * jnp.arange(1, 201))
    work = dict(zip(work_names(model), np.asarray(path.work).T, strict=True))
    assert np.all(np.diff(work["internal_damping"]) <= 1e-9)
    assert np.max(np.abs(work["axial_ringing"])) < 0.02 * np.max(seen.kinetic)
    balance = np.asarray(seen.kinetic + seen.potential) - np.sum(path.work, axis=1)
    assert np.ptp(balance) < 1e-6 * np.max(seen.kinetic)


def test_rope_and_table_in_one_line_stretch_as_springs_in_a_row():
    scene = hanging(EVEN, 300.0)
    scene["line_type"].append({"name": "wire", "mass": 1e-6, "diameter": 0.01, "EA": 5e4})
    sections = [{"type": "rope", "length": 6.0, "links": 1}, {"type": "wire", "length": 4.0, "links": 1}]
    scene["line"] = [{"name": "line", "from": "top", "to": "weight", "sections": sections}]
    loaded = load_scene(scene)
    assert load_scene(loaded.to_dict()) == loaded
    assert equilibrium(loaded).positions[-1, 2] == pytest.approx(-(6.0 * 1.05 + 4.0 * (1 + 300.0 / 5e4)), rel=1e-7)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"strain": [0.0, 0.1, 0.1]}, "line_type.0.strain: [0.0, 0.1, 0.1] does not rise"),
        ({"strain": [-0.1, 0.1, 0.2]}, "does not rise from 0 or above"),
        ({"strain": [0.0, float("inf"), 0.2]}, "is not finite"),
        ({"strain": [0.0], "tension": [0.0]}, "too few rows"),
        ({"tension": [0.0, 5.0]}, "has 2 rows"),
        ({"tension": [0.0, 5.0, 4.0]}, "does not rise from 0"),
        ({"tension": [0.0, 5.0, 5.0]}, "rising at the end"),
        ({"EA": 1e4}, "line_type.0.EA: not used by law 'tabulated'"),
        ({"law": "rope"}, "line_type.0.EA: missing"),
        ({"tension": None}, "line_type.0.tension: missing"),
    ],
)
def test_a_table_that_cannot_be_used_is_named(changes, words, refusal):
    kind = {"law": "tabulated", "strain": [0.0, 0.1, 0.2], "tension": [0.0, 5.0, 20.0], **changes}
    assert words in refusal(load_scene, hanging({key: value for key, value in kind.items() if value is not None}, 1.0))
