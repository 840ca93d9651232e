"""Failures that a scene allows, as arrays, and the failures of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dropper_jax.model import Failures, Parted
from dropper_jax.scene import SceneData


def make_failures(scene: SceneData) -> Failures | None:
    """The arrays of a scene's `[[failure]]` entries; None without any."""
    if not scene.failures:
        return None
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    load = np.full((len(scene.failures), starts[-1]), np.inf)
    named = []
    for row, spec in zip(load, scene.failures, strict=True):
        i = next(i for i, line in enumerate(scene.lines) if line.name == spec.line)
        line = scene.lines[i]
        own = line.breaking_load if spec.load is None and spec.time is None else spec.load
        if own is not None:
            row[starts[i] : starts[i + 1]] = own
        named.append(-1 if spec.link is None else int(starts[i]) + spec.link - 1)
        if named[-1] >= 0:
            row[np.arange(len(row)) != named[-1]] = np.inf
    times = np.array([np.inf if spec.time is None else spec.time for spec in scene.failures])
    return Failures(load, times, tuple(named))


def breaks(scene: SceneData, parted: Parted | None) -> tuple[dict[str, Any], ...]:
    """Broken links of a run, by time: line, link (from 1), time [s] and tension [N]."""
    if parted is None:
        return ()
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    found = []
    for link, t, tension in zip(
        *(np.asarray(x).tolist() for x in (parted.link, parted.t, parted.tension)), strict=True
    ):
        if link < 0:
            continue
        i = int(np.searchsorted(starts, link, side="right")) - 1
        row = {"line": scene.lines[i].name, "link": link - int(starts[i]) + 1, "time_s": t, "tension_n": tension}
        found.append(row)
    return tuple(sorted(found, key=lambda row: row["time_s"]))


def words(row: Mapping[str, Any]) -> str:
    """One line of text about a failure."""
    return (
        f"line {row['line']!r} broke at its link {row['link']} at t = {row['time_s']:.6g} s "
        f"under {row['tension_n']:.6g} N"
    )
