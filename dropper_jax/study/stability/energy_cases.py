"""Hard motions without damping: the energy balance and the lengths of links show whether the runs are correct."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.study.stability import scenes
from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.runner import CaseRun, run_case

#: Drift of the energy balance over the energy scale that still counts as rounding: steps are solved to 1e-11, and this
#: is what that allows over 1000s of steps (measured: 1e-15 where Newton converges to rounding, 3e-9 in taut lines).
ROUNDING = 1e-8


def _energy(name: str, claim: str, make: Callable[[], Scene], dt: float, duration: float, brief: float) -> Case:
    """A case whose measure is the drift of the energy balance over the scale."""

    def measure(short: bool) -> Outcome:
        scene = make()
        span = brief if short else duration
        ran = run_case(scene, dt, span)
        return Outcome(ran.relative_drift, ran.status, (scene, dt, span))

    text = f"{claim}: {duration:g} s at dt {dt:g} s, drift of the energy balance"
    return Case(name, text, ROUNDING, "of the scale", measure)


@cache
def _ten_minutes(short: bool) -> CaseRun:
    return run_case(load_scene("dropper-release-a-undamped"), 0.02, 20.0 if short else 600.0)


def _ten_minutes_energy(short: bool) -> Outcome:
    ran = _ten_minutes(short)
    return Outcome(ran.energy_drift, ran.status, (load_scene("dropper-release-a-undamped"), 0.02, 10.0))


def _ten_minutes_closure(short: bool) -> Outcome:
    ran = _ten_minutes(short)
    return Outcome(ran.closure, ran.status)


def mass_ratio() -> Scene:
    """A node of 10 kg between nodes of 1 g, which whip at 200 Hz once the line is tight."""
    masses = [0.001] * scenes.LINKS
    masses[3] = 10.0
    return scenes.lifted_loop("mass-ratio", 0.3, 50.0, mass=masses)


def short_link() -> Scene:
    lengths = [1.0] * scenes.LINKS
    lengths[3] = 0.001
    return scenes.lifted_loop("short-link", 3.0, force=20.0, length=lengths, mass=1.0)


def large_release() -> Scene:
    """Pulled by 200 times its weight, straight up."""
    force = [[5.0, 0.0, 200 * 7 * 0.03 * GRAVITY]]
    return scenes.loop("large-release", 0.3, release_nodes=[3], release_force=force)


def turning() -> Scene:
    """A pendulum released exactly at the horizontal, a second one below it exactly at the vertical."""
    return scenes.chain("through-vertical-and-horizontal", [float(np.pi / 2), 0.0])


CASES = [
    _energy("hanging-kicked", "a string hanging straight down is kicked sideways", scenes.kicked_string, 0.005, 20, 2),
    _energy("vertical-and-horizontal", "links start exactly horizontal and vertical and pass both", turning,
            0.005, 20, 2),
    _energy("chaotic-double-pendulum", "chaotic double pendulum",
            lambda: load_scene("double-pendulum-chaotic"), 0.001, 50, 4),
    Case("ten-minutes-energy", "undamped dropper, 10 minutes at dt 0.02 s, drift of the energy balance", 1e-6, "J",
         _ten_minutes_energy),
    Case("ten-minutes-closure", "undamped dropper, 10 minutes at dt 0.02 s, error of the links' lengths", 1e-10, "m",
         _ten_minutes_closure),
    _energy("ends-at-the-same-point", "a loop with both ends at one point, released",
            lambda: scenes.lifted_loop("same-point", 0.0), 0.01, 20, 2),
    _energy("taut-plucked", "a loop with ends 0.999 of its length apart, plucked",
            lambda: scenes.lifted_loop("taut", 0.999 * 0.7, 2.0), 0.002, 5, 0.5),
    _energy("mass-ratio", "neighbouring masses 1 g and 10 kg",
            mass_ratio, 0.001, 5, 0.5),
    _energy("short-link", "one link of 1 mm among links of 1 m", short_link, 0.01, 20, 2),
    _energy("thousand-links", "1000 links, 100 m, released from the side", scenes.thousand_links, 0.01, 3, 0.4),
    _energy("large-release", "released from a force of 200 times the weight", large_release, 0.005, 10, 1),
    _energy("driven-at-resonance", "an end driven at the loop's own period, work of the end counted",
            scenes.driven, 0.01, 60, 4),
    _energy("whirling-loop", "a loop whirling at 30 rad/s", scenes.whirling, 0.002, 10, 1),
]  # fmt: skip
