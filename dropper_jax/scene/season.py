"""`[growth]` of a scene: a season's layer of mussels on the listed lines, at one month."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import partial

import numpy as np

from dropper_jax.base.errors import Check
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection, count, part, plain, read_matrix, short_text

#: Added mass of a mussel divided by that of the displaced water: a sphere's (Lamb 1932, article 92).
ADDED_MASS = 0.5
#: Distance of the grid points of the random thickness, in correlation lengths.
GRID_STEP = 0.1
#: Minimum correlation length [m]: a long line with a shorter one has more grid points than fit into memory.
MIN_CORRELATION = 1e-3
THICKNESS = {"unit": "m", "shape": "table", "low": 0.0}


@section
class SeasonSpec(DeclaredSection):
    """`[growth]`: thickness by month (rows) and depth (columns), linear between, at the requested month.

    `harvested` is the fraction of the layer's cross-section that is removed. `deviation` and `correlation` make the
    thickness random along each line. It is multiplied by `exp(s x - s^2/2)`, `s^2 = log(1 + deviation^2)`, with x a
    normal field whose correlation falls as `exp(-distance/correlation)`. The factor has mean 1, is never negative, and
    depends only on the seed, the line's name and the position, not on the number of links.
    """

    lines: tuple[str, ...] = option("names of lines, * for any letters", type=list)
    month: float = parameter("month of the run", unit="months")
    months: np.ndarray = parameter("months of the rows of `thickness`, rising", unit="months", shape="table", rising=1)
    depth: np.ndarray = parameter("depths below the mean surface, rising", unit="m", shape="table", rising=1)
    density: np.ndarray = parameter(
        "density of the layer, one or one per depth", unit="kg/m^3", shape="numbers", above=0.0
    )
    thickness: np.ndarray = part(partial(read_matrix, declared=THICKNESS), needed="a row for each of `months`, in m")
    harvested: float = parameter("fraction of the layer that is harvested", unit="-", low=0.0, high=1.0, default=0.0)
    harvested_lines: tuple[str, ...] = option("names of the harvested lines", type=list, default=("*",))
    deviation: float = parameter(
        "standard deviation of the thickness divided by its mean", unit="-", low=0.0, default=0.0
    )
    correlation: float = parameter("correlation length of the thickness", unit="m", low=MIN_CORRELATION, default=1.0)
    seed: int = count("seed of the random thickness", low=0, default=0)
    attachment: float | None = parameter("attachment strength of one mussel", unit="N", above=0.0, default=None)
    mussel_mass: float | None = parameter("mass of one mussel", unit="kg", above=0.0, default=None)

    def checks(self) -> Iterator[Check]:
        rows, columns = np.shape(self.thickness)
        yield (
            (rows, columns) != (len(self.months), len(self.depth)),
            f"thickness: has {rows} rows of {columns} numbers; allowed: {len(self.months)} rows, one a month, of "
            f"{len(self.depth)}, one for each of `depth`",
        )
        many = np.size(self.density)
        yield (
            many not in (1, len(self.depth)),
            f"density: {short_text(plain(self.density))} has {many} entries; allowed: 1 or {len(self.depth)}",
        )
        yield (
            not self.months[0] <= self.month <= self.months[-1],
            f"month: {self.month} is out of range; allowed: {self.months[0]:g} to {self.months[-1]:g} months, "
            "as `months`",
        )
        drop_off = ("attachment", "mussel_mass")
        missing = [key for key in drop_off if getattr(self, key) is None]
        for key in missing:
            yield len(missing) == 1, f"{key}: missing; a drop-off needs both `attachment` and `mussel_mass`"
        for key in ("lines", "harvested_lines"):
            yield (
                not getattr(self, key),
                f"{key}: is empty; allowed: one or more names of lines, with * for any letters",
            )

    def line_checks(self, names: list[tuple[str, str | None]]) -> Iterator[Check]:
        """Checks against the names of the scene's lines, and of the lines from which pieces were cut."""
        for key in ("lines", "harvested_lines"):
            for i, pattern in enumerate(getattr(self, key)):
                yield (
                    not any(_matches_any(name, (pattern,)) for name in names),
                    f"{key}.{i}: {pattern!r} does not match any line; allowed: names, with * for any letters",
                )

    def covers(self, name: str, line: str | None) -> bool:
        """Whether there is growth on a line, or on the line from which this piece was cut."""
        return _matches_any((name, line), self.lines)

    def thickness_and_density(self, depth: np.ndarray, month: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Thickness [m] and density [kg/m^3] at depths [m] and a month (default: its own), before any harvest."""
        if month is None:
            month = self.month
        row = np.array([np.interp(month, self.months, column) for column in self.thickness.T])
        density = np.broadcast_to(self.density, self.depth.shape)
        return np.interp(depth, self.depth, row), np.interp(depth, self.depth, density)

    def layer(
        self, name: str, line: str | None, depth: np.ndarray, arc: np.ndarray, bare: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Thickness [m] and density [kg/m^3] on links of a line, after the harvest.

        Args:
            depth, arc: of the links' middles (n,) [m], arc along the line.
            bare: diameters of the bare links (n,) [m].
        """
        thickness, density = self.thickness_and_density(depth)
        thickness = thickness * self.thickness_factor(name, arc)
        if self.harvested and _matches_any((name, line), self.harvested_lines):
            area = (1.0 - self.harvested) * ((bare + 2.0 * thickness) ** 2 - bare**2)
            thickness = 0.5 * (np.sqrt(bare**2 + area) - bare)
        return thickness, density

    def thickness_factor(self, name: str, arc: np.ndarray) -> np.ndarray:
        """Random factor (n,) on the thickness at arc lengths (n,) [m] of a line."""
        if self.deviation == 0.0:
            return np.ones(len(arc))
        # one stream per line, so that adding a line leaves the others unchanged
        stream = np.random.default_rng([self.seed, zlib.crc32(name.encode())])
        spread = np.sqrt(np.log1p(self.deviation**2))
        return np.exp(spread * normal_field(arc / self.correlation, stream) - 0.5 * spread**2)

    def detachment_acceleration(self, density: float, water: float, gravity: float) -> float | None:
        """Acceleration [m/s^2] at which a mussel detaches: `(F - g (m - rho V))/(m + rho V/2)`; None without a force.

        V = m/density. The rope accelerates the mussel; drag on it and the water's own acceleration are neglected.
        """
        if self.attachment is None:
            return None
        displaced = water * self.mussel_mass / density
        left = self.attachment - gravity * (self.mussel_mass - displaced)
        return max(left / (self.mussel_mass + ADDED_MASS * displaced), 0.0)


def normal_field(distance: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Normal numbers of mean 0 and deviation 1 at distances (n,) in correlation lengths, with the correlation
    `exp(-|difference|)`: exactly at grid points, and linear between them."""
    count = int(np.max(distance, initial=0.0) / GRID_STEP) + 2
    correlation = np.exp(-GRID_STEP)  # of two grid points
    field = stream.standard_normal(count)
    field[1:] *= np.sqrt(1.0 - correlation**2)
    for i in range(1, count):
        field[i] += correlation * field[i - 1]
    position = distance / GRID_STEP
    share = position % 1.0
    deviation = np.sqrt(1.0 - 2.0 * (1.0 - correlation) * share * (1.0 - share))  # of the interpolated numbers
    return np.interp(position, np.arange(count), field) / deviation


def _matches_any(name: tuple[str, str | None], patterns: tuple[str, ...]) -> bool:
    """Whether a line, or the line from which it was cut, has a name of these patterns."""
    names = [each for each in name if each is not None]
    return any(fnmatchcase(each, pattern) for each in names for pattern in patterns)
