"""Angles of links from node positions, continuous in time, also through the pole where a dropper hangs.

A link vector d of length L has, in the two conventions for `zero`,

    "horizontal"   d = L (cos p cos a, cos p sin a, -sin p)    polar p from the horizontal, positive downwards
    "down"         d = L (sin p cos a, sin p sin a, -cos p)    polar p from the downward vertical

with the same azimuth a, so `p_down = pi/2 - p_horizontal`. Every direction has two representations, (p, a) and (pi - p,
a + pi) (first convention), each up to full turns, and a vertical link has no azimuth. The branch is chosen as follows:

1. At a pole (horizontal part of d below 1e-12 of its largest component) the azimuth is the last one known. Before any
is known, it is the first one that will be; if the link is vertical throughout, 0. A link of zero length keeps both
angles.
2. The first azimuth lies in (-pi/2, pi/2], so motion in the x-z plane has azimuth 0 and a signed polar angle.
3. From one sample to the next the representation with the smaller `dp^2 + da^2` is taken, both differences as the
shortest turn. A link that swings through the pole keeps its azimuth and its polar angle continues; the azimuth does not
jump by pi. Which representations of two samples belong together does not depend on earlier choices, so the whole
history is one comparison and one cumulative sum.

Limits: the samples must be close enough to resolve the path of the link: in a plane less than half a turn between two
samples, in space less than a quarter turn of azimuth. A link that passes the pole at a small distance turns its azimuth
by nearly pi. Whether that appears as a fast turn or as a continuing polar angle depends on the sampling; both describe
the same directions. Samples that are not finite give NaN there and are skipped in rule 3; nothing else gives NaN.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import read_text

ZEROS = ("horizontal", "down")
ANGLES = ("polar", "azimuth")


class _Branch(NamedTuple):
    """Horizontal-zero angles (k, n) [rad] and where they are not defined by the link itself (k, n)."""

    polar: np.ndarray
    azimuth: np.ndarray
    pole: np.ndarray
    bad: np.ndarray


def link_angles(positions: np.ndarray, zero: str = "horizontal") -> tuple[np.ndarray, np.ndarray]:
    """Polar angle and azimuth of every link, continuous in time (rules and limits: see the module's text).

    Args:
        positions: (k, n + 1, 3) [m] for k instants, or (n + 1, 3) for one.
        zero: "horizontal" (positive downwards) or "down" (from the downward vertical).

    Returns:
        polar, azimuth: each (k, n) [rad], or (n,) for one instant.

    Raises:
        ValueError: unknown `zero`, or positions of another shape.
    """
    read_text(zero, "zero", ZEROS)
    branch = _follow(_links(positions, "positions"))
    shape = _shape_of_links(positions)
    return _polar_from(branch.polar, zero).reshape(shape), branch.azimuth.reshape(shape)


def angle_rates(
    positions: np.ndarray, velocities: np.ndarray, zero: str = "horizontal"
) -> tuple[np.ndarray, np.ndarray]:
    """Rates of the angles of `link_angles`, along the same branch.

    With `e_p = dd/dp / L` and `e_a = (-sin a, cos a, 0)`: `p' = d' . e_p / L` and `a' = d' . e_a / (horizontal part)`.
    At a pole the azimuth is held, so its rate is 0 there. The polar rate is that of the motion in the plane of the held
    azimuth; a velocity across that plane is ignored. A link of zero length has rates 0.

    Args:
        positions, velocities: (k, n + 1, 3) or (n + 1, 3) [m], [m/s].
        zero: as in `link_angles`.

    Returns:
        polar_rate, azimuth_rate: each (k, n) or (n,) [rad/s].

    Raises:
        ValueError: unknown `zero`, or shapes that do not match.
    """
    read_text(zero, "zero", ZEROS)
    links = _links(positions, "positions")
    rates = _links(velocities, "velocities")
    if np.shape(positions) != np.shape(velocities):
        raise ValueError(f"velocities: shape {np.shape(velocities)}, must be that of positions, {np.shape(positions)}")
    with np.errstate(invalid="ignore", over="ignore"):
        polar_rate, azimuth_rate = _rates(links, rates, _follow(links))
    if zero == "down":
        polar_rate = -polar_rate
    shape = _shape_of_links(positions)
    return polar_rate.reshape(shape), azimuth_rate.reshape(shape)


def _rates(links: np.ndarray, rates: np.ndarray, branch: _Branch) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal-zero angle rates (k, n) of links (k, n, 3) and their rates; NaN where the links are not finite."""
    polar, azimuth, pole, bad = branch
    size = np.where(bad, 1.0, np.linalg.norm(links, axis=-1))
    along = np.cos(azimuth) * rates[..., 0] + np.sin(azimuth) * rates[..., 1]
    across = np.cos(azimuth) * rates[..., 1] - np.sin(azimuth) * rates[..., 0]
    polar_rate = np.where(bad, 0.0, -np.sin(polar) * along - np.cos(polar) * rates[..., 2]) / size
    signed_radius = np.cos(azimuth) * links[..., 0] + np.sin(azimuth) * links[..., 1]
    azimuth_rate = np.where(pole, 0.0, across / np.where(pole, 1.0, signed_radius))
    lost = np.isnan(polar)
    return np.where(lost, np.nan, polar_rate), np.where(lost, np.nan, azimuth_rate)


def angles_to_links(
    polar: np.ndarray, azimuth: np.ndarray, length: np.ndarray | float, zero: str = "horizontal"
) -> np.ndarray:
    """Link vectors (..., n, 3) [m] from angles (..., n) [rad] and lengths (n,) or a number [m].

    The inverse of `link_angles`; `np.cumsum` of the result along the links gives the nodes relative to the first one.
    """
    read_text(zero, "zero", ZEROS)
    down = np.asarray(polar, float)
    if zero == "horizontal":
        down = np.pi / 2 - down
    azimuth = np.asarray(azimuth, float)
    flat = np.sin(down)
    up = -np.cos(down)
    unit = np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), up), axis=-1)
    return unit * np.asarray(length, float)[..., None]


