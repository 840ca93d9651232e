"""How much a quantity depends on parameters: exact local derivatives, and how far they can be trusted.

Local derivatives go through the whole run, static start included, in forward and in reverse mode. In a chaotic motion
they grow like exp(lambda t) and soon say nothing about a change of finite size: the horizon tells when, and averages
over windows shorter than that still mean something beyond.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax import from_angles, load_scene, settle
from dropper_jax.base.errors import SceneError
from dropper_jax.lanes.lanes import lanes
from dropper_jax.model.model import Model
from dropper_jax.model.state import State, state
from dropper_jax.run.build import build, stepper_of
from dropper_jax.statics.static_pose import nodal_loads
from dropper_jax.stepping.integrate import Trajectory, integrate
from dropper_jax.study.lyapunov import horizon, lyapunov
from fitting.parameters.naming import full_names
from fitting.parameters.of_scene import SceneParameter, find_parameters, place
from fitting.parameters.parameter import Parameter, missing_effects
from fitting.sensitivity.quantities import Quantity, quantity

#: Growth of a small error up to which derivatives are trusted: a change of 1 % has then become one of 100 %.
GROWTH = 100.0
#: Runs advanced together in global studies.
CHUNK = 64
#: Standard range of a parameter in global studies, each way.
SPREAD = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A quantity of a scene as a function of parameters, `study(values)`, values (p,) -> scalar; differentiable.

    Without `retries` a step that resists makes the value NaN: derivatives of halved steps take most of the compilation,
    and hardly any run needs them. `local` and `batch` turn them on where they do.
    """

    scene: Any
    of: Quantity
    parameters: tuple[Parameter | SceneParameter, ...]
    model: Model
    start: State
    retries: bool = False

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.parameters]

    @property
    def values(self) -> np.ndarray:
        return np.array([p.value for p in self.parameters])

    @cached_property
    def stepper(self) -> Any:
        more = {} if self.retries else {"extra": 0, "halvings": 0}
        return stepper_of(self.model, self.scene.run, track_work=False, **more)

    @property
    def saves(self) -> int:
        run = self.scene.run
        return -(-int(np.ceil(run.duration / run.dt - 1e-9)) // run.save_every)

    def begin(self, model: Model) -> State:
        """The start of the changed model: a static pose follows it, given angles keep theirs."""
        start = self.scene.start
        if start.kind == "static":
            return settle(model, self.start, nodal_loads(model, start.release_nodes, start.release_force))
        if start.kind == "angles":
            return from_angles(model, start.polar, start.azimuth, start.polar_rate, start.azimuth_rate, start.zero)
        return state(model, self.start.r, self.start.v)

    def march(self, model: Model, s: State, saves: int, checkpoint: bool = False) -> Trajectory:
        """Saved states of a run from s."""
        run = self.scene.run
        steps = saves * run.save_every
        return integrate(self.stepper, model, s, run.dt, steps, run.save_every, checkpoint)[1]

    def measure(self, model: Model, s: State, run: Trajectory) -> jax.Array:
        """The quantity, NaN where a step failed."""
        t = s.t + (1 + jnp.arange(run.r.shape[0])) * (self.scene.run.dt * self.scene.run.save_every)
        return jnp.where(run.first_bad[-1] < 0, self.of(model, s.r, run, t), jnp.nan)

    def __call__(self, values: jax.Array, checkpoint: bool = False) -> jax.Array:
        model = place(self.model, self.parameters, values)
        s = self.begin(model)
        return self.measure(model, s, self.march(model, s, self.saves, checkpoint))

    def batch(self, values: np.ndarray) -> np.ndarray:
        """The quantity of many values (cases, p) -> (cases,), `CHUNK` at a time in one compiled program."""
        padded = np.resize(values, (-(-len(values) // CHUNK) * CHUNK, values.shape[1]))
        run = jax.jit(lanes(self))
        return np.concatenate([run(jnp.asarray(part)) for part in np.split(padded, len(padded) // CHUNK)])[
            : len(values)
        ]


def study(scene: Any, of: str, to: Sequence[str]) -> Study:
    """The study of a quantity (see `fitting.quantities`) and parameters (paths or unique short names).

    Raises:
        SceneError: unknown names.
    """
    scene = load_scene(scene)
    names = full_names(scene, to, "to")
    added = missing_effects(scene, names)
    scene = scene.with_values(added) if added else scene
    model, start = build(scene)
    parameters = find_parameters(scene, model, names, "to")
    return Study(scene, quantity(of, model), parameters, model, start)


@dataclasses.dataclass(frozen=True)
class Local:
    """Derivatives at the scene's values.

    Attributes:
        names, units, values: of the parameters.
        of, unit, value: the quantity.
        forward, reverse: dQ/dp by both modes (p,).
        horizon: time [s] up to which derivatives are trusted; `duration` [s] of the run.
        exponent: growth rate of small errors [1/s].
        window: length [s] of the windows of the means; None where the whole run is trusted.
        window_mean, window_error: mean derivative of the windows' values and its standard error (p,).
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    of: str
    unit: str
    value: float
    forward: np.ndarray
    reverse: np.ndarray
    horizon: float
    duration: float
    exponent: float
    window: float | None = None
    window_mean: np.ndarray | None = None
    window_error: np.ndarray | None = None

    @property
    def scaled(self) -> np.ndarray:
        """`p/Q dQ/dp` (p,): per cent of the quantity for one per cent of the parameter; NaN where Q is 0."""
        return self.forward * self.values / self.value if self.value else np.full(len(self.names), np.nan)

    @property
    def trusted(self) -> bool:
        return self.window is None

    @property
    def mismatch(self) -> float:
        """Largest difference of the two modes, relative to the largest derivative."""
        size = float(np.max(np.abs(self.forward), initial=0.0))
        return float(np.max(np.abs(self.forward - self.reverse), initial=0.0)) / size if size else 0.0


def local(problem: Study, say: Callable[[float, str], None] = lambda fraction, text: None) -> Local:
    """Exact derivatives of the study at its values, and how far to trust them."""
    at = jnp.asarray(problem.values, problem.model.dtype)
    say(0.0, "forward derivatives")
    forward, value = jax.jit(jax.jacfwd(lambda p: 2 * (problem(p),), has_aux=True))(at)
    if not (np.isfinite(value) or problem.retries):
        return local(dataclasses.replace(problem, retries=True), say)
    say(0.4, "reverse derivatives")
    reverse = jax.jit(jax.grad(partial(problem, checkpoint=True)))(at)
    say(0.7, "trust horizon")
    run = problem.scene.run
    steps = problem.saves * run.save_every
    growth = lyapunov(problem.model, problem.start, problem.stepper, run.dt, max(steps, 2))
    limit = horizon(growth, run.dt, GROWTH)
    found = Local(
        names=problem.names,
        units=[p.unit for p in problem.parameters],
        values=problem.values,
        of=problem.of.name,
        unit=problem.of.unit,
        value=float(value),
        forward=np.asarray(forward),
        reverse=np.asarray(reverse),
        horizon=limit,
        duration=steps * run.dt,
        exponent=float(growth.exponent),
    )
    if limit >= (1 - 1e-9) * steps * run.dt:
        say(1.0, "ok")
        return found
    mean, error, length = windows(problem, at, limit)
    say(1.0, "ok")
    return dataclasses.replace(found, window=length, window_mean=mean, window_error=error)


def windows(problem: Study, at: jax.Array, length: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean derivative of the quantity over windows of about `length` [s] that start on the motion itself.

    Each window's start is held, so that no derivative is carried further than the window: what a parameter does to
    the quantity within one horizon, averaged over the states that the motion visits.

    Returns:
        mean and standard error (p,), and the windows' length [s].
    """
    every = problem.scene.run.dt * problem.scene.run.save_every
    saves = min(max(2, int(length / every)), problem.saves)
    count = problem.saves // saves

    @jax.jit
    def derivatives(p: jax.Array) -> jax.Array:
        model = place(problem.model, problem.parameters, p)
        s = problem.begin(model)
        run = jax.lax.stop_gradient(problem.march(model, s, problem.saves))
        pick = jnp.arange(count - 1) * saves + saves - 1
        first = jax.tree.map(
            lambda a, b: jnp.concatenate([a[None], b[pick]]),
            (s.r, s.v, s.tension, s.parted),
            (run.r, run.v, run.tension, run.parted),
        )
        t = jnp.arange(count) * (saves * every)

        def one(r: jax.Array, v: jax.Array, tension: jax.Array, parted: Any, t: jax.Array) -> jax.Array:
            def value(p: jax.Array) -> jax.Array:
                changed = place(problem.model, problem.parameters, p)
                now = dataclasses.replace(state(changed, r, v, tension), t=t, parted=parted)
                return problem.measure(changed, now, problem.march(changed, now, saves))

            return jax.jacfwd(value)(p)

        return jax.vmap(one)(*jax.lax.stop_gradient(first), t)

    found = np.asarray(derivatives(at))
    error = found.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(found.shape[1], np.nan)
    return found.mean(axis=0), error, saves * every


def ranges(problem: Study, given: Mapping[str, tuple[float, float]] | None = None) -> list[tuple[float, float]]:
    """Range of each parameter in a global study: the given one, else 20 % each way, inside its bounds."""
    given = given or {}
    full = dict(zip(full_names(problem.scene, list(given), "range"), given.values(), strict=True))
    for name, (low, high) in full.items():
        if name not in problem.names or not low < high:
            raise SceneError(f"range: {name} = {low:g}:{high:g}; allowed: low < high of a parameter of --to")
    found = []
    for p in problem.parameters:
        if isinstance(p, SceneParameter) and not p.linear:
            raise SceneError(
                f"to: the model does not follow {p.name!r} along a straight line; allowed: such numbers in local "
                "studies, or `dropper sweep`"
            )
        spread = SPREAD * p.scale
        found.append(full.get(p.name, (max(p.low, p.value - spread), min(p.high, p.value + spread))))
    return found
