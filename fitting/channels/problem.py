"""The least-squares problem of a fit to channels: runs, free parameters, and residuals with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import State
from dropper_jax.run.build import build_model, equal_steps
from dropper_jax.run.start import initial_state
from dropper_jax.stepping.stepper import Stepper
from fitting.channels.data import Data
from fitting.channels.free import SetupPlace, placed
from fitting.channels.motion import Plan, differentiated
from fitting.parameters.parameter import Parameter
from fitting.parameters.priors import Known

#: Saved states beyond the last sample, which cubics through four rows need.
BEYOND = 3
#: Largest derivative that can be squared and summed.
LARGEST = 1e100


class Evaluation(NamedTuple):
    """Of every run and channel (k, m): what was to be seen [SI], and its derivatives by all parameters (k, m, p).

    `near` are the runs' starts, next to which the next ones are looked for; `failed` names a step that did not solve,
    or, where `unstable`, derivatives that grew out of all numbers.
    """

    shown: tuple[tuple[np.ndarray, ...], ...]
    slopes: tuple[tuple[np.ndarray, ...], ...]
    near: tuple[State, ...]
    failed: str = ""
    unstable: bool = False


@dataclass(frozen=True, eq=False)
class Problem:
    """What is fitted.

    Attributes:
        data: what was measured.
        scenes: of each run, its own values in place.
        parameters: all of them, those that runs share and those of one run.
        of_run: numbers of the parameters of each run, in the order of its directions.
        near: a start of each run to look from.
        halved: how often the scene's step is halved.
        retries: whether steps that resist are halved and tried again.
        known: what the rig knows of several parameters together.
    """

    data: Data
    scenes: tuple[Scene, ...]
    parameters: tuple[Parameter, ...]
    of_run: tuple[tuple[int, ...], ...]
    plain: tuple[tuple[Parameter, ...], ...]
    near: tuple[State, ...]
    halved: int = 0
    retries: bool = False
    known: Known = field(default_factory=Known)

    @property
    def dt(self) -> float:
        """The step [s]."""
        return self.scenes[0].run.dt * 0.5**self.halved

    @property
    def held(self) -> np.ndarray:
        """Which parameters have no room (p,)."""
        return np.array([not p.low < p.high for p in self.parameters], bool)

    @property
    def values(self) -> np.ndarray:
        """Where the parameters start (p,)."""
        return np.array([p.value for p in self.parameters])

    def plan(self, run: int) -> Plan:
        """What is static of a run; the same for all, so that runs of one kind share a program."""
        scene = self.scenes[run]
        start = scene.start
        return Plan(
            self._stepper(run),
            start.kind,
            start.zero,
            start.release_nodes,
            tuple(sensor.channel for sensor in self.data.sensors),
            self._saves(),
            scene.run.save_every * 2**self.halved,
        )

    def _stepper(self, run: int) -> Stepper:
        more = {} if self.retries else {"extra": 0, "halvings": 0}
        scene = self.scenes[run]
        return equal_steps(build_model(scene), scene.run, track_work=False, reverse=False, **more)

    def _saves(self) -> int:
        """Saved states that reach beyond the last sample of the longest run, delays and rates at their bounds."""
        late = max(float(t[-1]) for run in self.data.runs for t in run.t)
        delays = [p.low for p in self.parameters if isinstance(p.where, SetupPlace) and p.where.field == "time"]
        rates = [p.high for p in self.parameters if isinstance(p.where, SetupPlace) and p.where.field == "rate"]
        given = [s.delay for s in self.data.sensors] + [c.delay for c in self.data.cameras]
        rate = max([1.0, *rates, *(c.rate for c in self.data.cameras)])
        late = late * rate - min([0.0, *given, *(d for d in delays if np.isfinite(d))]) * (2 if delays else 1)
        spacing = self.scenes[0].run.dt * self.scenes[0].run.save_every
        return max(int(np.ceil(late / spacing - 1e-9)) + BEYOND, 5)

    def evaluate(self, values: np.ndarray, near: Sequence[State] | None = None) -> Evaluation:
        """What all runs show at these values (p,), with derivatives."""
        near = self.near if near is None else near
        shown, slopes, starts, failed, unstable = [], [], [], "", False
        for run, scene in enumerate(self.scenes):
            mine = list(self.of_run[run])
            try:
                at = placed(scene, self.data, self.plain[run], values[mine])
            except SceneError as error:  # such as a pose that does not exist
                return Evaluation((), (), tuple(near), f"{self.data.runs[run].name}: {error}")
            dt = jnp.asarray(self.dt, at.setup.model.dtype)
            times = self._padded(run, dt.dtype)
            seen, slope, start, bad = differentiated(self.plan(run), at.setup, at.tangents, near[run], dt, times)
            if int(bad) >= 0 or not all(np.isfinite(y).all() for y in seen):
                when = f"step {int(bad) + 1} at {(int(bad) + 1) * self.dt:g} s" if int(bad) >= 0 else "the start"
                failed = failed or f"{self.data.runs[run].name}: {when} did not solve"
            elif not all(np.abs(s).max(initial=0.0) < LARGEST for s in slope):
                unstable = True
                failed = failed or f"{self.data.runs[run].name}: derivatives grow without bound, the motion is chaotic"
            counts = [len(t) for t in self.data.runs[run].t]
            shown.append(tuple(np.asarray(y)[:n] for y, n in zip(seen, counts, strict=True)))
            slopes.append(tuple(self._spread(np.asarray(s)[:n], mine) for s, n in zip(slope, counts, strict=True)))
            starts.append(start)
        return Evaluation(tuple(shown), tuple(slopes), tuple(starts), failed, unstable)

    def _padded(self, run: int, dtype: jnp.dtype) -> tuple[jax.Array, ...]:
        """Stamps of a run's channels, the last one repeated up to the longest run's count."""
        found = []
        for channel, t in enumerate(self.data.runs[run].t):
            most = max(len(r.t[channel]) for r in self.data.runs)
            found.append(jnp.asarray(np.concatenate([t, np.full(most - len(t), t[-1])]), dtype))
        return tuple(found)

    def _spread(self, slope: np.ndarray, mine: list[int]) -> np.ndarray:
        """Derivatives by all parameters, from those by a run's own."""
        full = np.zeros((*slope.shape[:2], len(self.parameters)))
        full[..., mine] = slope
        return full

    def finer(self) -> Problem:
        """The same with half the step."""
        return replace(self, halved=self.halved + 1)


def first_near(scene: Scene) -> State:
    """The scene's own start.

    Raises:
        SceneError: a static pose that is not found.
    """
    return initial_state(build_model(scene), scene.start)
