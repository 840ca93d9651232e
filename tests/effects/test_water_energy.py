"""Energy: what water takes and gives is booked; still water never gives where the equations do not."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj

RHO = 1000.0
#: Without retries the programs compile in half the time; a step that needed one would fail the test.
simulate = partial(dj.simulate, halvings=0)

SAME = {"can": 1.0, "cat": 1.0}
LAGRANGIAN = {"can": 1.0, "cat": 0.0, "added_mass": "lagrangian"}


def chain(effects: dict, sea: dict | None = None, duration: float = 60.0, dt: float = 0.02, **run) -> dict:
    """Seven links in water, from a bent pose at rest, undamped but for the given effects."""
    polar = [1.2, 1.0, 0.9, 0.7, 0.4, 0.1, -0.2]
    return system(
        [fixed("top", 0.0, 0.0, -3.0), free("end", 0.0, 0.0, -6.5)],
        [line_of("line", "top", "end", 7, 0.5, mass=3.0, diameter=0.06)],
        run={"dt": dt, "duration": duration, "save_every": 5, **run},
        effects={"weight": {}, "buoyancy": {}, **effects},
        start={"kind": "angles", "zero": "down", "polar": polar, "azimuth": [0.1 * i for i in range(7)]},
        sea={"depth": 30.0, "density": RHO, **(sea or {})},
    )


def stored(solution: dj.Solution) -> np.ndarray:
    """Kinetic energy with that of the added mass, and potential energy of weight and buoyancy [J]."""
    lift = solution.work[:, solution.work_names.index("buoyancy")]
    return solution.energy - lift


def swing(solution: dj.Solution) -> float:
    """Swing energy at the start: potential energy in water above the straight chain [J]."""
    z = solution.positions[0, 1:, 2] + 3.0
    return float((3.0 - RHO * np.pi / 4 * 0.06**2 * 0.5) * 9.81 * np.sum(z + 0.5 * np.arange(1, 8)))


@pytest.mark.check
@pytest.mark.parametrize("inertia", [SAME, pytest.param(LAGRANGIAN, marks=pytest.mark.check)])
def test_added_mass_conserves_energy_in_still_water(inertia):
    solution = simulate(chain({"morison_inertia": inertia}))
    assert solution.status == "ok"
    assert np.ptp(stored(solution)) < 1e-9 * swing(solution)


def test_morisons_turning_added_mass_makes_energy_and_its_power_is_booked():
    solution = simulate(chain({"morison_inertia": {"can": 1.0, "cat": 0.0}}))
    assert solution.status == "ok"
    assert np.ptp(stored(solution)) > 0.03 * swing(solution)
    turning = solution.work[:, solution.work_names.index("morison_inertia_turning")]
    assert np.max(np.abs(stored(solution) - stored(solution)[0] - turning)) < 1e-9 * swing(solution)


@pytest.mark.check
@pytest.mark.parametrize("inertia", [SAME, LAGRANGIAN])
def test_energy_never_rises_in_still_water_with_drag(inertia):
    effects = {"morison_inertia": inertia, "morison_drag": {"cdn": 1.2, "cdt": 0.05}}
    solution = simulate(chain(effects, duration=20.0, save_every=1))
    assert solution.status == "ok"
    assert np.max(np.diff(stored(solution))) < 1e-12 * swing(solution)
    assert stored(solution)[-1] < stored(solution)[0] - 0.9 * swing(solution)


@pytest.mark.check
def test_the_power_balance_closes_in_waves_through_the_surface():
    waves = {"kind": "spectrum", "hs": 1.5, "tp": 6.0, "count": 20}
    effects = {"morison_inertia": {"can": 1.0, "cat": 0.1}, "morison_drag": {"cdn": 1.2, "cdt": 0.05}}
    scene = chain(effects, {"waves": waves, "current": {"speed": 0.5}}, dt=0.03)
    for point in scene["point"]:
        point["position"][2] += 3.0
    solution = simulate(scene)
    assert solution.status == "ok"
    assert solution.energy_drift < 1e-6 * solution.energy_scale


@pytest.mark.check
def test_the_booked_power_is_the_force_times_the_velocity(in_water):
    """An independent quadrature of drag times velocity over the saved states, fourth order, agrees with the entry."""
    effects = {"morison_inertia": SAME, "morison_drag": {"cdn": 1.2, "cdt": 0.05}}
    sea = {"depth": 6.0, "waves": {"kind": "regular", "amplitude": 0.5, "period": 5.0}}
    scene = chain(effects, sea, 4.0, 0.002, save_every=1)
    solution = simulate(scene)
    model, _ = dj.build(scene)

    def power(r, v, t):
        return jnp.sum(model.effect("morison_drag").force(in_water(model, r, v, t)) * v)

    states = (jnp.asarray(a) for a in (solution.positions[:, 1:], solution.velocities[:, 1:], solution.t))
    powers = jax.jit(jax.vmap(power))(*states)
    work = np.trapezoid(powers, solution.t)
    assert solution.warnings[0].startswith("sea.depth: the line can reach down to z = -6.5 m")
    booked = solution.work[-1, solution.work_names.index("morison_drag")]
    assert booked == pytest.approx(work, rel=1e-4)
