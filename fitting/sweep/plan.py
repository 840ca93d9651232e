"""Definition of a sweep: the grid of cases, how each value enters the model, and what identifies the sweep.

A value that only replaces numbers of the model (a damping coefficient) is set inside the compiled program. Any other
value (a length, a sea state, a start angle) goes through the scene, on the host, once per distinct combination. Values
that change the number of links or nodes (a number of droppers) get a program for each shape of the model; arrays over
links and nodes then have those of the largest case, and NaN where a case has fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np

from dropper_jax import Scene, load_scene
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.memory import available_memory, in_words
from dropper_jax.base.read import ScenePath, Table, declared_fields
from dropper_jax.integrators import OPTIONS
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.run.arrays import bare_model
from dropper_jax.run.build import SceneLike, build, build_model, stepper_of
from dropper_jax.run.quantities import Quantity
from dropper_jax.run.quantity_names import quantity
from dropper_jax.run.statistics import PERIOD
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.stepper import check_settings, stepper_settings
from fitting.sweep.axes import Axis, first_seed, full_paths, make_axis, read_values

#: Quantities that can be recorded for each case, with unit and meaning; `links` and `trace` add dimensions.
QUANTITIES = {
    "tension_max": ("N", "maximum tension of any link"),
    "tension_mean": ("N", "mean tension over links and time"),
    "tension_min": ("N", "minimum tension of any link"),
    "angle_max": ("rad", "maximum angle of each link from the downward vertical"),
    "excursion": ("m", "maximum distance of a node from its start position"),
    "energy_final": ("J", "kinetic and potential energy at the end"),
}
#: What else may be stored, with unit and meaning.
TRACES = {"positions": ("m", "position of the free nodes"), "tension": ("N", "tension of the links")}
#: What is always stored: a chunk with a status is complete.
MARKS = {"failed_at": ("s", "time of the first failed step"), "status": ("1", "how the case ended")}
#: Dimensions of the arrays besides the cases.
DIMENSIONS = {"angle_max": ("link",), "positions": ("time", "node", "axis"), "tension": ("time", "link")}
SEED = "sea.waves.seed"
STATUS = ("ok", "not_converged", "non_finite", "invalid_input")
FORMAT = 1


@dataclass(frozen=True)
class Plan:
    """A sweep before it runs.

    Attributes:
        scene: the base case.
        axes: varied inputs; the last one varies fastest.
        quantities: names from `QUANTITIES`, or of `dropper_jax.run.quantity_names`.
        traces: also record nodes' positions and tensions at every saved time.
        chunk: cases advanced together on one device.
        settings: further fields of `Stepper`.
        listed: whether the axes' values are paired row by row instead of combined.
        built: model and start of the scene, if they are built already: an equilibrium at the start takes seconds.
    """

    scene: Scene
    axes: tuple[Axis, ...]
    quantities: tuple[str, ...]
    traces: bool = False
    chunk: int = 64
    settings: dict[str, Any] = field(default_factory=dict)
    listed: bool = False
    built: tuple[Model, State] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis; of listed cases only their number."""
        found = tuple(len(axis.values) for axis in self.axes)
        if self.listed:
            return found[:1]
        return found

    @property
    def cases(self) -> int:
        """Number of cases."""
        return math.prod(self.shape)

    @property
    def chunks(self) -> int:
        """Number of chunks, of which the last may have fewer cases."""
        return -(-self.cases // self.chunk)

    @cached_property
    def base(self) -> tuple[Model, State]:
        """Model and start of the base case."""
        if self.built is not None:
            return self.built
        return build(self.scene)

    @cached_property
    def stepper(self) -> Stepper:
        """The stepper of the base case, with the further settings."""
        return stepper_of(self.base[0], self.scene.run, **{"track_work": False, **self.settings})

    @property
    def is_adaptive(self) -> bool:
        """Whether the steps of each case follow the accuracy of the scene."""
        return self.scene.run.accuracy is not None

    @property
    def interval(self) -> float:
        """Length of equal steps, or of the interval between saved states with an accuracy [s]."""
        run = self.scene.run
        if self.is_adaptive:
            return run.interval
        return run.step

    @cached_property
    def named_quantities(self) -> tuple[Quantity, ...]:
        """The quantities that are not in `QUANTITIES`."""
        names = [name for name in self.quantities if name not in QUANTITIES]
        return tuple(quantity(name, self.base[0], "quantities") for name in names)

    @cached_property
    def models(self) -> list[Model]:
        """One model for each combination of the values that change the number of links or nodes."""
        own = [axis for axis in self.axes if axis.resizes]
        if not own:
            return [self.base[0]]
        combine = zip if self.listed else itertools.product
        found = []
        for row in dict.fromkeys(combine(*(axis.values.tolist() for axis in own))):
            with suppress(SceneError):  # such a case has the status invalid_input
                values = {axis.path: value for axis, value in zip(own, row, strict=True)}
                found.append(bare_model(self.scene.with_values(values)))
        return found

    @cached_property
    def links(self) -> int:
        """Number of links of the largest case."""
        return max(model.line.links for model in self.models)

    @cached_property
    def free_nodes(self) -> int:
        """Number of free nodes of the largest case."""
        return max(model.free_nodes for model in self.models)

    @property
    def stored(self) -> dict[str, tuple[str, str]]:
        """Unit and meaning of the arrays in the store, by name, the mark of a complete chunk last."""
        named = {one.name: (one.unit, one.name) for one in self.named_quantities}
        found = {name: (QUANTITIES | named)[name] for name in self.quantities}
        if self.traces:
            found |= TRACES
        return found | MARKS

    def inner_shape(self, name: str) -> tuple[int, ...]:
        """Shape of the array of a case, with the links and nodes of the largest one."""
        sizes = {"time": self.scene.run.rows, "node": self.free_nodes, "link": self.links, "axis": 3}
        return tuple(sizes[dimension] for dimension in DIMENSIONS.get(name, ()))

    def inputs(self, cases: np.ndarray) -> np.ndarray:
        """Values (cases, axes) of case numbers."""
        if self.listed:
            columns = [axis.values[cases] for axis in self.axes]
        else:
            index = np.unravel_index(cases, self.shape)
            columns = [axis.values[i] for axis, i in zip(self.axes, index, strict=True)]
        return np.stack(columns, axis=-1).astype(float)

    def cases_of(self, chunk: int) -> np.ndarray:
        """Case numbers of a chunk."""
        return np.arange(chunk * self.chunk, min((chunk + 1) * self.chunk, self.cases))

    def extreme_cases(self) -> dict[str, Scene]:
        """Scenes of at most four cases by their values: the corners of the grid, or the outermost rows of a list.

        Seeds have no order: they stay at the first one.
        """
        values = self.inputs(np.arange(self.cases))
        ordered = np.array([axis.path != SEED for axis in self.axes])
        span = np.where(ordered, np.ptp(values, axis=0), 0.0)
        position = (values - values.min(axis=0)) * np.divide(1.0, span, out=np.zeros(len(span)), where=span > 0.0)
        alternating = (-1.0) ** np.arange(len(self.axes))
        corners = []
        for direction in (np.ones(len(self.axes)), alternating):
            along = position @ direction
            corners += [int(np.argmin(along)), int(np.argmax(along))]
        found = {}
        for case in dict.fromkeys(corners):
            changed = {}
            for axis, x in zip(self.axes, values[case], strict=True):
                changed[axis.path] = axis.values.dtype.type(x).item()
            name = ", ".join(f"{path} = {value:g}" for path, value in changed.items())
            with suppress(SceneError):  # such a case has the status invalid_input
                found[name] = self.scene.with_values(changed)
        return found

    def identity(self) -> Table:
        """Plain values that identify the sweep; `from_identity` makes the same plan from them."""
        found = {
            "format": FORMAT,
            "scene": self.scene.as_written(),
            "vary": {axis.path: axis.values.tolist() for axis in self.axes},
            "quantities": list(self.quantities),
            "traces": self.traces,
            "chunk": self.chunk,
            "settings": self.settings,
        }
        if self.listed:
            found["listed"] = True
        template = self.scene.template
        sections = [ScenePath(axis.path).section for axis in self.axes]
        if template is not None and "parameters" in sections:
            found["template"] = {"table": template.table, "changes": template.changes}
        return found


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
    for name in quantities:
        if name not in QUANTITIES and "." not in name:
            known = f"{nearest(name, QUANTITIES)}; also SIGNAL.WHERE.STATISTIC, such as tension.chain.fairlead.max"
            raise SceneError(f"quantities: {name!r} is unknown; {known}")
    cases = _count_cases([values.size for values in lists.values()], len(quantities), listed)
    full = dict(zip(full_paths(scene, list(lists)), lists.values(), strict=True))
    # the first value of every axis is in the base scene, so that an effect that the scene lacks exists
    base = scene.with_values({path: values[0].item() for path, values in full.items()})
    axes = tuple(make_axis(base, path, values) for path, values in full.items())
    if chunk is None:
        chunk = default_chunk(not build_model(base).geometry.is_path, cases)
    plan = Plan(base, axes, tuple(quantities), traces, chunk, settings, listed)
    _check_named_quantities(plan)
    return plan


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


#: Cases of a device at a time, where the user gives none: those of 7 links then stay in the cache of a core. Cases of
#: a system of lines run one after another, so that larger chunks gain nothing.
CHUNK = 64
SYSTEM_CHUNK = 1
#: The same on a GPU, where each operation costs the same for one case as for thousands. An H200 runs 131 072 lab
#: droppers only 1.14 times as fast per case.
GPU_CHUNK = 16384
GPU_SYSTEM_CHUNK = 256


def default_chunk(system: bool, cases: int) -> int:
    """Cases of a device at a time, where the user gives none.

    Args:
        system: whether a case is a system of lines, not a single one.
    """
    sizes = (CHUNK, SYSTEM_CHUNK)
    if jax.default_backend() != "cpu":
        sizes = (min(GPU_CHUNK, cases), min(GPU_SYSTEM_CHUNK, cases))
    return sizes[system]


def _count_cases(counts: Sequence[int], quantities: int, listed: bool) -> int:
    """The number of cases of a grid or list with these numbers of values, whose table must fit into memory."""
    cases = math.prod(counts)
    if listed:
        cases = counts[0]
    need = 8 * cases * (3 * len(counts) + quantities + 2)
    left = available_memory()
    if need > 0.5 * left:  # the table of all cases may use half of the free memory
        what = f"{' x '.join(map(str, counts))} values are {cases:.3g} cases"
        raise SceneError(
            f"vary: {what}, whose table needs {in_words(need)} of memory; only {in_words(left)} are free. Use fewer"
        )
    return cases
