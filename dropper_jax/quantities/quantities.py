"""Scalar quantities of a motion: a statistic of one of its signals in time (`motion_signals`, `statistics`).

They are differentiable functions of saved states. Their names, such as `tension.west-leg.fairlead.max`, serve all
commands (see `quantity_names`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
from jax import Array

from dropper_jax.model import Model, Parted, State, state
from dropper_jax.quantities.motion_signals import OF_LINKS, SIGNALS, Instant, signal_members
from dropper_jax.quantities.statistics import PERIOD, START, statistic
from dropper_jax.statics.modes import natural_periods
from dropper_jax.stepping.progress import Trajectory

#: Time [s] between the samples of one instant. No statistic depends on it: a single sample does not vary.
ANY_INTERVAL = 1.0


@dataclass(frozen=True)
class Quantity:
    """A named number of a motion.

    Attributes:
        name: `SIGNAL[.WHERE].STATISTIC`.
        signal, statistic: its first and last part.
        members: links, modes, or nodes that it refers to, from 0; None for all. Nodes are numbered as in
            `Graph.everywhere`, the free ones first. Of an anchor these are its links.
        signs: of an anchor, 1 for links that start there, -1 for links that end there; of an angle, those of links.
        direction: of an anchor, one of `DIRECTIONS`.
        point: number of the point, of an offset.
    """

    name: str
    signal: str
    statistic: str
    members: tuple[int, ...] | None = None
    signs: tuple[float, ...] = ()
    direction: str = ""
    point: int = 0

    @property
    def unit(self) -> str:
        """Its unit in messages and tables."""
        if self.direction == "uplift":
            return "rad"
        return SIGNALS[self.signal].unit

    @property
    def modes(self) -> int:
        """Of a period, the number of modes up to its own."""
        return max(self.members or (0,)) + 1

    @property
    def at_rest(self) -> bool:
        """Whether it depends on the start alone."""
        return self.statistic == START

    def __call__(self, model: Model, start: Array, run: Trajectory, t: Array) -> Array:
        """The number for saved states at times t (k,) [s] of a run from the free nodes `start` (nodes, 3) [m].

        The samples are evenly spaced; a single one is at the end of an interval from t = 0.
        """
        if self.signal == PERIOD:
            pose = state(model, start, tension=run.tension[0], t=t[0])
            return natural_periods(model, pose, self.modes)[-1]
        samples = self.in_time(model, start, run.r, run.v, run.tension, t, run.parted)
        interval = t[0]
        if len(t) > 1:
            interval = t[1] - t[0]
        return statistic(self.statistic, samples, interval)

    @partial(jax.jit, static_argnums=0, inline=True)
    def in_time(self, model: Model, start: Array, *saved: Array | Parted | None) -> Array:
        """The signal (times, members) of saved instants, given as in `instant`."""
        return jax.vmap(lambda *now: self.instant(model, start, *now))(*saved)

    @partial(jax.jit, static_argnums=0, inline=True)
    def of_pose(self, model: Model, s: State) -> Array:
        """The number at one instant, a static pose, in still water."""
        if self.signal == PERIOD:
            return natural_periods(model, s, self.modes)[-1]
        still = model
        if model.sea is not None:
            still = replace(model, sea=model.sea.without_waves())
        return self.of_state(still, s)

    def of_state(self, model: Model, s: State) -> Array:
        """The statistic of one sample, a state from which excursions count; not of a period."""
        sample = self.instant(model, s.r, s.r, s.v, s.tension, s.t, s.parted)
        return statistic(self.statistic, sample[None], ANY_INTERVAL)

    def instant(
        self,
        model: Model,
        start: Array,
        r: Array,
        v: Array,
        tension: Array,
        t: Array,
        parted: Parted | None = None,
    ) -> Array:
        """The signal (members,) of one instant, see `Instant`."""
        now = Instant(model, start, r, v, tension, t, parted)
        if self.signal == "energy":
            return now.energy()
        if self.signal == "anchor":
            return now.anchor_load(self.members or (), self.signs, self.direction)
        if self.signal in OF_LINKS:
            found = OF_LINKS[self.signal](now)
        else:
            found = now.node_signal(self.signal, self.members, self.point)
        return signal_members(found, self.members, self.signs)
