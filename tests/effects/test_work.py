"""The energy balance that the work of each effect closes."""

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.model import work_names

RELEASE = "dropper-release-a-undamped"
END_MOTION = {"point": "right", "amplitude": [0.03, 0.01, 0.02], "period": 1.1, "ramp": 0.503}


@pytest.mark.parametrize(
    ("scene", "effects"),
    [
        (RELEASE, {"linear_damping": {"b_l": 0.01}, "quadratic_damping": {"b_q": 0.02}}),
        (RELEASE, {"nodal_force": {"nodes": [3], "force_n": [[0.1, 0.2, 0.0]], "rise": 0.5, "release": 1.2}}),
        (RELEASE, {"joint_friction": {"viscous": 2e-4}}),
        (RELEASE, {"end_motion": END_MOTION}),
        ("dropper-release-a-compound-undamped", {"end_motion": END_MOTION}),
    ],
    ids=["damping", "nodal force", "viscous joints", "moving end", "moving end of compound links"],
)
def test_work_of_each_effect_closes_the_energy_balance_to_rounding(scene, effects):
    changed = {f"effects.{name}.{key}": value for name, values in effects.items() for key, value in values.items()}
    solution = dj.simulate(dj.load_scene(scene).with_values(changed), dt=0.01, duration=2.0, halvings=0)
    assert solution.status == "ok"
    assert set(solution.work_names) == {name.replace("end_motion", "moving_ends") for name in effects}
    assert np.max(np.abs(solution.work[-1])) > 1e-4
    assert solution.energy_drift < 1e-11


def test_an_elastic_line_loses_what_its_internal_damping_takes_and_never_gains(chain):
    start = {"kind": "positions", "positions": [[0, 0, 0.0], [0.2, 0.1, -0.2], [0.4, 0, 0.0]]}
    axial = {"law": "elastic", "EA": 40.0, "damping": 0.2}
    scene = chain([0.25, 0.25], 0.1, start, right=[0.4, 0.0, 0.0], axial=axial)
    solution = dj.simulate(scene, dt=0.002, duration=1.0)
    assert solution.work_names == work_names(dj.build(scene)[0]) == ("internal_damping", "axial_ringing")
    assert np.ptp(solution.balance) < 1e-12
    damping, ringing = solution.work.T
    assert np.all(np.diff(damping) <= 0.0)
    assert np.max(np.abs(ringing)) < 1e-3 * np.ptp(damping)  # its inertia stores energy and returns it
