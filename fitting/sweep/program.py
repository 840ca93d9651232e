"""One compiled program that runs a chunk of cases on every device and returns only the requested quantities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from dropper_jax.base.numerics import safe_norm
from dropper_jax.lanes import lanes
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_extremes import quantity_signals
from dropper_jax.quantities.statistics import statistic
from dropper_jax.residual import Stepper
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.observe import observe
from dropper_jax.stepping.progress import Progress, Trajectory, begin
from fitting.parameters.parameter import with_parameter_values
from fitting.parameters.paths import resolve
from fitting.sweep.plan import STATUS, Plan

#: Number of steps of all cases from which a system of lines repays the compilation of one kernel; see
#: `backend.programs.LARGEST_KERNEL`.
WORTH_ONE_KERNEL = 40_000
#: Compiler option of lanes: XLA prefers half of the widest vector registers, which takes 1.18 times as long.
LANES_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
#: Cases are split over the devices.
BY_DEVICE = PartitionSpec("device")


class Tally(NamedTuple):
    """Running extremes and sums of one case; `cosine` (n,) is the minimum of each link's angle from straight down."""

    largest: Array
    smallest: Array
    total: Array
    cosine: Array
    excursion: Array
    residual: Array


Carry = tuple[Progress, Tally]
#: A pytree of arrays.
Tree = TypeVar("Tree")
#: Structure and shapes of a model's arrays: models with the same one share a program.
Shape = tuple[Any, ...]


class Members(NamedTuple):
    """Members whose models have one shape: which they are (members,), and arguments for all, with stand-ins for the
    others."""

    shape: Shape
    own: np.ndarray
    arguments: tuple[Any, ...]


