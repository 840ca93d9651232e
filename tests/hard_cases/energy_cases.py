"""Hard motions without damping, whose energy balance and lengths of links show whether runs are correct; gradients."""

from typing import Any

import hard_scenes as scenes
import numpy as np
from rows import exact, row

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene

#: Drift of the energy balance over the energy scale that still counts as rounding: steps are solved to 1e-11, and this
#: is what that allows over 1000s of steps (measured: 1e-15 where Newton converges to rounding, 3e-9 in taut lines).
ROUNDING = 1e-8
#: Maximum duration of the thesis' schemes [s]: failures occur early.
BASELINE = 10.0
UNDAMPED = "dropper-release-a-undamped"
STEPS = 40


def _energy(name: str, claim: str, scene: Scene | str, dt: float, duration: float, brief: float) -> dict:
    """A case whose measure is the drift of the energy balance over the scale."""
    text = f"{claim}: {duration:g} s at dt {dt:g} s, drift of the energy balance"
    baseline = min(duration, BASELINE)
    return row(name, text, ROUNDING, "of the scale", "relative drift", scene, dt, duration, brief, baseline=baseline)


def _gradient(name: str, scene: Scene | str, dt: float) -> dict:
    claim = f"{name}: derivative after {STEPS * dt:g} s against central differences"
    return row(f"gradient-{name}", claim, 1e-6, "relative", "derivative", scene, dt, STEPS * dt)


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
    return scenes.loop("large-release", 0.3, release_nodes=[3], release_force=[[5.0, 0.0, 200 * 7 * 0.03 * GRAVITY]])


def turning() -> Scene:
    """A pendulum released exactly at the horizontal, a second one below it exactly at the vertical."""
    return scenes.chain("through-vertical-and-horizontal", [float(np.pi / 2), 0.0])


G = GRAVITY


def overdamped_pendulum() -> Scene:
    """A pendulum of 1 m and 1 kg at 1 rad; critical is b = 2 m sqrt(g/L)."""
    heavy = {"weight": {}, "linear_damping": {"b_l": 1000 * 2 * float(np.sqrt(G))}}
    return scenes.chain("heavy-damping", [1.0], effects=heavy)


def _creeping(t: np.ndarray) -> np.ndarray:
    """`tan(theta/2) = tan(theta0/2) exp(-m g t / (b L))`, the motion without inertia (a share of 1e-6 here).

    Drag that stops a node within the step acts at its end, the weight in its middle: half a step late, 8e-5 of the way.
    """
    rate = G / (1000 * 2 * np.sqrt(G))
    theta = 2 * np.arctan(np.tan(0.5) * np.exp(-rate * t))
    return np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=-1)


def fast() -> Scene:
    """Without weight, at 20 m/s round a circle."""
    return scenes.chain("fast-drag", [0.3], effects={"quadratic_damping": {"b_q": 0.5}}, polar_rate=[20.0])


def sticky(polar: list[float]) -> Scene:
    """Links of 1 m and 1 kg with dry joints, released at these angles [rad]: they swing slightly and stick."""
    friction = {"weight": {}, "joint_friction": {"dry": 1.0, "axis": [0.0, 1.0, 0.0]}}
    return scenes.chain("dry-friction", polar, effects=friction)


def loop_at_rest() -> Scene:
    """A loop at rest in its equilibrium with quadratic damping."""
    return scenes.loop("at-rest", 0.3, effects={"linear_damping": {"b_l": 0.01}, "quadratic_damping": {"b_q": 0.01}})


