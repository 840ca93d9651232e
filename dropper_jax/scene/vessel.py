"""Barges and vessels of a scene, moved by response amplitude operators or by a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, replace
from functools import partial

import numpy as np

from dropper_jax.base.errors import Check, raise_first
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    Values,
    as_table,
    check_keys,
    part,
    plain,
    read_fields,
    read_positions,
    read_rows,
    read_table,
    section_keys,
)
from dropper_jax.scene.body import rotation

#: Motions of a vessel in its own axes: translations of the reference point, then rotations.
MOTIONS = ("surge", "sway", "heave", "roll", "pitch", "yaw")


@section
class RaoSpec(DeclaredSection):
    """`vessel.rao`: motion over the elevation at the reference point, by frequency and relative heading of the waves.

    Attributes:
        amplitude, phase: (headings, frequencies, 6), by `MOTIONS`; omitted values are zero.
    """

    frequency: np.ndarray = parameter("angular frequencies, rising", unit="rad/s", shape="table", low=0.0, rising=1)
    headings: np.ndarray = parameter(
        "directions of wave travel, from the vessel's x towards its y, rising", unit="rad", shape="table", rising=1
    )
    phases: str = option(
        "sign of the phases: positive if the motion leads, or if it lags the elevation", choices=("lead", "lag")
    )
    amplitude: np.ndarray = field(default_factory=partial(np.zeros, 0))
    phase: np.ndarray = field(default_factory=partial(np.zeros, 0))

    @classmethod
    def read(cls, table: Plain, path: str) -> RaoSpec:
        own = dict(read_table(table, path))
        tables = [*MOTIONS, *(f"{name}_phase" for name in MOTIONS)]
        check_keys(own, [*section_keys(cls), *tables], path)
        given = {key: own.pop(key) for key in tables if key in own}
        spec = cls(**read_fields(cls, own, path, {}))
        raise_first(spec._checks(given), path)
        values = np.stack([spec._rows(given, key, path) for key in tables], axis=-1)
        return replace(spec, amplitude=values[..., :6], phase=values[..., 6:])

    def _checks(self, given: Values) -> Iterator[Check]:
        yield (
            not any(name in given for name in MOTIONS),
            f": has no motion; allowed: one or more of {', '.join(MOTIONS)}",
        )
        for name in MOTIONS:
            yield (
                f"{name}_phase" in given and name not in given,
                f"{name}_phase: is given without `{name}`; allowed: both or neither",
            )

    def _rows(self, given: Table, key: str, path: str) -> np.ndarray:
        """Values of one motion (headings, frequencies)."""
        headings = len(self.headings)
        frequencies = len(self.frequency)
        if key not in given:
            return np.zeros((headings, frequencies))
        rows = plain(given[key])
        while not (isinstance(rows, list) and rows and isinstance(rows[0], list)):  # a number, or one row
            rows = [rows]
        limits = {"low": 0.0}
        if key.endswith("_phase"):
            limits = {}
        allowed = f"{frequencies} numbers, one for each `frequency`; one row for each of `headings`"
        return read_rows(rows, f"{path}.{key}", limits, frequencies, allowed, headings)

    def table(self) -> Table:
        """Plain values by key; motions that are zero are left out."""
        found = as_table(self)
        for i, name in enumerate(MOTIONS):
            if np.any(self.amplitude[..., i]):
                found[name] = self.amplitude[..., i].tolist()
                found[f"{name}_phase"] = self.phase[..., i].tolist()
        return found

    def full_circle(self) -> RaoSpec:
        """The same with its first row repeated a full turn later, if its headings cover the full circle."""
        gap = self.headings[0] + 2 * np.pi - self.headings[-1]
        if not 1e-9 < gap <= np.max(np.diff(self.headings), initial=0.0) * (1 + 1e-9):
            return self
        return replace(
            self,
            headings=np.append(self.headings, self.headings[0] + 2 * np.pi),
            amplitude=np.concatenate([self.amplitude, self.amplitude[:1]]),
            phase=np.concatenate([self.phase, self.phase[:1]]),
        )

    def nearest_turn(self, heading: np.ndarray) -> np.ndarray:
        """Headings (c,) of waves, shifted by full turns to lie within the table or nearest to it."""
        principal = (heading + np.pi) % (2 * np.pi) - np.pi
        shifted = principal[:, None] + 2 * np.pi * np.array([0, 1, -1, 2, -2])
        outside = np.maximum(np.maximum(self.headings[0] - shifted, shifted - self.headings[-1]), 0.0)
        return np.take_along_axis(shifted, np.argmin(outside, axis=1)[:, None], axis=1)[:, 0]

    def response(self, omega: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Complex motions (c, 6) over the elevation of components, phases leading; linear between the entries."""
        sign = {"lead": 1j, "lag": -1j}[self.phases]
        values = self.amplitude * np.exp(sign * self.phase)
        rows = np.apply_along_axis(lambda row: np.interp(omega, self.frequency, row), 1, values)  # (headings, c, 6)
        if len(self.headings) == 1:
            return rows[0]
        below = np.clip(np.searchsorted(self.headings, heading) - 1, 0, len(self.headings) - 2)
        fraction = np.clip((heading - self.headings[below]) / np.diff(self.headings)[below], 0.0, 1.0)[:, None]
        component = np.arange(len(omega))
        return (1.0 - fraction) * rows[below, component] + fraction * rows[below + 1, component]


#: Reader of the rows of a table of motion (k, 6).
_read_motion = partial(read_rows, declared={}, count=6, allowed=f"6 numbers, {', '.join(MOTIONS)}")


@section
class VesselSpec(DeclaredSection):
    """`[[vessel]]`: a large floating structure that lines do not move; positions are in its axes, from its reference
    point."""

    name: str = option("name", type=str)
    position: np.ndarray = parameter("mean position of its reference point", unit="m", shape="vector")
    heading: float = parameter(
        "direction of its x-axis from x towards y", unit="rad", low=-6.29, high=6.29, default=0.0
    )
    time: np.ndarray = parameter("times of a table of its motion", unit="s", shape="table", rising=2, default=None)
    motion: np.ndarray = part(_read_motion, default=None)
    rao: RaoSpec | None = part(RaoSpec.read, default=None)
    attachments: dict[str, np.ndarray] = part(read_positions, default_factory=dict)

    def checks(self) -> Iterator[Check]:
        time = self.time
        yield (
            not self.attachments,
            "attachments: missing; needed: names of points with their positions on the vessel",
        )
        yield (
            (self.motion is None) == (self.rao is None) or (self.motion is None) != (time is None),
            ": give either `rao`, or `time` and `motion`",
        )
        if time is not None:
            rows = len(self.motion)
            yield len(time) != rows, f"time: has {len(time)} entries; allowed: {rows}, one for each row of `motion`"

    @property
    def rotation(self) -> np.ndarray:
        """Its axes in the scene's (3, 3), at its mean position."""
        return rotation([0.0, 0.0, self.heading])

    def world(self, position: np.ndarray) -> np.ndarray:
        """Mean position in the scene of a position (3,) in its own axes."""
        return self.position + self.rotation @ position
