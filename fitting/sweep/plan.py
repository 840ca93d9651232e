"""Definition of a sweep: the grid of cases, how each value enters the model, and what identifies the sweep.

A value that only replaces numbers of the model (a damping coefficient) is set inside the compiled program. Any other
value (a length, a sea state, a start angle) goes through the scene, on the host, once per distinct combination. Values
that change the number of links or nodes (a number of droppers) get a program for each shape of the model; arrays over
links and nodes then have those of the largest case, and NaN where a case has fewer.
"""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from dropper_jax import Scene
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath, Table
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build, stepper_of
from dropper_jax.modelling.scene_model import bare_model
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.residual import Stepper
from fitting.sweep.axes import Axis
from fitting.sweep.effect_files import effect_digests

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
        quantities: names from `QUANTITIES`, or of `dropper_jax.quantities.quantity_names`.
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
            changed = {axis.path: axis.plain(x) for axis, x in zip(self.axes, values[case], strict=True)}
            name = ", ".join(f"{path} = {value:g}" for path, value in changed.items())
            with suppress(SceneError):  # such a case has the status invalid_input
                found[name] = self.scene.with_values(changed)
        return found

    def identity(self) -> Table:
        """Plain values that identify the sweep; `make_plan.from_identity` makes the same plan from them."""
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
        if effects := effect_digests(self.scene):
            found["effects"] = effects
        template = self.scene.template
        sections = [ScenePath(axis.path).section for axis in self.axes]
        if template is not None and "parameters" in sections:
            found["template"] = {"table": template.table, "changes": template.changes}
        return found
