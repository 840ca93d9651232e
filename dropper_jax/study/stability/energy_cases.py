"""Hard motions without damping, whose energy balance and lengths of links show whether runs are correct; gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Effect, Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.build import build
from dropper_jax.run.simulate import simulate
from dropper_jax.stepping.integrate import integrate
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.march import Scheme
from dropper_jax.study.stability import scenes
from dropper_jax.study.stability.case import Case, CaseRun, Outcome, run_case
from dropper_jax.study.step_choice import choose_step

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
    return scenes.loop("large-release", 0.3, release_nodes=[3], release_force=[[5.0, 0.0, 200 * 7 * 0.03 * GRAVITY]])


def turning() -> Scene:
    """A pendulum released exactly at the horizontal, a second one below it exactly at the vertical."""
    return scenes.chain("through-vertical-and-horizontal", [float(np.pi / 2), 0.0])


ENERGY_CASES = [
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


G = GRAVITY


def overdamped_pendulum() -> Scene:
    """A pendulum of 1 m and 1 kg at 1 rad; critical is b = 2 m sqrt(g/L)."""
    heavy = {"weight": {}, "linear_damping": {"b_l": 1000 * 2 * float(np.sqrt(G))}}
    return scenes.chain("heavy-damping", [1.0], effects=heavy)


@cache
def _creeping(short: bool) -> CaseRun:
    return run_case(overdamped_pendulum(), 0.1, 40.0 if short else 400.0)


def _creep_position(short: bool) -> Outcome:
    """`tan(theta/2) = tan(theta0/2) exp(-m g t / (b L))`, the motion without inertia (a share of 1e-6 here).

    Drag that stops a node within the step acts at its end, the weight in its middle: half a step late, 8e-5 of the way.
    """
    ran = _creeping(short)
    rate = G / (1000 * 2 * np.sqrt(G))
    theta = 2 * np.arctan(np.tan(0.5) * np.exp(-rate * ran.t))
    exact = np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=-1)
    worst = np.max(np.linalg.norm(ran.run.r[:, 0] - exact, axis=-1))
    return Outcome(float(worst), ran.status, (overdamped_pendulum(), 0.1, 40.0))


def _creep_energy(short: bool) -> Outcome:
    """Largest rise of the height from one saved time to the next, as energy."""
    ran = _creeping(short)
    heights = np.concatenate([np.asarray(ran.start.r)[None], ran.run.r])[:, 0, 2]
    kinetic = 0.5 * np.sum(np.concatenate([np.asarray(ran.start.v)[None], ran.run.v])[:, 0] ** 2, axis=-1)
    return Outcome(float(np.max(np.diff(G * heights + kinetic), initial=-np.inf)), ran.status)


def fast() -> Scene:
    """Without weight, at 20 m/s round a circle."""
    return scenes.chain("fast-drag", [0.3], effects={"quadratic_damping": {"b_q": 0.5}}, polar_rate=[20.0])


def _drag_speed(short: bool) -> Outcome:
    """`v(t) = v0 / (1 + b v0 t / m)`."""
    ran = run_case(fast(), 0.002, 0.4 if short else 4.0)
    speed = np.linalg.norm(ran.run.v[:, 0], axis=-1)
    exact = 20.0 / (1 + 0.5 * 20.0 * ran.t)
    return Outcome(float(np.max(np.abs(speed / exact - 1))), ran.status, (fast(), 0.002, 0.4))


def sticky(polar: list[float]) -> Scene:
    """Links of 1 m and 1 kg with dry joints, released at these angles [rad]: they swing slightly and stick."""
    friction = {"weight": {}, "joint_friction": {"dry": 1.0, "axis": [0.0, 1.0, 0.0]}}
    return scenes.chain("dry-friction", polar, effects=friction)


def _creep(polar: list[float], short: bool) -> Outcome:
    """Movement over 300 s (short: 10 s) after the first 20 s."""
    still = 20.0
    scene = sticky(polar)
    rest = run_case(scene, 0.002, still)
    ran = run_case(scene, 0.002, still + (10.0 if short else 300.0))
    moved = np.linalg.norm(ran.run.r[ran.t >= still - 1e-9] - rest.run.r[-1], axis=-1)
    return Outcome(float(np.max(moved)), ran.status if rest.status == "ok" else rest.status, (scene, 0.002, still))


DAMPING_CASES = [
    Case("heavy-damping-position", "damping 1000 times critical at dt 0.1 s, 400 s: distance from the closed form",
         1e-4, "m", _creep_position),
    Case("heavy-damping-energy", "damping 1000 times critical at dt 0.1 s: largest rise of energy", 0.0, "J",
         _creep_energy),
    Case("quadratic-damping-fast", "quadratic damping from 20 m/s, 4 s at dt 0.002 s: error of the speed",
         1e-3, "relative", _drag_speed),
    Case("dry-friction-stays", "a link with a dry joint comes to rest and stays: movement in 300 s", 1e-12, "m",
         lambda short: _creep([0.6], short)),
    Case("dry-friction-two-joints", "two links with dry joints come to rest and stay: movement in 300 s", 1e-12, "m",
         lambda short: _creep([0.6, 0.2], short)),
]  # fmt: skip


TOLERANCE = 1e-2
BATCH = 64


def _too_large(short: bool) -> Outcome:
    """At 10 times the advised step, with the same tolerance: 0 if the status reports that it is not met."""
    scene = load_scene("dropper-release-a-undamped").with_values({"run.duration": 2.0})
    dt = 10 * choose_step(scene, TOLERANCE).dt
    found = simulate(scene, dt=dt, tolerance=TOLERANCE)
    return Outcome(float(found.status == "ok"), found.status, (scene, dt, 2.0))


def _single(short: bool) -> Outcome:
    scene = load_scene("dropper-release-a-undamped")
    ran = run_case(scene, 0.01, 5.0 if short else 50.0, Scheme("energy_momentum", dtype="float32"))
    return Outcome(ran.relative_drift, ran.status)


def _bad_member(short: bool) -> Outcome:
    """Members, of the 63 good ones, whose positions differ in any bit from those in a batch without the bad one."""
    model, s = build("dropper-release-a-undamped")
    stepper = make_stepper(model)
    rng = np.random.default_rng(0)
    v = jnp.asarray(0.01 * rng.standard_normal((BATCH, *s.v.shape)))
    steps = 20 if short else 200

    @jax.jit
    def last(v: jax.Array) -> jax.Array:
        run = partial(integrate, stepper, model, dt=0.01, steps=steps, save_every=steps)
        return jax.vmap(lambda x: run(replace(s, v=x))[0].r)(v)

    good, spoiled = np.asarray(last(v)), np.asarray(last(v.at[17].set(jnp.nan)))
    others = np.delete(np.arange(BATCH), 17)
    differ = np.sum(np.any(good[others] != spoiled[others], axis=(1, 2)))
    return Outcome(float(differ), "ok" if np.all(np.isfinite(spoiled[others])) else "non_finite")


ACCURACY_CASES = [
    Case("ten-times-the-step", "10 times the advised step: the status reports it (1: reported as ok)", 0.0, "-",
         _too_large, expected="not_converged"),
    Case("float32", "undamped dropper in float32, 50 s at dt 0.01 s: drift of the energy balance", 1e-3, "of the scale",
         _single),
    Case("one-bad-member", "one NaN member of a batch of 64: other members that change", 0.0, "members", _bad_member),
]  # fmt: skip


# --- derivatives of the hard cases: finite, and equal to central differences ---

#: Relative change of the parameter in the central differences.
CHANGE = 1e-5
STEPS = 40


@partial(jax.jit, static_argnums=(0, 4))
def _objective(stepper: Stepper, share: jax.Array, model: Model, s: State, steps: int, dt: jax.Array) -> jax.Array:
    """A fixed combination of the last positions over the link length [-], with a relative change of masses, speeds and
    strengths."""
    line = model.lines[0]
    tilt = 1 + share * jnp.linspace(0.5, 1.5, line.links)
    effects = tuple(_scale_effect(effect, 1 + share) for effect in model.effects)
    changed = replace(model, lines=(replace(line, mass=line.mass * tilt),), effects=effects)
    last, _ = integrate(stepper, changed, replace(s, v=s.v * (1 + share)), dt, steps, steps)
    mix = jnp.sin(jnp.arange(1.0, 1.0 + last.r.size)).reshape(last.r.shape)
    return jnp.mean(mix * last.r) / jnp.mean(line.length)


def _scale_effect(effect: Effect, factor: jax.Array) -> Effect:
    """The effect with its strength scaled: gravity or a damping coefficient; others as they are."""
    for name in ("gravity", "b_l", "b_q"):
        if name in effect.__dataclass_fields__:
            return replace(effect, **{name: getattr(effect, name) * factor})
    return effect


def _gradient(name: str, make: Callable[[], Scene], dt: float) -> Case:
    def measure(short: bool) -> Outcome:
        model, s = build(make())
        value = partial(_objective, make_stepper(model), model=model, s=s, steps=STEPS, dt=dt)
        exact = float(_slope(make_stepper(model), model, s, STEPS, dt))
        above, below = (float(value(jnp.asarray(change))) for change in (CHANGE, -CHANGE))
        around = (above - below) / (2 * CHANGE)
        return Outcome(abs(exact - around) / max(abs(around), 1e-3), "ok" if np.isfinite(exact) else "non_finite")

    claim = f"{name}: derivative after {STEPS * dt:g} s against central differences"
    return Case(f"gradient-{name}", claim, 1e-6, "relative", measure)


@partial(jax.jit, static_argnums=(0, 3))
def _slope(stepper: Stepper, model: Model, s: State, steps: int, dt: jax.Array) -> jax.Array:
    return jax.grad(lambda x: _objective(stepper, x, model, s, steps, dt))(jnp.zeros((), model.dtype))


def _at_rest(short: bool) -> Outcome:
    """A loop at rest in its equilibrium with quadratic damping: derivative of the positions by a common factor of all
    masses must vanish."""
    drag = {"linear_damping": {"b_l": 0.01}, "quadratic_damping": {"b_q": 0.01}}
    model, s = build(scenes.loop("at-rest", 0.3, effects=drag))
    stepper = make_stepper(model)

    def sum_of_positions(share: jax.Array) -> jax.Array:
        line = model.lines[0]
        changed = replace(model, lines=(replace(line, mass=line.mass * (1 + share)),))
        return jnp.sum(integrate(stepper, changed, s, 0.01, STEPS, STEPS)[0].r)

    slope = float(jax.jit(jax.grad(sum_of_positions))(jnp.zeros(())))
    return Outcome(abs(slope) if np.isfinite(slope) else float("inf"), "ok" if np.isfinite(slope) else "non_finite")


def _sticking(short: bool) -> Outcome:
    """Dry friction switches, so its derivative is that of the active set: asked to be finite only."""
    model, s = build(sticky([0.6, 0.2]))
    slope = float(_slope(make_stepper(model), model, s, STEPS, 0.01))
    return Outcome(0.0 if np.isfinite(slope) else 1.0, "ok" if np.isfinite(slope) else "non_finite")


GRADIENT_CASES = [
    _gradient("hanging-kicked", scenes.kicked_string, 0.005),
    _gradient("vertical-and-horizontal", turning, 0.005),
    _gradient("undamped-dropper", lambda: load_scene("dropper-release-a-undamped"), 0.01),
    _gradient("ends-at-the-same-point", lambda: scenes.lifted_loop("same-point", 0.0), 0.01),
    _gradient("taut-plucked", lambda: scenes.lifted_loop("taut", 0.999 * 0.7, 2.0), 0.002),
    _gradient("mass-ratio", mass_ratio, 0.0002),
    _gradient("short-link", short_link, 0.01),
    _gradient("large-release", large_release, 0.002),
    _gradient("driven-at-resonance", scenes.driven, 0.01),
    _gradient("whirling-loop", scenes.whirling, 0.002),
    _gradient("heavy-damping", overdamped_pendulum, 0.1),
    _gradient("quadratic-damping-fast", fast, 0.002),
    Case("gradient-at-rest", "a loop at rest: derivative by the masses, which move nothing", 1e-9, "m", _at_rest),
    Case("gradient-dry-friction", "dry friction: derivative is finite (0) or not (1)", 0.0, "-", _sticking),
]

CASES = [*ENERGY_CASES, *DAMPING_CASES, *ACCURACY_CASES, *GRADIENT_CASES]
