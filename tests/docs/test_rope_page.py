"""The section on a rope in your own program: its code runs, its gradient is right, and eight devices give the same."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
(SECTION,) = re.findall(r"^## A rope in your own program$(.*?)(?=^## )", PAGE.read_text(), re.M | re.S)
#: The code of the section, with a batch that a test can afford.
BLOCKS = [text.replace("4096", "64") for text in re.findall(r"```python\n(.*?)```", SECTION, re.S)]
ON_EIGHT = "import json; print(json.dumps([paths.tolist(), len(paths.sharding.device_set)]))"


@pytest.fixture(scope="module")
def page():
    names: dict[str, object] = {}
    for text in BLOCKS:
        exec(compile(text, PAGE.name, "exec"), names)
    return names


@pytest.mark.check
def test_the_gradients_are_those_of_differences(page):
    # the rope goes slack and taut again: changes of 1e-4 move such an event to another step
    step = 1e-5
    for distance, slope in (
        (lambda kick: page["value_and_slope"](kick)[0], page["slope"]),
        (lambda stiffer: page["float_value_and_slope"](stiffer)[0][0], page["float_slope"]),
    ):
        difference = (distance(1.0 + step) - distance(1.0 - step)) / (2.0 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-6)


@pytest.mark.check
def test_adaptive_steps_keep_the_path_of_the_float(page):
    controller = page["diffrax"].PIDController(rtol=1e-3, atol=1e-3)
    path = page["drift"](1.0, controller=controller)[1]
    np.testing.assert_allclose(path, page["float_path"], rtol=0, atol=2e-3)


@pytest.mark.check
def test_the_float_and_the_batch_hold_and_the_network_learns_the_drag(page):
    assert not page["batch_failed"].any()
    assert np.abs(page["float_path"][-1] - page["float_path"][-50]).max() < 0.1  # the float comes to rest
    assert page["losses"][-1] < 0.01 * page["losses"][0]


@pytest.mark.check
def test_eight_devices_give_the_numbers_of_one(page):
    code = "\n".join([BLOCKS[0].split("value_and_slope =")[0], BLOCKS[2], ON_EIGHT])
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=8"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    paths, devices = json.loads(done.stdout.splitlines()[-1])
    assert devices == 8
    np.testing.assert_allclose(np.array(paths), page["paths"], rtol=0, atol=1e-12)
