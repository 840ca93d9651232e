"""`[run]` of a scene: step, duration and scheme; `[start]`: how a run starts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    MOST,
    Plain,
    as_table,
    check_keys,
    count,
    declared_fields,
    plain,
    read_fields,
    read_number,
    read_table,
    refuse,
)
from dropper_jax.scene.line import LineSpec

#: Linear solvers by name, as `dropper_jax.solvers` offers them; importing that would load scipy for every scene reader.
SOLVERS = ("auto", "dense", "banded", "condensed", "network")


@dataclasses.dataclass(frozen=True, eq=False)
class RunSpec:
    """`[run]`: how the scene is simulated unless the caller specifies otherwise."""

    dt: float = parameter("time step", unit="s", low=0.0, open_low=True)
    duration: float = parameter("simulated time", unit="s", low=0.0, open_low=True)
    integrator: str = option("integrator", type=str, default="energy_momentum")
    solver: str = option("linear solver", choices=SOLVERS, default="auto")
    dtype: str = option("precision", choices=("float64", "float32"), default="float64")
    save_every: int = count("steps between saved states", default=1)
    step_tolerance: float | None = parameter(
        "tolerance of the error indicator of adaptive steps", unit="m/s", low=0.0, open_low=True, optional=True
    )
    error_tolerance: float | None = parameter(
        "error per step of schemes with error control (tsit5, dop853): of positions [m] and velocities",
        unit="m/s",
        low=0.0,
        open_low=True,
        high=0.1,
        optional=True,
    )
    options: dict[str, float] = dataclasses.field(default_factory=dict)  # of the scheme, by name

    @property
    def saves(self) -> int:
        """Saved states after the start, which cover the duration; a remainder below 1e-9 steps is attributed to
        rounding."""
        return -(-math.ceil(self.duration / self.dt - 1e-9) // self.save_every)

    @property
    def steps(self) -> int:
        """Total number of steps, a multiple of `save_every`."""
        return self.saves * self.save_every

    @classmethod
    def read(cls, table: Plain, path: str, options: Mapping[str, Mapping[str, Any]] | None = None) -> RunSpec:
        """A checked `[run]`; `options` are the additional keys of schemes, name and range."""
        options = options or {}
        given = read_table(table, path)
        check_keys(given, [*declared_fields(cls), *options], path)
        values = read_fields(cls, {key: value for key, value in given.items() if key not in options}, path, {})
        values["options"] = {
            key: read_number(given[key], f"{path}.{key}", declared) for key, declared in options.items() if key in given
        }
        if values["duration"] < values["dt"]:
            allowed = f"at least one step, {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], "is shorter than the step", allowed)
        if values["duration"] > MOST * values["dt"]:
            reason = f"takes {values['duration'] / values['dt']:.3g} steps of {values['dt']:g} s"
            raise refuse(f"{path}.duration", values["duration"], reason, f"at most {MOST} steps")
        if values["step_tolerance"] is not None and values["save_every"] != 1:
            why = "cannot be combined with run.step_tolerance, which saves every dt"
            raise refuse(f"{path}.save_every", values["save_every"], why, "1")
        return cls(**values)

    def table(self) -> dict[str, Any]:
        """Plain values from which `read` recreates the section."""
        return {**as_table(self), **self.options}


@dataclasses.dataclass(frozen=True, eq=False)
class StartSpec:
    """`[start]`: configuration and velocities at t = 0.

    `static`: the equilibrium under `release_force` on `release_nodes`, which are released at t = 0. `angles`:
    `zero = "horizontal"` (thesis (4.1)): `d = L (cos p cos a, cos p sin a, -sin p)`; `zero = "down"` (thesis (3.1)):
    `d = L (sin p cos a, sin p sin a, -cos p)`, p polar, a azimuth. `positions`: all nodes, both ends included.
    `points`, for a system of lines: free points are held at their positions in the scene, the lines settle between
    them, and all are released at t = 0.
    """

    FIELDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "static": ("release_nodes", "release_force"),
        "angles": ("polar", "azimuth", "polar_rate", "azimuth_rate", "zero"),
        "positions": ("positions", "velocities"),
        "points": (),
    }

    kind: str = option("how the start is given", choices=("static", "angles", "positions", "points"), default="static")
    release_nodes: tuple[int, ...] | None = dataclasses.field(
        metadata={"kind": "option", "meaning": "nodes released at t = 0", "type": tuple, "low": 1}, default=None
    )
    release_force: np.ndarray | None = parameter("forces released at t = 0", unit="N", shape="vectors", optional=True)
    polar: np.ndarray | None = parameter("polar angle of each link", unit="rad", shape="table", optional=True)
    azimuth: np.ndarray | None = parameter("azimuth of each link", unit="rad", shape="table", optional=True)
    polar_rate: np.ndarray | None = parameter("rate of the polar angle", unit="rad/s", shape="table", optional=True)
    azimuth_rate: np.ndarray | None = parameter("rate of the azimuth", unit="rad/s", shape="table", optional=True)
    zero: str | None = option("where the polar angle is zero", choices=("horizontal", "down"), default=None)
    positions: np.ndarray | None = parameter("positions of all nodes", unit="m", shape="vectors", optional=True)
    velocities: np.ndarray | None = parameter("velocities of all nodes", unit="m/s", shape="vectors", optional=True)

    @property
    def is_static(self) -> bool:
        """Whether the run starts from an equilibrium."""
        return self.kind == "static"

    @classmethod
    def read(cls, table: Plain, path: str, line: LineSpec, held: bool, branched: bool = False) -> StartSpec:
        values = read_fields(cls, table, path, {})
        kind = values["kind"]
        allowed = ("static", "points") if branched else ("static", "angles", "positions")
        if kind not in allowed:
            raise refuse(
                f"{path}.kind",
                kind,
                f"does not fit {'a system of lines' if branched else 'one line'}",
                ", ".join(allowed),
            )
        if branched and values["release_nodes"] is not None:
            raise SceneError(
                f"{path}.release_nodes: refers to the nodes of a single line; allowed: none in a system of lines"
            )
        for key in read_table(table, path):
            if key != "kind" and key not in cls.FIELDS[kind]:
                raise SceneError(f"{path}.{key}: not used by kind {kind!r}, which takes {', '.join(cls.FIELDS[kind])}")
        if kind in _COMPLETE:
            _COMPLETE[kind](values, path, line, held)
        return cls(**values)


def _complete_static(values: dict[str, Any], path: str, line: LineSpec, held: bool) -> None:
    nodes, force = values["release_nodes"], values["release_force"]
    if (nodes is None) != (force is None):
        raise SceneError(f"{path}: `release_nodes` and `release_force` belong together, one of them is missing")
    free = line.links - held
    for i, node in enumerate(nodes or ()):
        if node > free:
            raise refuse(f"{path}.release_nodes.{i}", node, "is not a free node", f"1 to {free}")
    if nodes is not None and len(nodes) != len(force):
        raise refuse(f"{path}.release_force", plain(force), f"has {len(force)} vectors", f"{len(nodes)}, one per node")


def _complete_angles(values: dict[str, Any], path: str, line: LineSpec, held: bool) -> None:
    values["zero"] = values["zero"] or "horizontal"
    if values["polar"] is None:
        raise SceneError(f"{path}.polar: missing; needed: a list of {line.links} angles [rad]")
    for key in ("polar", "azimuth", "polar_rate", "azimuth_rate"):
        if values[key] is None:
            values[key] = np.zeros(line.links)
        if len(values[key]) != line.links:
            raise refuse(
                f"{path}.{key}", plain(values[key]), f"has {len(values[key])} entries", f"{line.links}, one per link"
            )


def _complete_positions(values: dict[str, Any], path: str, line: LineSpec, held: bool) -> None:
    rows = line.links + 1
    if values["positions"] is None:
        raise SceneError(f"{path}.positions: missing; needed: {rows} positions [m], both ends included")
    if values["velocities"] is None:
        values["velocities"] = np.zeros((rows, 3))
    for key in ("positions", "velocities"):
        if len(values[key]) != rows:
            raise refuse(
                f"{path}.{key}", plain(values[key]), f"has {len(values[key])} rows", f"{rows}, both ends included"
            )


_COMPLETE = {"static": _complete_static, "angles": _complete_angles, "positions": _complete_positions}


def directions(polar: np.ndarray, azimuth: np.ndarray, zero: str) -> np.ndarray:
    """Unit vectors of links (n, 3) from their angles [rad] (see `StartSpec`)."""
    along, down = (np.cos(polar), np.sin(polar)) if zero == "horizontal" else (np.sin(polar), np.cos(polar))
    return np.stack([along * np.cos(azimuth), along * np.sin(azimuth), -down], axis=-1)
