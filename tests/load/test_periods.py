"""Steps and intervals that follow from the periods of a scene."""

import numpy as np
import pytest

from dropper_jax import load_scene
from dropper_jax.load.periods import periods, suggest_step


@pytest.mark.parametrize(("gravity", "longer"), [(9.81 / 4, 2.0), (0.0, np.inf)])
def test_links_swing_under_the_gravity_of_their_scene(gravity, longer):
    scene = load_scene("dropper-release-a")
    changed = scene.with_values({"effects.weight.gravity": gravity})
    assert periods(changed)["swing"] == pytest.approx(longer * periods(scene)["swing"], rel=1e-3)
    assert suggest_step(changed) >= suggest_step(scene)
