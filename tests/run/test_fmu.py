"""Units of FMI 3.0: driven both ways by another master they are `Coupled` to the bit; needs pythonfmu3 and FMPy."""

import shutil

import numpy as np
import pytest
from scene_parts import line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.coupling.fmu import plain_names, write_fmu

ENDS = {"port side": [0.0, -1.0, -1.0], "starboard": [0.0, 1.0, -1.0]}
SCENE = scene_of(
    {"anchor": [-60.0, 0.0, -20.0], **ENDS},
    *(line_of(name, "anchor", name, 5, 65.0, type="chain") for name in ENDS),
    run={"dt": 0.02, "duration": 1.0},
    line_type=[{"name": "chain", "mass": 20.0, "diameter": 0.06, "EA": 2e7, "damping_ratio": 0.5, "cdn": 1.2}],
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {}, "seabed": {"stiffness": 1e5}},
    sea={"depth": 20.0},
)
POINTS = list(ENDS)
NAMES = [f"{name}_{letter}{axis}" for letter in ("", "v") for name in ("port_side", "starboard") for axis in "xyz"]
FORCES = [f"{name}_f{axis}" for name in ("port_side", "starboard") for axis in "xyz"]


@pytest.mark.filterwarnings("default")
def test_a_floating_body_on_a_unit_moves_as_on_coupled_lines(tmp_path):
    pytest.importorskip("pythonfmu3")
    fmpy = pytest.importorskip("fmpy")
    fmi3 = pytest.importorskip("fmpy.fmi3")
    file = write_fmu(SCENE, tmp_path / "mooring.fmu", POINTS)
    about = fmpy.read_model_description(str(file))
    number = {variable.name: variable.valueReference for variable in about.modelVariables}
    assert about.fmiVersion == "3.0"
    assert set(number) == {"time", *NAMES, *FORCES}
    folder = fmpy.extract(str(file))
    name = about.coSimulation.modelIdentifier
    unit = fmi3.FMU3Slave(guid=about.guid, unzipDirectory=folder, modelIdentifier=name, instanceName="lines")
    lines = dj.Coupled(SCENE, POINTS)
    home = np.array([lines.scene.point(name).position for name in POINTS])
    try:
        unit.instantiate()
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        ask = lambda: np.array(unit.getFloat64([number[n] for n in FORCES])).reshape(2, 3)  # noqa: E731
        np.testing.assert_array_equal(ask(), lines.init())
        mass, dt, place, speed = 8000.0, 0.1, np.zeros(3), np.array([0.5, 0.0, 0.2])
        rest = ask().sum(axis=0)
        for i in range(20):  # the body takes its force from the unit, the unit its motion from the body
            speed = speed + dt * (ask().sum(axis=0) - rest - 4e4 * place) / mass
            place = place + dt * speed
            motion = np.stack([home + place, np.tile(speed, (2, 1))])
            unit.setFloat64([number[n] for n in NAMES], list(motion.ravel()))
            unit.doStep(currentCommunicationPoint=i * dt, communicationStepSize=dt)
            np.testing.assert_array_equal(ask(), lines.step(*motion, dt))
        assert np.linalg.norm(ask().sum(axis=0) - rest) > 100.0
        unit.terminate()
        unit.freeInstance()
    finally:
        shutil.rmtree(folder)


def test_names_that_become_the_same_are_refused():
    assert plain_names(["port side", "B1"]) == ["port_side", "B1"]
    with pytest.raises(SceneError, match="'a b' and 'a-b' both become 'a_b'"):
        plain_names(["a b", "a-b"])
