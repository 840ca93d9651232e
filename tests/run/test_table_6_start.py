"""The paper's cases from its Table 6: where they start, and what the first seconds and the largest load are."""

import numpy as np
import pytest
from moordyn_runs import looks_at
from scipy.optimize import brentq

import dropper_jax as dj

#: Table 6 [m].
ANCHOR, BUOY = (0.0, 0.0, -30.0), (30.0, 0.0, -4.43)
#: Of Table 4: chain [kg/m, m], its length [m]; weight in water [N/m].
MASS, DIAMETER, LENGTH = 10.910, 0.042, 50.0
WET = 9.81 * (MASS - 1025.0 * np.pi / 4 * DIAMETER**2)


@pytest.mark.parametrize("number", range(1, 6))
def test_a_case_from_table_6_has_the_poses_of_the_table_and_the_rest_of_its_case(number):
    placed, case = (dj.load_scene(f"paper-case-{number}{end}") for end in ("-table-6", ""))
    assert [tuple(point.position) for point in placed.points] == [ANCHOR, BUOY]
    assert placed.with_values({"start.kind": "static"}).to_dict() | {"description": "", "name": ""} == (
        case.to_dict() | {"description": "", "name": ""}
    )


@pytest.mark.check
def test_the_chain_of_table_6_rests_on_its_catenary_until_the_buoy_is_released():
    rise = BUOY[2] - ANCHOR[2]

    def hanging(a):  # length and span of a catenary with H = a WET from the bed up to the buoy
        return np.sqrt(rise**2 + 2 * a * rise), a * np.arccosh(1 + rise / a)

    a = brentq(lambda a: LENGTH - hanging(a)[0] + hanging(a)[1] - BUOY[0], 0.1, 100.0)
    grounded = LENGTH - hanging(a)[0]
    run = dj.simulate(
        dj.load_scene("paper-case-1-table-6").with_values({"line.chain.links": 48}), dt=0.02, duration=0.02
    )
    x, z = run.positions[0, :, 0], run.positions[0, :, 2]
    expected = ANCHOR[2] + a * (np.cosh(np.maximum(x - grounded, 0.0) / a) - 1.0)
    np.testing.assert_allclose(z, expected, atol=0.05)
    assert run.tension[0, 0] == pytest.approx(a * WET, rel=0.01)
    assert not run.velocities[0].any()


@pytest.mark.check
def test_the_buoy_leaves_table_6_as_in_moordyn():
    pytest.importorskip("moordyn", reason="the moordyn wheel is not installed (extra `moordyn`)")
    scene = dj.load_scene("paper-case-4-table-6")
    run = dj.simulate(scene, duration=8.0)
    theirs = looks_at(scene, 0.0005, 8.0, 0.0005, (), [(1, True)])
    assert theirs.status == "ok"
    # MoorDyn's chain rests without the current until then
    for axis, apart in ((0, 0.10), (2, 0.05)):
        expected = np.interp(run.t, theirs.t, theirs.position[:, 0, axis])
        np.testing.assert_allclose(run.positions[:, -1, axis], expected, atol=apart * np.ptp(expected))


@pytest.mark.check
def test_drag_along_the_buoys_side_leaves_the_largest_load_of_table_7():
    # Table 7's largest loads of case 4 are 1535 and 1558 N, without the overshoot of a buoy that bobs up from Table 6:
    # its drag along, on the base alone here, has to work on its whole side of pi D w
    scene = dj.load_scene("paper-case-4-table-6")
    draught, diameter = 3.27, 0.79
    run = dj.simulate(scene.with_values({"buoy.spar.cdt": 0.40 * 4.0 * draught / diameter}), duration=150.0)
    largest = run.tension[:, 0].max()
    assert 0.99 * 1535.0 < largest < 1.01 * 1558.0
    assert dj.simulate(scene, duration=10.0).tension[:, 0].max() > 2000.0