def phase_curve(
    positions: np.ndarray, velocities: np.ndarray, link: int = 0, zero: str = "horizontal", angle: str = "polar"
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and rate of one link along a motion.

    Args:
        positions, velocities: (k, n + 1, 3) [m], [m/s].
        link: which, 0 .. n - 1; negative counts from the last.
        zero: convention of the polar angle, see `link_angles`.
        angle: "polar" or "azimuth".

    Returns:
        angle (k,) [rad] and rate (k,) [rad/s].

    Raises:
        ValueError: no such link, another `zero` or `angle`.
    """
    read_text(angle, "angle", ANGLES)
    positions = np.asarray(positions)
    velocities = np.asarray(velocities)
    links = positions.shape[1] - 1
    if not -links <= link < links:
        raise ValueError(f"link = {link}: must be from {-links} to {links - 1}")
    nodes = [link % links, link % links + 1]
    which = ANGLES.index(angle)
    values = link_angles(positions[:, nodes], zero)[which]
    rates = angle_rates(positions[:, nodes], velocities[:, nodes], zero)[which]
    return values[:, 0], rates[:, 0]


#: Horizontal part of a link vector, relative to its largest component, below which its azimuth is rounding noise.
VERTICAL = 1e-12


def _follow(links: np.ndarray) -> _Branch:
    """The branch of link vectors (k, n, 3)."""
    missing = ~np.isfinite(links).all(axis=-1)
    links = np.where(missing[..., None], 0.0, links)
    largest = np.abs(links).max(axis=-1)
    bad = largest == 0.0
    links = links / np.where(bad, 1.0, largest)[..., None]
    radius = np.hypot(links[..., 0], links[..., 1])
    pole = radius <= VERTICAL
    polar = _hold(np.arctan2(-links[..., 2], radius), bad)
    azimuth = _hold(np.arctan2(links[..., 1], links[..., 0]), pole)
    azimuth = np.where(pole.all(axis=0), 0.0, azimuth)
    polar, azimuth = _continue(polar, azimuth)
    return _Branch(np.where(missing, np.nan, polar), np.where(missing, np.nan, azimuth), pole, bad)


def _hold(values: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Values (k, n) with unknown samples replaced by the last known one, leading ones by the first known one."""
    rows = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(unknown, -1, rows), axis=0)
    first = np.argmin(unknown, axis=0)
    return np.take_along_axis(values, np.where(last < 0, first, last), axis=0)


def _continue(polar: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rules 2 and 3 for principal values (k, n): polar in [-pi/2, pi/2], azimuth in [-pi, pi]."""
    # a first azimuth within rounding of -pi/2 or pi/2 is pi/2: noise in x must not choose the sign of the polar angle
    edge = 1e-9
    turn = np.diff(azimuth, axis=0)
    keep = np.diff(polar, axis=0) ** 2 + _shortest(turn) ** 2
    swap = _shortest(np.pi - polar[1:] - polar[:-1]) ** 2 + _shortest(turn + np.pi) ** 2
    first = (azimuth[:1] > np.pi / 2 + edge) | (azimuth[:1] <= edge - np.pi / 2)
    swapped = np.cumsum(np.concatenate([first, swap < keep]), axis=0) % 2 == 1
    polar = np.unwrap(np.where(swapped, np.pi - polar, polar), axis=0)
    # Half turns are counted and added once, so that motion in the x-z plane has an azimuth of exactly 0.
    start = np.where(azimuth[:1] > 0, -1, 1) * np.pi
    named = np.where(swapped, azimuth + start, azimuth)
    halves = np.rint((np.unwrap(named, axis=0) - azimuth) / np.pi)
    return polar - 2 * np.pi * np.ceil((polar[:1] - np.pi) / (2 * np.pi)), azimuth + halves * np.pi


def _polar_from(polar: np.ndarray, zero: str) -> np.ndarray:
    """Horizontal-zero polar angles (k, n) in the requested convention, the first one in (-pi, pi]."""
    if zero == "horizontal":
        return polar
    down = np.pi / 2 - polar
    start = np.nan_to_num(down[:1])
    return down - 2 * np.pi * np.ceil((start - np.pi) / (2 * np.pi))


def _shortest(angle: np.ndarray) -> np.ndarray:
    """The angle as the shortest turn, in [-pi, pi]."""
    return angle - 2 * np.pi * np.rint(angle / (2 * np.pi))


def _shape_of_links(positions: np.ndarray) -> tuple[int, ...]:
    """(k, n) or, for one instant, (n,)."""
    *instants, nodes, _ = np.shape(positions)
    return (*instants, nodes - 1)


def _links(nodes: np.ndarray, name: str) -> np.ndarray:
    """Vectors (k, n, 3) from node to node of positions or velocities (k, n + 1, 3), or (n + 1, 3) with k = 1."""
    nodes = np.asarray(nodes, float)
    if nodes.ndim not in (2, 3) or nodes.shape[-1] != 3 or nodes.shape[-2] < 2 or len(nodes) == 0:
        raise ValueError(f"{name}: shape {nodes.shape}, must be (k, n + 1, 3) or (n + 1, 3) with n >= 1")
    # A run that diverged contains infinities: their differences are NaN, and `_follow` skips them.
    with np.errstate(invalid="ignore", over="ignore"):
        return np.diff(nodes.reshape(-1, *nodes.shape[-2:]), axis=1)