class Pending(NamedTuple):
    """Chunks in progress.

    Attributes:
        chunks: their numbers; refused: cases that the scene rejects (members,).
        started: of each shape, which members have it (members,) and their arrays (members, ...).
    """

    chunks: list[int]
    refused: np.ndarray
    started: list[tuple[np.ndarray, dict[str, Array]]]


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
        self._plans = {_shape_of(plan.base[0]): plan}
        self._programs: dict[Shape, jax.stages.Compiled] = {}

    def compile(self, chunks: list[int]) -> None:
        """Make the programs of these chunks; every call is of the same shapes."""
        for shape, _, arguments in self._members(chunks)[0]:
            self._program(shape, arguments)

    def __call__(self, chunks: list[int]) -> Pending:
        """Start the chunks (at most one per device); `collect` waits for the results."""
        members, refused = self._members(chunks)
        started = [(own, self._program(shape, arguments)(*arguments)) for shape, own, arguments in members]
        return Pending(chunks, refused, started)

    def at(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """One more case, with other values (axes,), by the same compiled program; arrays (1, ...) by name."""
        axes = tuple(replace(axis, values=np.array([x])) for axis, x in zip(self.plan.axes, values, strict=True))
        other = copy(self)  # shares the compiled programs
        other.plan = replace(self.plan, axes=axes, listed=True)
        return other.collect(other([0]))[0]

    def collect(self, pending: Pending) -> dict[int, dict[str, np.ndarray]]:
        """Results by chunk: each quantity, `status` and `failed_at` (cases,)."""
        found = {}
        for own, arrays in pending.started:
            for name, array in arrays.items():
                value = np.asarray(array)
                if name not in found:
                    fill = np.nan if value.dtype.kind == "f" else 0
                    shape = (len(value), *self.plan.inner_shape(name))  # that of the largest case
                    found[name] = np.full(shape, fill, value.dtype)
                found[name][(own, *map(slice, value.shape[1:]))] = value[own]
        found["status"] = np.where(pending.refused, STATUS.index("invalid_input"), found["status"]).astype(np.int8)
        for name in found.keys() - {"status", "failed_at"}:
            found[name][found["status"] != 0] = np.nan
        by_chunk: dict[int, dict[str, np.ndarray]] = {}
        for i, chunk in enumerate(pending.chunks):
            first = i * self.plan.chunk
            own = slice(first, first + len(self.plan.cases_of(chunk)))
            by_chunk[chunk] = {name: value[own] for name, value in found.items()}
        return by_chunk

    def _members(self, chunks: list[int]) -> tuple[list[Members], np.ndarray]:
        """The members of these chunks by shape, and which cases (members,) the scene rejects."""
        values = self._values(chunks)
        base = self.plan.base
        if not self.by_start:
            (shape,) = self._plans
            every = np.ones(len(values), bool)
            return [Members(shape, every, self._arguments(*base, values))], ~every
        keys = [tuple(row[self.by_start]) for row in values]
        built = {key: self._build(key) for key in dict.fromkeys(keys)}
        refused = np.array([built[key] is None for key in keys])
        # a refused case runs as the first valid one, and its results are dropped
        valid = next(filter(None, built.values()), (next(iter(self._plans)), base))
        cases = [built[key] or valid for key in keys]
        substitutes: dict[Shape, tuple[Model, State]] = {}
        for shape, case in cases:
            substitutes.setdefault(shape, case)
        found = []
        for shape, substitute in substitutes.items():
            own = np.array([shape == other for other, _ in cases])
            bases = [case if mine else substitute for mine, (_, case) in zip(own, cases, strict=True)]
            models, starts = zip(*bases, strict=True)
            model = stack(models) if self.by_scene else base[0]
            found.append(Members(shape, own, self._arguments(model, stack(starts), values)))
        return found, refused

    def _values(self, chunks: list[int]) -> np.ndarray:
        """Values (members, axes) of these chunks, filled up: programs have one shape.

        Devices without a chunk repeat the last one, and a short chunk repeats its cases.
        """
        padded = np.pad(chunks, (0, self.devices - len(chunks)), mode="edge")
        cases = [np.resize(self.plan.cases_of(chunk), self.plan.chunk) for chunk in padded]
        return self.plan.inputs(np.concatenate(cases))

    def _arguments(self, model: Model, start: State, values: np.ndarray) -> tuple[Any, ...]:
        """Arguments of a program on its devices."""
        plan = self.plan
        dtype = plan.base[0].dtype
        arguments = (model, start, jnp.asarray(values, dtype), jnp.asarray(plan.interval, dtype))
        shardings = [jax.NamedSharding(self.mesh, spec) for spec in self._specs]
        return tuple(map(jax.device_put, arguments, shardings))

    def _build(self, key: tuple[float, ...]) -> tuple[Shape, tuple[Model, State]] | None:
        """Model and start of a case, and their shape, for which there then is a plan."""
        plan = self.plan
        axes = [plan.axes[i] for i in self.by_start]
        values = {axis.path: axis.plain(x) for axis, x in zip(axes, key, strict=True)}
        try:
            base = build(plan.scene.with_values(values))
        except SceneError:
            return None
        shape = _shape_of(base[0])
        if shape not in self._plans:
            if base[0].line.links > plan.links or base[0].free_nodes > plan.free_nodes:
                what = "has more links or nodes than the first and the last value"
                raise SceneError(f"vary: {', '.join(values)}: a value {what}. Use one sweep for each value")
            own = []
            for axis in plan.axes:
                if axis.parameters:  # numbers of another model
                    axis = replace(axis, parameters=resolve(base[0], [axis.path], option="vary"))
                own.append(axis)
            scene = plan.scene.with_values(values)
            self._plans[shape] = replace(plan, scene=scene, axes=tuple(own), built=base)
        return shape, base

    def _program(self, shape: Shape, arguments: tuple[Any, ...]) -> jax.stages.Compiled:
        """The program of a shape, compiled at its first call; as one kernel, unless its runs are too brief."""
        if shape not in self._programs:
            run = partial(run_case, self._plans[shape], self._plans[shape].stepper)
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
            self._programs[shape] = compile_lowered(jax.jit(mapped).lower(*arguments), options)
        return self._programs[shape]


def _shape_of(model: Model) -> Shape:
    """Structure and shapes of a model's arrays."""
    return jax.tree.structure(model), tuple(map(jnp.shape, jax.tree.leaves(model)))


def stack(trees: Sequence[Tree]) -> Tree:
    """Pytrees of one structure stacked along a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def run_case(plan: Plan, stepper: Stepper, model: Model, start: State, values: Array, dt: Array) -> dict[str, Array]:
    """One case, with these values (axes,), from start to end; a pure function to batch."""
    for axis, value in zip(plan.axes, values, strict=True):
        if axis.parameters:
            model = with_parameter_values(model, axis.parameters, jnp.broadcast_to(value, (len(axis.parameters),)))
    run = plan.scene.run
    named = plan.named_quantities
    watch = None
    if run.save_every > 1 or plan.is_adaptive:
        watch = quantity_signals(named, start.r)
    accuracy = jnp.asarray(run.accuracy, model.dtype) if plan.is_adaptive else None

    def save(carry: Carry, _: None) -> tuple[Carry, dict[str, Array]]:
        progress, tally = carry
        progress, row = advance(stepper, model, progress, dt, 1, run.save_every, accuracy, watch=watch)
        tally = _add_row(model, start, progress.state, tally, row)
        extremes = {}
        if watch is not None and row.extremes is not None:
            extremes = watch.over_steps(row.extremes)
        return (progress, tally), _saved_values(plan, model, start, progress.state, extremes)

    first = begin(stepper, model, start, plan.is_adaptive)
    (progress, tally), saved = jax.lax.scan(save, (first, _empty_tally(start)), None, length=run.rows)
    for one in named:
        if one.at_rest:  # the start is not among the saved states
            saved[one.name] = one.of_state(model, start)
        else:
            saved[one.name] = statistic(one.statistic, saved[one.name], run.interval, over_steps=watch is not None)
    for name, value in _known_quantities(model, progress.state, tally, run.rows).items():
        if name in plan.quantities:
            saved[name] = value
    failed = progress.first_bad >= 0
    why = jnp.where(jnp.isfinite(tally.residual), STATUS.index("not_converged"), STATUS.index("non_finite"))
    saved["status"] = jnp.where(failed, why, 0).astype(jnp.int8)
    saved["failed_at"] = jnp.where(failed, (progress.first_bad + 1) * dt, jnp.nan)
    return saved


def _saved_values(
    plan: Plan, model: Model, start: State, s: State, extremes: Mapping[Quantity, Array]
) -> dict[str, Array]:
    """What is saved of a case in state s: the named quantities, by their extremes since the last one if these are
    known, and the traces."""
    saved = {}
    for one in plan.named_quantities:
        if one in extremes:
            saved[one.name] = extremes[one]
        elif not one.at_rest:
            saved[one.name] = one.instant(model, start.r, s.r, s.v, s.tension, s.t, s.parted)
    if plan.traces:
        saved |= {"positions": s.r, "tension": s.tension}
    return saved


def _empty_tally(start: State) -> Tally:
    """The tally of a case that has not started."""
    zero = jnp.zeros((), start.r.dtype)
    return Tally(zero - jnp.inf, zero + jnp.inf, zero, jnp.ones_like(start.tension), zero, zero)


def _known_quantities(model: Model, s: State, tally: Tally, rows: int) -> dict[str, Array]:
    """All of `QUANTITIES` of a case that ended in state s, by name; those that are not returned cost nothing."""
    end = observe(model, s.r, s.v, s.t, s.parted, s.own)
    return {
        "tension_max": tally.largest,
        "tension_mean": tally.total / rows,
        "tension_min": tally.smallest,
        "angle_max": jnp.arccos(jnp.clip(tally.cosine, -1.0, 1.0)),
        "excursion": tally.excursion,
        "energy_final": end.kinetic + end.potential,
    }


def _add_row(model: Model, start: State, s: State, tally: Tally, row: Trajectory) -> Tally:
    """The tally with a saved row of the run, which ends in state s."""
    links = model.links(s.r, model.ends(s.t))
    length = model.line.length
    if model.line.axial.elastic:  # rigid links keep their lengths
        length = safe_norm(links)
    tension = row.tension[0]
    smallest = tension
    largest = tension
    if row.extremes is not None:
        smallest, largest = (rows[0, : tension.size] for rows in row.extremes[:2])
    # a NaN is permanent: `maximum` propagates it
    return Tally(
        jnp.maximum(tally.largest, jnp.max(largest)),
        jnp.minimum(tally.smallest, jnp.min(smallest)),
        tally.total + jnp.mean(tension),
        jnp.minimum(tally.cosine, -links[:, 2] / length),
        jnp.maximum(tally.excursion, jnp.max(safe_norm(s.r - start.r))),
        jnp.maximum(tally.residual, row.residual[0]),
    )
