"""The state from which a run continues, saved as named arrays and restored.

The last carry holds the whole state and all data of the stepping. These are positions, velocities, tensions,
unknowns of joint forces and constraints (joints that stick), accelerations, work, broken links and internal states
of effects. Runs that choose their step add it; runs that control their error add their last steps. Leaves are named
by their path in the carry, such as `last_carry_state_r`. The scene and the scheme determine which leaves there are,
so a file is compared with a carry of the same kind.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain
from dropper_jax.base.store import request_differences
from dropper_jax.load.scene import Scene
from dropper_jax.model import Frozen, Parted, State
from dropper_jax.stepping.progress import Progress, Trajectory

#: Prefix of the names of all leaves.
LAST = "last_"
#: Units of leaves by the last part of their names; others have no unit.
UNITS = {"r": "m", "v": "m s-1", "tension": "N", "t": "s", "acceleration": "m s-2", "work": "J", "h": "s", "a": "m s-2"}
UNITS |= {"wanted": "s", "before": "s", "level": "N", "speed": "m s-1"}
#: Start of the names of the leaves of a carry, of a run and of a coupling.
CARRIES = (f"{LAST}carry_", f"{LAST}progress_")
#: Leaves of the controller that were not part of it in earlier versions.
COUNTS = ("refused", "shortest", "changed")
#: Name of the run in error messages.
RUN = "the run to continue"
#: Keys of `[run]` that may change when a run continues.
MAY_CHANGE = ("dt", "duration", "save_every", "save_interval", "source_dt", "solver", "accuracy")
#: Keys of a scene that do not affect the motion.
DESCRIPTIVE = ("name", "description", "notes")


class Row(NamedTuple):
    """One saved instant: the first row of a run that continues from it."""

    r: Array
    v: Array
    tension: Array
    work: Array
    parted: Parted | None
    own: dict[str, Frozen]


#: An end of a run: `Last`, or that of another component.
End = TypeVar("End")


class Last(NamedTuple):
    """The end of a run: its last row and its last carry."""

    row: Row
    carry: Progress


def trajectory_rows(t: Trajectory) -> Row:
    """The rows of a trajectory, in arrays (k, ...)."""
    return Row(t.r, t.v, t.tension, t.work, t.parted, t.own or {})


def last_row(trajectory: Trajectory) -> Row:
    """The last row of a trajectory."""
    return jax.tree.map(lambda a: a[-1], trajectory_rows(trajectory))


def first_row(s: State, work: int) -> Row:
    """The row of the initial state of a run, with this number of contributions to the work."""
    return Row(s.r, s.v, s.tension, jnp.asarray(np.zeros(work), s.r.dtype), s.parted, s.own)


def name_leaves(end: NamedTuple) -> dict[str, np.ndarray]:
    """The leaves of the end of a run by name."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(end)
    return {_name(key_path): np.asarray(leaf) for key_path, leaf in leaves}


def units(name: str) -> str:
    """The unit of a leaf of that name."""
    return UNITS.get(name.rpartition("_")[2], "1")


def restore_carry(kind: End, last: dict[str, np.ndarray]) -> End:
    """The end of a run restored from saved leaves; `kind` is any end of the same scene and scheme.

    Raises:
        SceneError: leaves that are missing or are not those of such a run.
    """
    if not last:
        raise SceneError(f"{RUN} has no final state, as files of earlier versions. Use a run made by this version")
    last = {_present_name(name): leaf for name, leaf in last.items()}
    leaves, tree = jax.tree_util.tree_flatten_with_path(kind)
    found = []
    for key_path, like in leaves:
        name = _name(key_path)
        if name not in last:
            raise SceneError(f"{RUN} lacks {name!r} of its final state. Use a file that was not changed")
        leaf = last[name]
        if leaf.shape != like.shape or leaf.dtype != like.dtype:
            has = f"{leaf.dtype}{list(leaf.shape)}"
            needs = f"{like.dtype}{list(like.shape)}"
            raise SceneError(f"{RUN} has {name!r} as {has}; allowed: {needs}, which its scene determines")
        if not np.all(np.isfinite(leaf)):
            raise SceneError(f"{RUN} has non-finite values in {name!r}; allowed: finite values")
        found.append(jnp.asarray(leaf))
    return jax.tree.unflatten(tree, found)


def _name(key_path: tuple[Any, ...]) -> str:
    """The name of a leaf from its path in the tree."""
    return LAST + jax.tree_util.keystr(key_path, simple=True, separator="_")


def _present_name(name: str) -> str:
    """The name of a leaf, which this version or an earlier one has given."""
    for carry in CARRIES:
        if name.startswith(carry):
            field = name.removeprefix(carry).removeprefix("progress_")
            if field in COUNTS:
                return f"{carry}control_{field}"
            return carry + field
    return name


def same_scene(scene: Scene, before: Scene) -> None:
    """Reject a scene that differs from that of the run, with the first key that differs, or that chooses its steps in
    another way.

    Raises:
        SceneError: one line.
    """
    found = request_differences(_values_of_motion(scene), _values_of_motion(before))
    if found:
        what = f"is of another scene, {before.name!r}, which differs from {scene.name!r} in {found[0]}"
        may_change = ", ".join(f"run.{name}" for name in MAY_CHANGE)
        raise SceneError(f"{RUN} {what}. Use the same scene; only {may_change} may change")
    there = before.run.steps_in_words
    here = scene.run.steps_in_words
    if (before.run.accuracy is None) != (scene.run.accuracy is None):
        raise SceneError(f"{RUN} was saved with {there}; allowed: one with {here}. Use {there}")


def _values_of_motion(scene: Scene) -> dict[str, Plain]:
    """The values of a scene that have to be those of the run that it continues."""
    plain = {key: value for key, value in scene.to_dict().items() if key not in DESCRIPTIVE}
    return {**plain, "run": {key: value for key, value in plain["run"].items() if key not in MAY_CHANGE}}
