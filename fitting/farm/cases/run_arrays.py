"""Arrays that a run of a load case stores, collected chunk by chunk: statistics of its loads, and quantities."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.evaluation.fatigue import RANGE_ROUNDING, cycles
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.quantities.end_links import EndLinks, line_ends
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_extremes import quantity_signals
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.quantities.statistics import statistic
from dropper_jax.scene import RunSpec, whole_lines
from dropper_jax.stepping.progress import Trajectory

#: Stored arrays of a run by name.
RunArrays = dict[str, np.ndarray]


class LoadStatistics:
    """Loads of a run, chunk by chunk: extremes of links, series of fixed points, cycles of chosen links.

    Args:
        scene: with the mussels in masses and diameters.
        skip: time at the start that is not counted [s].
        positions: (nodes, 3) [m], the origin of excursions.
        curved: lines whose cycles are counted, those with a fatigue curve.
    """

    def __init__(self, scene: Scene, skip: float, positions: np.ndarray, curved: Sequence[str]) -> None:
        self.skip = skip
        self.positions = positions
        self.lines = whole_lines(scene)
        self.fixed = scene.fixed_points
        self.links = EndLinks(scene)
        self.ends = [(self.fixed.index(point), end) for point, end in line_ends(scene) if point in self.fixed]
        links = sum(line.links for line in scene.lines)
        self.largest = np.full(links, -np.inf)
        self.when = np.full(links, np.nan)
        self.total = np.zeros(links)
        self.samples = 0
        self.excursion = np.zeros(len(self.lines))
        self.loads = [np.zeros((0, len(self.fixed), 2), np.float32)]
        self.curved = {line.name: line.links for line in self.lines if line.name in curved}
        self.series = {name: [np.zeros((0, links), np.float32)[:, own]] for name, own in self.curved.items()}

    def add(self, t: np.ndarray, positions: np.ndarray, tension: np.ndarray, largest: np.ndarray) -> None:
        """Samples at times t (k,) [s]: nodes (k, nodes, 3) [m], tension and its maximum since the last (k, n) [N]."""
        counts = t > self.skip
        if not counts.any():
            return
        t, positions, tension, largest = (values[counts] for values in (t, positions, tension, largest))
        top = largest.argmax(axis=0)
        value = np.take_along_axis(largest, top[None], axis=0)[0]
        self.when = np.where(value > self.largest, t[top], self.when)
        self.largest = np.fmax(value, self.largest)
        self.total += tension.sum(axis=0)
        self.samples += len(t)
        moved = np.linalg.norm(positions[..., :2] - self.positions[:, :2], axis=-1).max(axis=0)
        self.excursion = np.maximum(self.excursion, [moved[line.nodes].max() for line in self.lines])
        # horizontal and upward force of lines on fixed points
        total = np.zeros((len(t), len(self.fixed), 3))
        for number, end in self.ends:
            total[:, number] += self.links.force(end, positions[:, end.nodes], largest, t)
        loads = np.stack([np.hypot(total[..., 0], total[..., 1]), total[..., 2]], axis=-1)
        self.loads.append(loads.astype(np.float32))
        for name, links in self.curved.items():
            self.series[name].append(tension[:, links].astype(np.float32))

    def collect(self) -> RunArrays:
        """Arrays of the whole run; cycles are omitted if the package that counts them is not installed."""
        found = {
            "largest": self.largest,
            "when": self.when,
            "mean": self.total / max(self.samples, 1),
            "excursion": self.excursion,
            "held_loads": np.concatenate(self.loads),
        }
        with suppress(SceneError):
            for name, parts in self.series.items():
                found |= _cycles(name, np.concatenate(parts))
        return found


def _cycles(name: str, tension: np.ndarray) -> RunArrays:
    """Rainflow cycles of the links with the most varying and the highest tension: rows of range and count."""
    found = {}
    if not len(tension):
        return found
    picked = {int(np.argmax(tension.std(axis=0))), int(np.argmax(tension.max(axis=0)))}
    for i, link in enumerate(sorted(picked)):
        own = cycles(tension[:, link].astype(float))
        own = own[own[:, 0] > RANGE_ROUNDING * float(np.abs(tension).max())]
        found[f"cycles:{name}:{i}"] = own[:, [0, 2]].astype(np.float32)
    return found


class QuantityValues:
    """Values of a site's quantities at the saved times of a run, chunk by chunk.

    Attributes:
        watch: what the run records over its steps; None for equal steps.
    """

    def __init__(self, names: Sequence[str], model: Model, start: State, run: RunSpec) -> None:
        self.model = model
        self.start = start
        self.run = run
        self.values: dict[Quantity, list[np.ndarray]] = {}
        for name in names:
            self.values[quantity(name, model, "quantities")] = []
        self.watch = None
        if run.accuracy is not None:
            self.watch = quantity_signals(list(self.values), start.r)

    def add(self, t: np.ndarray, rows: Trajectory, counts: np.ndarray) -> None:
        """Rows of the run at times t (k,) [s], of which some count (k,)."""
        extremes = {}
        if self.watch is not None and rows.extremes is not None:
            extremes = self.watch.over_steps(rows.extremes)
        times = jnp.asarray(t, self.model.dtype)
        for one, parts in self.values.items():
            if one.at_rest:
                continue
            if one in extremes:
                values = extremes[one]
            else:
                values = one.in_time(self.model, self.start.r, rows.r, rows.v, rows.tension, times, rows.parted)
            parts.append(np.asarray(values)[counts])

    def collect(self) -> RunArrays:
        """The statistic of each quantity, as `quantity:NAME`."""
        found = {}
        over_steps = self.watch is not None
        for one, parts in self.values.items():
            if one.at_rest:  # the start is not among the saved states
                value = one.of_state(self.model, self.start)
            else:
                value = statistic(one.statistic, jnp.concatenate(parts), self.run.interval, over_steps=over_steps)
            found[f"quantity:{one.name}"] = np.asarray(value)
        return found