def _saved(*spans: float) -> np.ndarray:
    """The 40 saved times of runs of these durations [s]."""
    return np.unique(np.round(np.concatenate([span / 40 * np.arange(1, 41) for span in spans]), 9))


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    creeps = exact(_saved(40.0, 400.0), _creeping)
    # `v(t) = v0 / (1 + b v0 t / m)`.
    slows = exact(_saved(0.4, 4.0), lambda t: 20.0 / (1 + 0.5 * 20.0 * t))
    same_point = scenes.lifted_loop("same-point", 0.0)
    taut = scenes.lifted_loop("taut", 0.999 * 0.7, 2.0)
    driven = scenes.driven()
    whirling = scenes.whirling()

    energy = [
        _energy(
            "hanging-kicked", "a string hanging straight down is kicked sideways", scenes.kicked_string(), 0.005, 20, 2
        ),
        _energy(
            "vertical-and-horizontal",
            "links start exactly horizontal and vertical and pass both",
            turning(),
            0.005,
            20,
            2,
        ),
        _energy("chaotic-double-pendulum", "chaotic double pendulum", "double-pendulum-chaotic", 0.001, 50, 4),
        row(
            "ten-minutes-energy",
            "undamped dropper, 10 minutes at dt 0.02 s, drift of the energy balance",
            1e-6,
            "J",
            "energy drift",
            UNDAMPED,
            0.02,
            600.0,
            20.0,
            baseline=BASELINE,
        ),
        row(
            "ten-minutes-closure",
            "undamped dropper, 10 minutes at dt 0.02 s, error of the links' lengths",
            1e-10,
            "m",
            "closure",
            UNDAMPED,
            0.02,
            600.0,
            20.0,
        ),
        _energy("ends-at-the-same-point", "a loop with both ends at one point, released", same_point, 0.01, 20, 2),
        _energy("taut-plucked", "a loop with ends 0.999 of its length apart, plucked", taut, 0.002, 5, 0.5),
        _energy("mass-ratio", "neighbouring masses 1 g and 10 kg", mass_ratio(), 0.001, 5, 0.5),
        _energy("short-link", "one link of 1 mm among links of 1 m", short_link(), 0.01, 20, 2),
        _energy("thousand-links", "1000 links, 100 m, released from the side", scenes.thousand_links(), 0.01, 3, 0.4),
        _energy("large-release", "released from a force of 200 times the weight", large_release(), 0.005, 10, 1),
        _energy(
            "driven-at-resonance",
            "an end driven at the loop's own period, work of the end counted",
            driven,
            0.01,
            60,
            4,
        ),
        _energy("whirling-loop", "a loop whirling at 30 rad/s", whirling, 0.002, 10, 1),
    ]

    damping = [
        row(
            "heavy-damping-position",
            "damping 1000 times critical at dt 0.1 s, 400 s: distance from the closed form",
            1e-4,
            "m",
            "distance of node",
            overdamped_pendulum(),
            0.1,
            400.0,
            40.0,
            exact=creeps,
            baseline=BASELINE,
        ),
        row(
            "heavy-damping-energy",
            "damping 1000 times critical at dt 0.1 s: largest rise of energy",
            0.0,
            "J",
            "rise of energy",
            overdamped_pendulum(),
            0.1,
            400.0,
            40.0,
        ),
        row(
            "quadratic-damping-fast",
            "quadratic damping from 20 m/s, 4 s at dt 0.002 s: error of the speed",
            1e-3,
            "relative",
            "error of speed",
            fast(),
            0.002,
            4.0,
            0.4,
            exact=slows,
            baseline=0.4,
        ),
        row(
            "dry-friction-stays",
            "a link with a dry joint comes to rest and stays: movement in 300 s",
            1e-12,
            "m",
            "stays",
            sticky([0.6]),
            0.002,
            320.0,
            30.0,
            baseline=BASELINE,
        ),
        row(
            "dry-friction-two-joints",
            "two links with dry joints come to rest and stay: movement in 300 s",
            1e-12,
            "m",
            "stays",
            sticky([0.6, 0.2]),
            0.002,
            320.0,
            30.0,
            baseline=BASELINE,
        ),
    ]

    accuracy = [
        row(
            "ten-times-the-step",
            "20 times the step of the scene: the status reports it (1: reported as ok)",
            0.0,
            "-",
            "too large a step",
            UNDAMPED,
            0.025,
            2.0,
            expected="step_too_long",
            baseline=2.0,
        ),
        row(
            "float32",
            "undamped dropper in float32, 50 s at dt 0.01 s: drift of the energy balance",
            1e-3,
            "of the scale",
            "relative drift",
            UNDAMPED,
            0.01,
            50.0,
            5.0,
            settings={"dtype": "float32"},
        ),
        row(
            "one-bad-member",
            "one NaN member of a batch of 64: other members that change",
            0.0,
            "members",
            "bad member",
            UNDAMPED,
            0.01,
            2.0,
            0.2,
        ),
    ]

    gradients = [
        _gradient("hanging-kicked", scenes.kicked_string(), 0.005),
        _gradient("vertical-and-horizontal", turning(), 0.005),
        _gradient("undamped-dropper", UNDAMPED, 0.01),
        _gradient("ends-at-the-same-point", same_point, 0.01),
        _gradient("taut-plucked", taut, 0.002),
        _gradient("mass-ratio", mass_ratio(), 0.0002),
        _gradient("short-link", short_link(), 0.01),
        _gradient("large-release", large_release(), 0.002),
        _gradient("driven-at-resonance", driven, 0.01),
        _gradient("whirling-loop", whirling, 0.002),
        _gradient("heavy-damping", overdamped_pendulum(), 0.1),
        _gradient("quadratic-damping-fast", fast(), 0.002),
        row(
            "gradient-at-rest",
            "a loop at rest: derivative by the masses, which move nothing",
            1e-9,
            "m",
            "derivative at rest",
            loop_at_rest(),
            0.01,
            0.4,
        ),
        row(
            "gradient-dry-friction",
            "dry friction: derivative is finite (0) or not (1)",
            0.0,
            "-",
            "derivative is finite",
            sticky([0.6, 0.2]),
            0.01,
            0.4,
        ),
    ]

    return [*energy, *damping, *accuracy, *gradients]
