"""Sea states that cannot be: waves beyond breaking are refused before anything runs."""

from __future__ import annotations

from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.load.checks_water import SHALLOW, mean_period, steepest_sea
from dropper_jax.sea.make import make_sea
from dropper_jax.sea.spec import SeaSpec, WaveSpec


def check_breaking(site: Any) -> None:
    """Refuse a sea state beyond breaking at any level of the tide, by depth or by steepness.

    `Hs <= 0.6 (depth + level)`, and Hs at most that of the steepest seas of the mean period Tz (DNV-RP-C205, as
    `dropper sea` has it).

    Raises:
        SceneError: the sea state, its height, and the limit.
    """
    spec = site.scene.sea
    levels = [float(level) for level in site.lists.levels]
    for level in levels:
        if spec.depth + level <= 0.0:
            raise SceneError(f"cases.levels: {level:g} m lies below the bed; allowed: above {-spec.depth:g} m")
    lowest = min(levels)
    for i, state in enumerate(site.sea_states):
        if state.hs == 0.0:
            continue
        waves = WaveSpec.read(state.waves(0.0, 0), f"sea_state.{i}")
        sea = make_sea(SeaSpec(depth=spec.depth, density=spec.density, gravity=spec.gravity, waves=waves))
        tz = mean_period(sea)
        limits = {
            f"0.6 of the depth of {spec.depth + lowest:g} m at the level of {lowest:+g} m": SHALLOW
            * (spec.depth + lowest),
            f"the steepest seas of mean period {tz:.3g} s (DNV-RP-C205)": steepest_sea(tz, spec.gravity),
        }
        why, limit = min(limits.items(), key=lambda item: item[1])
        if state.hs > limit:
            raise SceneError(
                f"sea_state.{i}.hs: {state.name!r} of {state.hs:g} m breaks; allowed: at most {limit:.3g} m, {why}"
            )
