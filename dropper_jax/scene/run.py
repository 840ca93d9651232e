"""`[run]` of a scene: step, duration and scheme."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, replace

from dropper_jax.base.errors import Check, SceneError, raise_first
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import (
    MAX_COUNT,
    Plain,
    SectionValues,
    Table,
    Values,
    as_table,
    check_keys,
    count,
    declared_fields,
    read_fields,
    read_number,
    read_table,
)

#: Accuracy of runs of scenes that give neither accuracy nor step.
DEFAULT_ACCURACY = 0.01
#: Keys that an accuracy replaces.
REPLACED = ("tolerance", "step_tolerance", "error_tolerance")
#: Linear solvers by name, as `dropper_jax.solvers` offers them; importing that would load scipy for every scene reader.
SOLVERS = ("auto", "dense", "banded", "condensed", "network")


@section
class RunSpec(SectionValues):
    """`[run]`: how the scene is simulated unless the caller specifies otherwise."""

    duration: float = parameter("simulated time", unit="s", above=0.0)
    accuracy: float | None = parameter(
        "required relative accuracy, which the steps follow; 0.01 without `dt`",
        unit="-",
        above=0.0,
        high=1.0,
        default=None,
    )
    save_interval: float | None = parameter("time between saved states", unit="s", above=0.0, default=None)
    dt: float | None = parameter("time step, if all are equal", unit="s", above=0.0, default=None)
    source_dt: float | None = parameter(
        "time step of the source of the scene, of studies that take equal steps",
        unit="s",
        above=0.0,
        default=None,
    )
    integrator: str = option("integrator", type=str, default="energy_momentum")
    solver: str = option("linear solver", choices=SOLVERS, default="auto")
    dtype: str = option("precision", choices=("float64", "float32"), default="float64")
    save_every: int = count("equal steps between saved states, the last of which is at or after `duration`", default=1)
    options: dict[str, float] = field(default_factory=dict)  # of the scheme, by name
    #: For `step` and `interval` where the scene gives none [s]; the scene suggests them.
    suggested_step: float | None = None
    suggested_interval: float | None = None

    @property
    def step(self) -> float:
        """Length [s] of equal steps: `dt`, else that of the source, else a suggested one."""
        return next(value for value in (self.dt, self.source_dt, self.suggested_step) if value is not None)

    @property
    def interval(self) -> float:
        """Time [s] between saved states."""
        if self.accuracy is None:
            return self.step * self.save_every
        if self.save_interval is None:
            return self.suggested_interval
        return self.save_interval

    @property
    def rows(self) -> int:
        """Number of saved states after the start."""
        if self.accuracy is None:
            return self.saves
        return math.ceil(self.duration / self.interval - 1e-9)

    @property
    def saves(self) -> int:
        """Saved states of equal steps after the start, which cover the duration; a remainder below 1e-9 steps is
        attributed to rounding."""
        steps = math.ceil(self.duration / self.step - 1e-9)
        return math.ceil(steps / self.save_every)

    @property
    def steps(self) -> int:
        """Number of equal steps, a multiple of `save_every`."""
        return self.saves * self.save_every

    @property
    def steps_in_words(self) -> str:
        """How the steps are chosen."""
        if self.accuracy is None:
            return f"steps of {self.step:g} s"
        return f"accuracy {self.accuracy:g}"

    @classmethod
    def read(cls, table: Plain, path: str, options: Mapping[str, Values] | None = None) -> RunSpec:
        """A checked `[run]`; `options` are the additional keys of schemes, name and range."""
        given = read_table(table, path)
        options = options or {}
        for key in REPLACED:
            if key in given:
                raise SceneError(f"{path}.{key}: no longer exists. Use run.accuracy, a relative error such as 0.01")
        check_keys(given, [*declared_fields(cls), *options], path)
        own = dict(given)
        found = {}
        for key, declared in options.items():
            if key in own:
                found[key] = read_number(own.pop(key), f"{path}.{key}", declared)
        spec = cls(**read_fields(cls, own, path, {}), options=found)
        raise_first(spec._checks(), path)
        return spec._normalise(path)

    def _normalise(self, path: str) -> RunSpec:
        """The same without keys that follow from others."""
        if self.dt is None:
            return replace(self, accuracy=self.accuracy or DEFAULT_ACCURACY)
        if self.accuracy is None and self.save_interval is None:
            return self
        if self.accuracy is None:
            return self._with_save_every(path)
        interval = self.save_interval or self.dt * self.save_every
        return replace(self, dt=None, source_dt=self.source_dt or self.dt, save_every=1, save_interval=interval)

    def _with_save_every(self, path: str) -> RunSpec:
        """The same with the steps between saved states counted.

        Raises:
            SceneError: it is not a whole number.
        """
        every = round(self.save_interval / self.dt)
        if every < 1 or abs(every * self.dt - self.save_interval) > 1e-9 * self.save_interval:
            raise SceneError(
                f"{path}.save_interval: {self.save_interval:g} s is not a whole number of steps of {self.dt:g} s"
            )
        return replace(self, save_every=every, save_interval=None)

    def _checks(self) -> Iterator[Check]:
        shortest = self.dt or self.save_interval or 0.0
        yield (
            self.save_interval is not None and self.save_interval > self.duration,
            f"save_interval: {self.save_interval} s is longer than the run; allowed: at most its duration, "
            f"{self.duration:g} s",
        )
        yield (
            self.duration < shortest,
            f"duration: {self.duration} is shorter than the step; allowed: at least one step, {shortest:g} s",
        )
        yield (
            self.duration > MAX_COUNT * shortest > 0.0,
            f"duration: {self.duration} takes {self.duration / (shortest or 1.0):.3g} steps of {shortest:g} s; "
            f"allowed: at most {MAX_COUNT} steps",
        )
        yield (
            self.dt is None and self.save_every != 1,
            f"save_every: {self.save_every} counts equal steps, and the scene has no run.dt. Use run.save_interval [s]",
        )
        yield (
            self.accuracy is not None and self.save_every != 1,
            f"save_every: {self.save_every} counts equal steps, which run.accuracy excludes. Use run.save_interval [s]",
        )

    def table(self) -> Table:
        """Plain values by key, options of the scheme included."""
        return {**as_table(self), **self.options}


def choose_steps(table: Values, given: Values) -> Table:
    """The table of `[run]` without keys that newly given values replace.

    A new step replaces the accuracy; a new accuracy replaces the step, which becomes that of the source.

    Args:
        given: the new values, which the table has, by path.
    """
    found = dict(table)

    def is_new(key: str) -> bool:
        return f"run.{key}" in given

    if is_new("dt") and not is_new("accuracy"):
        for key in ("accuracy", "save_interval", "source_dt"):
            if not is_new(key):
                found.pop(key, None)
    if is_new("accuracy") and "dt" in found and not is_new("dt"):
        step = found.pop("dt")
        every = found.pop("save_every", 1)
        found.setdefault("source_dt", step)
        found.setdefault("save_interval", step * every)
    return found
