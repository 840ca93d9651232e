"""The whole search on the packaged site, by the command: limits met, less material, gone on with after a stop."""

import json

import numpy as np
import pytest

from dropper_jax import simulate
from dropper_jax.scene import whole_lines
from fitting.farm.optimise.run import optimise
from fitting.farm.site import read_site


class StoppedError(Exception):
    pass


def stopping(fraction, text):
    """Progress of somebody who stops the search once a step was taken."""
    if text.startswith("objective"):
        raise StoppedError


@pytest.mark.check
def test_the_packaged_site_is_designed_after_a_stop_and_its_whole_storm_keeps_the_limits(tmp_path, json_of):
    state, picture = tmp_path / "design.json", tmp_path / "design.png"
    with pytest.raises(StoppedError):
        optimise(read_site("small-longline"), state, stopping)
    before = json.loads(state.read_text())
    assert before["before"]["constraints"]
    found = json_of(["optimise", "small-longline", "--state", str(state), "--plot", str(picture), "--json", "--quiet"])
    assert found["status"] == "ok"
    assert found["gain"] >= 0.1
    assert max(after for _, after in found["constraints"].values()) <= 1.0
    assert picture.stat().st_size > 10_000
    # the whole storm by `simulate`, which knows nothing of windows, factors and soft peaks
    site = read_site("small-longline")
    values = {v["path"]: x for v, x in zip(found["variables"], found["after"], strict=True)}
    scene = site.prepared(site.scene.with_values(values))
    solution = simulate(scene)
    assert solution.status == "ok"
    counted = solution.t > site.run.skip
    for line in whole_lines(scene):
        used = 3.0 * solution.tension[counted][:, line.links] / np.min(line.spec.breaking_load)
        assert np.max(used) <= 1.0 + 1e-6
