"""`sweep`: a grid of cases in batches over all devices, stored chunk by chunk, resumable; also over a Dask cluster."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import versions
from dropper_jax.base.progress import Progress, silent
from dropper_jax.effects import register_installed
from dropper_jax.modelling.build import SceneLike
from dropper_jax.run.step_verdict import StepVerdict, check_steps
from dropper_jax.run.storage import extra
from fitting.sweep.cluster import run_on_cluster
from fitting.sweep.make_plan import from_identity, make_plan
from fitting.sweep.plan import Plan
from fitting.sweep.program import Program
from fitting.sweep.store import IDENTITY, SweepStore, input_names

if TYPE_CHECKING:
    import xarray

#: Arrays of one chunk by name, each (cases, ...).
ChunkArrays = dict[str, np.ndarray]
#: A Dask client, or the address of a scheduler.
Scheduler = Any


@dataclass(frozen=True)
class SweepResult:
    """Result of a call.

    Attributes:
        path: the Zarr folder.
        cases, resumed: number of cases of the sweep, and how many of them were resumed.
        counts: cases by status.
        steps: time steps of one case.
        compile_s, run_s: wall time of the first chunks' compilation, and of everything after it [s]. With a
            scheduler the first chunk is run and compiled in the former.
        steps_per_s: steps of all cases that this call ran over `run_s`, saving included.
        plan: the sweep.
        verdict: on the step, from the runs of extreme cases (see `run.step_verdict`); stored as attribute `step_check`.
    """

    path: Path
    cases: int
    resumed: int
    counts: dict[str, int]
    steps: int
    compile_s: float
    run_s: float
    steps_per_s: float
    plan: Plan
    verdict: StepVerdict


def sweep(
    scene: SceneLike,
    vary: Mapping[str, Sequence[float]],
    out: str | Path,
    *,
    seeds: int = 0,
    quantities: Sequence[str] | None = None,
    traces: bool = False,
    chunk: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | None = None,
    mix_versions: bool = False,
    listed: bool = False,
    **settings: Any,
) -> SweepResult:
    """Run every combination of values and store the requested quantities in a Zarr folder.

    Values that change the number of links or nodes, such as `parameters.droppers`, get a program for each shape of the
    model. Arrays over links and nodes then have those of the largest case, and NaN where a case has fewer. A start that
    fails leaves no folder. The step of extreme cases is checked as `dropper run` does (see `SweepResult.verdict`).

    Args:
        scene: packaged name, TOML file, plain values or a `Scene`; its `[run]` sets step, duration and integrator.
        vary: values by path (or unique short name); the last one varies fastest.
        out: folder; if it contains a part of the same sweep, only the rest is run.
        seeds: number of realisations of a random sea.
        quantities: names from `QUANTITIES`, default all.
        traces: also store positions and tensions at every saved time.
        chunk: cases that a device runs before they are stored. Those of a single line advance side by side; default
            64, which keep 7 links in the cache of a core. Those of a system run one after another; default 1.
        scheduler: a Dask client or the address of a scheduler; its workers run the chunks.
        progress: called with the fraction done and a line of text.
        mix_versions: resume a part that was made with other versions of JAX or of this package.
        listed: pair the values, the first of every path, then the second: a list of cases, not a grid.
        **settings: keys of `[run]` (dt, duration, integrator and others), which replace those of the scene, and further
            fields of `Stepper`.

    Raises:
        SceneError: for any invalid input.
        SweepStopped: the disk cannot be written; the finished chunks are kept.
    """
    plan = make_plan(scene, vary, seeds, quantities, traces, chunk, listed, **settings)
    store = SweepStore(out, plan, versions(), mix_versions)
    try:
        return _run_missing_chunks(store, scheduler, progress or silent)
    except BaseException:
        store.remove_if_empty()
        raise
    finally:
        store.close()


def _run_missing_chunks(store: SweepStore, scheduler: Scheduler | None, say: Progress) -> SweepResult:
    """Run the missing chunks, and check the step of the sweep if that was not done yet."""
    plan = store.plan
    todo = [chunk for chunk in range(plan.chunks) if not store.has(chunk)]
    missing = sum(len(plan.cases_of(chunk)) for chunk in todo)
    resumed = plan.cases - missing
    compile_s = 0.0
    run_s = 0.0
    if todo:
        started = time.perf_counter()
        if scheduler is None:
            results = _run_here(plan, todo)
        else:
            results = _run_on_scheduler(plan, todo, scheduler)
        compile_s = time.perf_counter() - started

        def rate_and_rest(ran: int, seconds: float) -> str:
            rate = ran / max(seconds, 1e-9)
            left = (missing - ran) / max(rate, 1e-9)
            return f"{rate * plan.scene.run.steps:.0f} steps/s, {left:.0f} s left"

        store.fill(results, resumed, plan.cases, say, rate_and_rest, lambda chunk: len(plan.cases_of(chunk)))
        run_s = time.perf_counter() - started - compile_s
    steps_per_s = missing * plan.scene.run.steps / run_s if run_s > 0.0 else 0.0
    verdict = store.verdict
    if verdict is None:
        verdict = check_steps(plan.extreme_cases(), say, **plan.settings)
        store.verdict = verdict
    return SweepResult(
        path=store.path,
        cases=plan.cases,
        resumed=resumed,
        counts=store.counts(),
        steps=plan.scene.run.steps,
        compile_s=compile_s,
        run_s=run_s,
        steps_per_s=steps_per_s,
        plan=plan,
        verdict=verdict,
    )


def _run_here(plan: Plan, todo: list[int]) -> Iterator[tuple[int, ChunkArrays]]:
    """Results chunk by chunk, of a program that is compiled here."""
    program = _compiled_program(json.dumps(plan.identity()), None)
    groups = [todo[i : i + program.devices] for i in range(0, len(todo), program.devices)]
    program.compile(groups[0])
    return _results_ahead(program, groups)


def _results_ahead(program: Program, groups: list[list[int]]) -> Iterator[tuple[int, ChunkArrays]]:
    """Results chunk by chunk; the next chunks run while these are written."""
    running = map(program, groups)
    pending = next(running)
    for ahead in running:
        yield from program.collect(pending).items()
        pending = ahead
    yield from program.collect(pending).items()


@lru_cache(maxsize=2)
def _compiled_program(identity: str, devices: int | None) -> Program:
    """Compiled once per process, for later calls and for all chunks of a worker."""
    return Program(from_identity(json.loads(identity)), devices)


def run_extra_case(plan: Plan, values: np.ndarray) -> ChunkArrays:
    """One more case of a sweep, with other values (axes,), by the program of its chunks: arrays (1, ...) by name."""
    return _compiled_program(json.dumps(plan.identity()), None).run_extra_case(values)


def run_chunk(identity: str, chunk: int) -> ChunkArrays:
    """One chunk of the sweep with this identity, on a worker."""
    register_installed()
    program = _compiled_program(identity, 1)
    return program.collect(program([chunk]))[chunk]


def _run_on_scheduler(plan: Plan, todo: list[int], scheduler: Scheduler) -> Iterator[tuple[int, ChunkArrays]]:
    """Results in the order in which the workers of a cluster finish, from the first one, which had to be compiled."""
    identity = json.dumps(plan.identity())
    jobs = [(identity, chunk) for chunk in todo]
    results = ((todo[i], found) for i, found in run_on_cluster(scheduler, run_chunk, jobs))
    return chain([next(results)], results)


def open_sweep(path: str | Path) -> xarray.Dataset:
    """The results on their grid: one dimension per varied input; of listed cases one dimension, `case`.

    Raises:
        SceneError: a folder that is not a sweep.
    """
    xr = extra("xarray", "io")
    extra("zarr", "sweep")
    try:
        flat = xr.open_zarr(path, consolidated=False, decode_times=False, mask_and_scale=False)
        identity = json.loads(flat.attrs[IDENTITY])
        names = input_names(list(identity["vary"]))
        flat = flat.set_coords(names)
        if identity.get("listed"):
            return flat
        if len(names) == 1:
            return flat.swap_dims(case=names[0])
        return _on_grid(flat.load(), dict(zip(names, identity["vary"].values(), strict=True)))
    except Exception as error:  # any error of xarray, Zarr and its codecs on damaged bytes
        reason = " ".join(str(error).split())[:200]
        raise SceneError(f"{path}: is not a sweep. Use a folder written by `dropper sweep` ({reason})") from None


def _on_grid(flat: xarray.Dataset, axes: dict[str, list[float]]) -> xarray.Dataset:
    """The results of cases, the last axis fastest, with a dimension for each axis, its values in increasing order."""
    numbers = np.unravel_index(np.arange(flat.sizes["case"]), [len(values) for values in axes.values()])
    # by number, because a value may be given twice
    numbered = flat.assign_coords({name: ("case", own) for name, own in zip(axes, numbers, strict=True)})
    grid = numbered.set_index(case=list(axes)).unstack("case")
    values = {name: (name, np.array(own, flat[name].dtype), flat[name].attrs) for name, own in axes.items()}
    return grid.assign_coords(values).sortby(list(axes)).transpose(*axes, ...)
