"""Loads of one run, chunk by chunk: extremes of every link, series of every fixed point, cycles of chosen links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.report.tension import RANGE_ROUNDING, cycles
from dropper_jax.scene import line_slices, whole_lines

#: Stored arrays of a run by name.
Found = dict[str, np.ndarray]


class Tally:
    """Statistics of a run.

    Args:
        scene: with its lines.
        skip: time at the start that is not counted [s].
        positions: (nodes, 3) [m], the origin of excursions.
        curved: lines whose cycles are counted, those with a fatigue curve.
    """

    def __init__(self, scene: Scene, skip: float, positions: np.ndarray, curved: Sequence[str]) -> None:
        self.skip, self.positions = skip, positions
        self.lines = whole_lines(scene)
        self.held = [point.name for point in scene.points if point.kind == "fixed"]
        self.ends = _ends(scene, self.held)
        links = sum(line.links for line in scene.lines)
        self.largest, self.when = np.full(links, -np.inf), np.full(links, np.nan)
        self.total, self.samples = np.zeros(links), 0
        self.excursion = np.zeros(len(self.lines))
        self.loads: list[np.ndarray] = []
        self.curved = {line.name: line.links for line in self.lines if line.name in curved}
        self.series: dict[str, list[np.ndarray]] = {name: [] for name in self.curved}

    def add(self, t: np.ndarray, positions: np.ndarray, tension: np.ndarray, largest: np.ndarray) -> None:
        """Samples at times t (k,) [s]: nodes (k, nodes, 3) [m], tension and its maximum since the last (k, n) [N]."""
        counts = t > self.skip
        if not counts.any():
            return
        t, positions, tension, largest = t[counts], positions[counts], tension[counts], largest[counts]
        top = largest.argmax(axis=0)
        value = np.take_along_axis(largest, top[None], axis=0)[0]
        higher = value > self.largest
        self.largest, self.when = np.where(higher, value, self.largest), np.where(higher, t[top], self.when)
        self.total += tension.sum(axis=0)
        self.samples += len(t)
        way = np.linalg.norm(positions[..., :2] - self.positions[:, :2], axis=-1).max(axis=0)
        self.excursion = np.maximum(self.excursion, [way[line.nodes].max() for line in self.lines])
        self.loads.append(self._held_loads(positions, largest).astype(np.float32))
        for name, links in self.curved.items():
            self.series[name].append(tension[:, links].astype(np.float32))

    def _held_loads(self, positions: np.ndarray, tension: np.ndarray) -> np.ndarray:
        """Horizontal and upward force (k, held, 2) [N] of lines on fixed points: `sum T d/|d|`, d from the point."""
        total = np.zeros((len(tension), len(self.held), 3))
        for point, node, inner, link in self.ends:
            along = positions[:, inner] - positions[:, node]
            size = np.linalg.norm(along, axis=1, keepdims=True)
            total[:, point] += tension[:, link, None] * along / np.where(size > 0.0, size, 1.0)
        return np.stack([np.hypot(total[..., 0], total[..., 1]), total[..., 2]], axis=-1)

    def collect(self) -> Found:
        """Arrays of the whole run; cycles are omitted if the package that counts them is not installed."""
        counted = {}
        for name, parts in self.series.items():
            whole = np.concatenate(parts) if parts else np.zeros((0, 1), np.float32)
            try:
                counted |= _cycles(name, whole)
            except SceneError:
                break
        empty = np.zeros((0, len(self.held), 2), np.float32)
        return {
            "largest": self.largest,
            "when": self.when,
            "mean": self.total / max(self.samples, 1),
            "excursion": self.excursion,
            "held_loads": np.concatenate(self.loads) if self.loads else empty,
            **counted,
        }


def _ends(scene: Scene, held: Sequence[str]) -> list[tuple[int, int, int, int]]:
    """Line ends at fixed points: number of the point, node there, next node, link between them."""
    found = []
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        first, last = where.nodes.start, where.nodes.stop - 1
        ends = ((line.start, first, first + 1, where.links.start), (line.end, last, last - 1, where.links.stop - 1))
        found += [(held.index(point), *rest) for point, *rest in ends if point in held]
    return found


def _cycles(name: str, tension: np.ndarray) -> Found:
    """Rainflow cycles of the links with the most varying and the highest tension: rows of range and count."""
    found = {}
    picked = {int(np.argmax(tension.std(axis=0))), int(np.argmax(tension.max(axis=0)))} if len(tension) else set()
    for i, link in enumerate(sorted(picked)):
        own = cycles(tension[:, link].astype(float))
        own = own[own[:, 0] > RANGE_ROUNDING * float(np.abs(tension).max())]
        found[f"cycles:{name}:{i}"] = own[:, [0, 2]].astype(np.float32)
    return found
