"""One compiled program that runs a chunk of cases on every device and returns only the requested quantities."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import PartitionSpec

from dropper_jax import SceneError
from dropper_jax.backend import is_plain
from dropper_jax.backend.batches import map_members
from dropper_jax.backend.one_kernel import one_kernel
from dropper_jax.backend.programs import KERNEL_OPTIONS, OPTIONS, compile_lowered
from dropper_jax.lanes import lanes
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build
from fitting.parameters.paths import resolve
from fitting.sweep.case_run import run_case
from fitting.sweep.plan import STATUS, Plan

#: Number of steps of all cases from which a system of lines repays the compilation of one kernel; see
#: `backend.programs.LARGEST_KERNEL`.
WORTH_ONE_KERNEL = 40_000
#: Compiler option of lanes: XLA prefers half of the widest vector registers, which takes 1.18 times as long.
LANES_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
#: Cases are split over the devices.
BY_DEVICE = PartitionSpec("device")

#: A pytree of arrays.
Tree = TypeVar("Tree")
#: Structure and shapes of a model's arrays: models with the same one share a program.
Shape = tuple[Any, ...]


class BuiltCase(NamedTuple):
    """Model and start of a case, and the shape of the model."""

    shape: Shape
    model: Model
    start: State


class ShapeGroup(NamedTuple):
    """Cases whose models have one shape: which members they are (members,), and arguments of the program for all
    members, with substitutes for the others."""

    shape: Shape
    is_member: np.ndarray
    arguments: tuple[Any, ...]


class RunningChunks(NamedTuple):
    """Chunks in progress.

    Attributes:
        chunks: their numbers; rejected: cases that the scene rejects (members,).
        groups: of each shape, which members have it (members,) and their arrays (members, ...).
    """

    chunks: list[int]
    rejected: np.ndarray
    groups: list[tuple[np.ndarray, dict[str, Array]]]


class Program:
    """Runs of a plan, `devices` chunks at a time, default one on every device.

    Results do not depend on the number of devices or on which chunks run together: a case has a fixed position in its
    chunk, and the chunk runs on one device. A chunk with models of several shapes runs once for each of them.
    """

    def __init__(self, plan: Plan, devices: int | None = None) -> None:
        self.plan = plan
        self.devices = devices or jax.local_device_count()
        #: Numbers of the axes whose values go through the scene, and of those that need a start of their own.
        self.by_scene = [i for i, axis in enumerate(plan.axes) if not axis.parameters]
        self.by_start = [i for i, axis in enumerate(plan.axes) if axis.moves_start]
        model_axis = 0 if self.by_scene else None
        start_axis = 0 if self.by_start else None
        #: Axis of cases of the model, the start, the values and the step; None for one of all cases.
        self.in_axes: tuple[Literal[0] | None, ...] = (model_axis, start_axis, 0, None)
        self._specs = tuple(PartitionSpec() if axis is None else BY_DEVICE for axis in self.in_axes)
        self.mesh = jax.make_mesh((self.devices,), ("device",), devices=jax.local_devices()[: self.devices])
        # Cases of a line advance side by side, 2.3 times as fast as one after another. Those of a system do not: nine
        # cases of a longline (52 links, 750 steps) then compile for 21 s in place of 8 and run for 6.1 s in place of
        # 5.3. Nor do those with set-valued laws, whose search for sticking joints would run in every step.
        # Nor do cases with an accuracy, each of which has steps of its own.
        is_path = plan.base[0].geometry.is_path
        self.side_by_side = is_path and not (plan.is_adaptive or plan.stepper.easing or is_plain())
        #: By the shape of their models, plans with a case of that shape as their base, and programs made so far.
        self._plans = {shape_of(plan.base[0]): plan}
        self._programs: dict[Shape, jax.stages.Compiled] = {}

    def compile(self, chunks: list[int]) -> None:
        """Make the programs of these chunks; every call is of the same shapes."""
        for group in self._group_by_shape(chunks)[0]:
            self._compiled_program(group)

    def __call__(self, chunks: list[int]) -> RunningChunks:
        """Start the chunks (at most one per device); `collect` waits for the results."""
        groups, rejected = self._group_by_shape(chunks)
        started = [(group.is_member, self._compiled_program(group)(*group.arguments)) for group in groups]
        return RunningChunks(chunks, rejected, started)

    def run_extra_case(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """One more case, with other values (axes,), by the same compiled program; arrays (1, ...) by name."""
        axes = tuple(replace(axis, values=np.array([x])) for axis, x in zip(self.plan.axes, values, strict=True))
        other = copy(self)  # shares the compiled programs
        other.plan = replace(self.plan, axes=axes, listed=True)
        return other.collect(other([0]))[0]

    def collect(self, running: RunningChunks) -> dict[int, dict[str, np.ndarray]]:
        """Results by chunk: each quantity, `status` and `failed_at` (cases,)."""
        found = {}
        for is_member, arrays in running.groups:
            for name, array in arrays.items():
                value = np.asarray(array)
                if name not in found:
                    fill = np.nan if value.dtype.kind == "f" else 0
                    shape = (len(value), *self.plan.inner_shape(name))  # that of the largest case
                    found[name] = np.full(shape, fill, value.dtype)
                found[name][(is_member, *map(slice, value.shape[1:]))] = value[is_member]
        found["status"][running.rejected] = STATUS.index("invalid_input")
        for name in found.keys() - {"status", "failed_at"}:
            found[name][found["status"] != 0] = np.nan
        by_chunk: dict[int, dict[str, np.ndarray]] = {}
        for i, chunk in enumerate(running.chunks):
            first = i * self.plan.chunk
            cases = slice(first, first + len(self.plan.cases_of(chunk)))
            by_chunk[chunk] = {name: value[cases] for name, value in found.items()}
        return by_chunk

    def _group_by_shape(self, chunks: list[int]) -> tuple[list[ShapeGroup], np.ndarray]:
        """The members of these chunks by shape, and which cases (members,) the scene rejects."""
        values = self._input_values(chunks)
        keys = [tuple(row[self.by_start]) for row in values]
        built = {key: self._build_case(key) for key in dict.fromkeys(keys)}
        rejected = np.array([built[key] is None for key in keys])
        # a rejected case runs as the first valid one, and its results are dropped
        base = BuiltCase(next(iter(self._plans)), *self.plan.base)
        valid = next(filter(None, built.values()), base)
        cases = [built[key] or valid for key in keys]
        substitutes: dict[Shape, BuiltCase] = {}
        for case in cases:
            substitutes.setdefault(case.shape, case)
        found = []
        for shape, substitute in substitutes.items():
            is_member = np.array([case.shape == shape for case in cases])
            members = [case if own else substitute for case, own in zip(cases, is_member, strict=True)]
            model = base.model
            start = base.start
            if self.by_scene:
                model = stack_trees([case.model for case in members])
            if self.by_start:
                start = stack_trees([case.start for case in members])
            found.append(ShapeGroup(shape, is_member, self._arguments(model, start, values)))
        return found, rejected

    def _input_values(self, chunks: list[int]) -> np.ndarray:
        """Values (members, axes) of these chunks, filled up: programs have one shape.

        Devices without a chunk repeat the last one, and a short chunk repeats its cases.
        """
        padded = np.pad(chunks, (0, self.devices - len(chunks)), mode="edge")
        cases = [np.resize(self.plan.cases_of(chunk), self.plan.chunk) for chunk in padded]
        return self.plan.inputs(np.concatenate(cases))

    def _arguments(self, model: Model, start: State, values: np.ndarray) -> tuple[Any, ...]:
        """Arguments of a program on its devices."""
        dtype = self.plan.base[0].dtype
        arguments = (model, start, jnp.asarray(values, dtype), jnp.asarray(self.plan.interval, dtype))
        shardings = [jax.NamedSharding(self.mesh, spec) for spec in self._specs]
        return tuple(map(jax.device_put, arguments, shardings))

    def _build_case(self, key: tuple[float, ...]) -> BuiltCase | None:
        """The case with these values of the axes `by_start`, for whose shape there then is a plan; None if the scene
        rejects it."""
        plan = self.plan
        if not key:
            return BuiltCase(next(iter(self._plans)), *plan.base)
        axes = [plan.axes[i] for i in self.by_start]
        values = {axis.path: axis.plain(x) for axis, x in zip(axes, key, strict=True)}
        try:
            scene = plan.scene.with_values(values)
            model, start = build(scene)
        except SceneError:
            return None
        shape = shape_of(model)
        if shape not in self._plans:
            if model.line.links > plan.links or model.free_nodes > plan.free_nodes:
                what = "has more links or nodes than the lowest and the highest value"
                raise SceneError(f"vary: {', '.join(values)}: a value {what}. Use one sweep for each value")
            own = []
            for axis in plan.axes:
                if axis.parameters:  # numbers of another model
                    axis = replace(axis, parameters=resolve(model, [axis.path], option="vary"))
                own.append(axis)
            self._plans[shape] = replace(plan, scene=scene, axes=tuple(own), built=(model, start))
        return BuiltCase(shape, model, start)

    def _compiled_program(self, group: ShapeGroup) -> jax.stages.Compiled:
        """The program of a shape, compiled at its first call; as one kernel, unless its runs are too brief."""
        if group.shape not in self._programs:
            plan = self._plans[group.shape]
            run = partial(run_case, plan, plan.stepper)
            if self.side_by_side:
                chunk = one_kernel(lanes(run, self.in_axes))
                options = LANES_OPTIONS
            elif self.plan.cases * self.plan.scene.run.steps < WORTH_ONE_KERNEL:
                chunk = map_members(run, self.in_axes)
                options = OPTIONS
            else:
                chunk = one_kernel(map_members(run, self.in_axes))
                options = KERNEL_OPTIONS
            specs = self._specs
            mapped = jax.shard_map(chunk, mesh=self.mesh, in_specs=specs, out_specs=BY_DEVICE, check_vma=False)
            self._programs[group.shape] = compile_lowered(jax.jit(mapped).lower(*group.arguments), options)
        return self._programs[group.shape]


def shape_of(model: Model) -> Shape:
    """Structure and shapes of a model's arrays."""
    return jax.tree.structure(model), tuple(map(jnp.shape, jax.tree.leaves(model)))


def stack_trees(trees: Sequence[Tree]) -> Tree:
    """Pytrees of one structure stacked along a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
