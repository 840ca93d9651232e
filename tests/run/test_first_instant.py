"""What a run says of its first instant and of its precision."""

import numpy as np
import pytest
from hard_scenes import hung_line
from scene_parts import line_of, scene_of

import dropper_jax as dj


def test_a_run_from_angles_starts_with_the_tension_of_its_first_instant():
    """A conical pendulum: `m g / sin(polar)` for a polar angle from the horizontal, at once and ever after."""
    scene = dj.load_scene("conical-pendulum")
    run = dj.simulate(scene, dt=0.01, duration=0.1)
    weight = scene.lines[0].mass[0] * 9.81
    np.testing.assert_allclose(run.tension[:, 0], weight / np.sin(scene.start.polar[0]), rtol=1e-6)


def test_a_run_from_points_starts_with_the_tension_of_its_lines_length():
    stretched = hung_line(1, 1.0, 0.1, nodes="shared", axial={"law": "rope", "EA": 5000.0})
    stretched["point"][1] |= {"position": [0.0, 0.0, -1.01], "mass": 2.0}
    stretched |= {"run": {"dt": 0.001, "duration": 0.01}, "start": {"kind": "points"}}
    assert dj.simulate(stretched).tension[0, 0] == pytest.approx(5000.0 * 0.01, rel=1e-12)


def test_held_points_with_nothing_free_between_them_are_refused():
    line = line_of("rope", "a", "b", 1, 0.9, mass=0.1, nodes="shared", axial={"law": "elastic", "EA": 5000.0})
    table = scene_of({"a": [0.0, 0.0, 0.0], "b": [1.0, 0.0, 0.0]}, line)
    with pytest.raises(dj.SceneError, match="line.0.links: 1 leaves no free node between fixed points"):
        dj.load_scene(table)


@pytest.mark.check
def test_precision_is_what_the_arrays_have(as_a_user):
    code = """
import json, os
os.environ["JAX_ENABLE_X64"] = "0"
import dropper_jax as dj
run = dj.simulate("conical-pendulum", duration=0.05)
print(json.dumps([run.settings["dtype"], str(run.positions.dtype), *run.warnings]))
"""
    dtype, array, *warnings = as_a_user(code)
    assert dtype == array == "float32"
    assert any("run.dtype: float64 was requested, but JAX computes in float32" in text for text in warnings)
