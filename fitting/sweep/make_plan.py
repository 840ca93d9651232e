"""The plan of a sweep from what the user asks for, checked, or from its identity."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from dropper_jax import Scene, load_scene
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.machine import available_memory, in_words
from dropper_jax.base.read import declared_fields
from dropper_jax.integrators import OPTIONS
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import SceneLike, build
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.quantities.statistics import PERIOD
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.stepper import check_settings, stepper_settings
from fitting.sweep.axes import first_seed, full_paths, make_axis, read_values
from fitting.sweep.plan import QUANTITIES, SEED, Plan

#: Cases of a device at a time, where the user gives none: those of 7 links then stay in the cache of a core. Cases of
#: a system of lines run one after another, so that larger chunks gain nothing.
CHUNK = 64
SYSTEM_CHUNK = 1
#: The same on a GPU, where each operation costs the same for one case as for thousands. An H200 runs 131 072 lab
#: droppers only 1.14 times as fast per case.
GPU_CHUNK = 16384
GPU_SYSTEM_CHUNK = 256
#: Number of cases that are tried for one with a start: all of a sweep may take hours.
MOST_TRIED_CASES = 64
#: Fraction of the free memory that the table of all cases may use.
MOST_MEMORY = 0.5


def from_identity(identity: Mapping[str, Any]) -> Plan:
    """The plan with this identity."""
    scene = Scene.from_dict(identity["scene"])
    if "template" in identity:
        template = identity["template"]
        scene = Scene.from_dict(template["table"], scene.name).with_values(template["changes"])
    return make_plan(
        scene,
        identity["vary"],
        quantities=identity["quantities"],
        traces=identity["traces"],
        chunk=identity["chunk"],
        listed=identity.get("listed", False),
        **identity["settings"],
    )


def make_plan(
    scene: SceneLike,
    vary: Mapping[str, Sequence[float]],
    seeds: int = 0,
    quantities: Sequence[str] | None = None,
    traces: bool = False,
    chunk: int | None = None,
    listed: bool = False,
    **settings: Any,
) -> Plan:
    """Check a sweep and prepare it.

    Raises:
        SceneError: an unknown path, quantity or setting, a value out of range, nothing to vary.
    """
    run_keys = [*declared_fields(RunSpec), *OPTIONS]
    check_settings(settings, [*run_keys, *stepper_settings()])
    changed = {f"run.{key}": settings.pop(key) for key in run_keys if key in settings}
    scene = load_scene(scene)
    if changed:
        scene = scene.with_values(changed)
    lists = {path: read_values(path, values) for path, values in vary.items()}
    if listed:
        _check_listed(lists, seeds)
    if seeds:
        lists[SEED] = np.arange(seeds) + first_seed(scene)
    if not lists:
        raise SceneError("vary: nothing is varied; needed: --vary name=lo:hi:n or --seeds K")
    if chunk is not None and chunk < 1:
        raise SceneError(f"chunk: {chunk}; allowed: a whole number >= 1")
    if quantities is None:
        quantities = list(QUANTITIES)
    _check_quantity_names(quantities)
    cases = _count_cases([values.size for values in lists.values()], len(quantities), listed)
    full = dict(zip(full_paths(scene, list(lists)), lists.values(), strict=True))
    base, built = _first_valid_case(scene, full, listed)
    axes = tuple(make_axis(base, path, values) for path, values in full.items())
    if chunk is None:
        chunk = default_chunk(not built[0].geometry.is_path, cases)
    plan = Plan(base, axes, tuple(quantities), traces, chunk, settings, listed, built)
    _check_named_quantities(plan)
    return plan


def _check_quantity_names(names: Sequence[str]) -> None:
    """Reject names that are neither in `QUANTITIES` nor of the form of all others."""
    for name in names:
        if name not in QUANTITIES and "." not in name:
            known = f"{nearest(name, QUANTITIES)}; also SIGNAL.WHERE.STATISTIC, such as tension.chain.fairlead.max"
            raise SceneError(f"quantities: {name!r} is unknown; {known}")


def _first_valid_case(scene: Scene, lists: Mapping[str, np.ndarray], listed: bool) -> tuple[Scene, tuple[Model, State]]:
    """The scene of the first case that has a start, with its model and start.

    All values of a case are in its scene, so that an effect that the scene lacks exists. Cases of a grid are tried by
    the sum of their positions along the axes: one step along each axis, then two.

    Raises:
        SceneError: that of the first case, if none of `MOST_TRIED_CASES` has a start.
    """
    shape = [values.size for values in lists.values()]
    if listed:
        positions = np.repeat(np.arange(shape[0])[:, None], len(shape), axis=1)
    else:
        positions = np.indices(shape).reshape(len(shape), -1).T
    order = np.argsort(positions.sum(axis=1), kind="stable")[:MOST_TRIED_CASES]
    errors = []
    for row in positions[order]:
        case = {path: values[i].item() for (path, values), i in zip(lists.items(), row, strict=True)}
        try:
            found = scene.with_values(case)
            return found, build(found)
        except SceneError as error:
            errors.append(error)
    raise errors[0]


def _check_named_quantities(plan: Plan) -> None:
    """Reject natural periods, and quantities that a model of some size lacks."""
    for one in plan.named_quantities:
        if one.signal == PERIOD:
            raise SceneError(
                "quantities: natural periods belong to a static pose. Use `dropper sensitivity --of period.1.start`"
            )
        for model in plan.models:
            quantity(one.name, model, "quantities")


def _check_listed(lists: Mapping[str, np.ndarray], seeds: int) -> None:
    """Reject a list of cases whose paths have different numbers of values, or with seeds."""
    counts = {path: values.size for path, values in lists.items()}
    if seeds:
        what = "seeds, which rows cannot have separately"
    elif len(set(counts.values())) > 1:
        what = f"lists of different lengths ({', '.join(f'{path} {count}' for path, count in counts.items())})"
    else:
        return
    raise SceneError(f"listed: {what}. Use equally many values of every path, without seeds")


def default_chunk(system: bool, cases: int) -> int:
    """Cases of a device at a time, where the user gives none.

    Args:
        system: whether a case is a system of lines, not a single one.
    """
    if jax.default_backend() == "cpu":
        return SYSTEM_CHUNK if system else CHUNK
    return min(cases, GPU_SYSTEM_CHUNK if system else GPU_CHUNK)


def _count_cases(counts: Sequence[int], quantities: int, listed: bool) -> int:
    """The number of cases of a grid or list with these numbers of values, whose table must fit into memory."""
    cases = counts[0] if listed else math.prod(counts)
    need = 8 * cases * (3 * len(counts) + quantities + 2)
    left = available_memory()
    if need > MOST_MEMORY * left:
        what = f"{' x '.join(map(str, counts))} values are {cases:.3g} cases"
        raise SceneError(
            f"vary: {what}, whose table needs {in_words(need)} of memory; only {in_words(left)} are free. Use fewer"
        )
    return cases
