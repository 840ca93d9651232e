"""Quantities of a run observed from its saved states: motion of nodes and bodies, energies, broken links."""

from __future__ import annotations

from functools import partial
from operator import itemgetter
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.read import Table, Values
from dropper_jax.model import Frozen, Model, Parted
from dropper_jax.run.row_store import BLOCK_STATES, InMemory, Rows, release_pages
from dropper_jax.scene import SceneData, attitude, line_slices
from dropper_jax.stepping.observe import Observed, observe


class SavedStates(NamedTuple):
    """Saved states of a run (k, ...): free nodes [m], velocities [m/s], times [s], broken links, states of effects."""

    r: Rows
    v: Rows
    t: Rows
    parted: Parted | None
    own: dict[str, Frozen]


def observe_states(model: Model, states: SavedStates, rows: InMemory) -> Table:
    """Observed quantities of states by name, of the lines as in `Observed` and of the bodies.

    Many states are observed in blocks of equal length, which share a program and are never all in memory.
    """
    count = len(states.t)
    found = {}
    if count <= BLOCK_STATES:
        found = _observe_block(model, states)
    else:
        for first in range(0, count, BLOCK_STATES):
            at = np.arange(first, first + BLOCK_STATES).clip(max=count - 1)
            block = jax.tree.map(itemgetter(at), states)
            for name, part in _observe_block(model, block).items():
                if first == 0:
                    found[name] = rows.empty((count, *part.shape[1:]), part.dtype)
                found[name][first : first + BLOCK_STATES] = part[: count - first]
            release_pages([*jax.tree.leaves(states), *found.values()])
    if "body_attitude" in found:  # a turn may continue from one block to the next
        unwrap_attitude(found["body_attitude"])
    return found


def _observe_block(model: Model, states: SavedStates) -> Table:
    """Observed quantities of some states by name."""
    states = jax.device_put(states)  # `jnp.asarray` would compile a program for each shape
    observed = jax.tree.map(np.asarray, _observe(model, *states)._asdict())
    return observed | body_motion(model, states.r, states.v)


@cached_jit()
def _observe(
    model: Model, r: Array, v: Array, t: Array, parted: Parted | None, internal: dict[str, Frozen]
) -> Observed:
    return jax.vmap(observe, in_axes=(None, 0, 0, 0, 0, 0))(model, r, v, t, parted, internal)


def body_motion(model: Model, r: Array, v: Array) -> dict[str, np.ndarray]:
    """Motion of the bodies by the names of a solution, from positions and velocities (k, free nodes, 3); empty without
    bodies.

    Roll and yaw are between -pi and pi (see `unwrap_attitude`), pitch between -pi/2 and pi/2, where the three are not
    unique.
    """
    if not model.constraints:
        return {}
    pose = jax.vmap(partial(model.constraints[0].pose, model))
    position, axes = jax.tree.map(np.asarray, pose(r))
    velocity, rates = jax.tree.map(np.asarray, pose(v))
    spin = rates @ np.swapaxes(axes, -1, -2)  # skew: the angular velocity's cross product
    angular = np.stack([spin[..., i, j] - spin[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1) / 2.0
    return {
        "body_position": position,
        "body_attitude": attitude(axes),
        "body_velocity": velocity,
        "body_rates": angular,
    }


def unwrap_attitude(angles: np.ndarray) -> None:
    """Make roll and yaw of attitudes (k, bodies, 3) [rad] continuous in time, in place."""
    angles[..., 0::2] = np.unwrap(angles[..., 0::2], axis=0)


def breaks(scene: SceneData, parted: Parted | None) -> tuple[Table, ...]:
    """Broken links of a run, by time: line, link (from 1), time [s] and tension [N]."""
    if parted is None:
        return ()
    found = []
    for link, t, tension in np.transpose([parted.link, parted.t, parted.tension]).tolist():
        for where in line_slices(scene):
            if where.links.start <= link < where.links.stop:
                number = int(link) - where.links.start + 1
                found.append({"line": where.name, "link": number, "time_s": t, "tension_n": tension})
    return tuple(sorted(found, key=lambda row: row["time_s"]))


def break_in_words(row: Values) -> str:
    """One line of text about a broken link."""
    return (
        f"line {row['line']!r} broke at its link {row['link']} at t = {row['time_s']:.6g} s "
        f"under {row['tension_n']:.6g} N"
    )
