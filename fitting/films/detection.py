"""Circles in a frame, to a few hundredths of a pixel.

Seeds are local extrema of a difference of two Gaussians, matched to the radius; on a reduced picture this costs a
quarter. Around each seed the edge is found along rays where the brightness crosses half way from the inside to the
outside. A circle is fitted robustly to the edge points: rays on which another marker touches, or a post hides the edge,
are rejected, so that half a circle is enough. Motion blur lengthens a marker equally on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fitting.films.lengths import MEDIAN_TO_DEVIATION
from fitting.films.video import opencv

#: Number of rays around a circle.
RAYS = 48
#: Distance of samples along a ray [pixel].
RAY_STEP = 0.5
#: Radii [pixel] that are tried by default.
RADII = tuple(map(float, np.geomspace(2.5, 40.0, 14)))
#: Radius of the disc to which the difference of two Gaussians responds best, in radii of `_spots`.
RESPONSE_RADIUS = 1.15
#: Minimum fraction of rays that show an edge.
SHOWN_RAYS = 0.55
#: Minimum answer of a seed, over that of the weakest of the markers from which the appearance was learned.
SEED_ANSWER = 0.35
#: Minimum answer of markers over the median of the other spots. Noise reaches 1.3, and discs of 10 grey levels in noise
#: of 5 give 13.
CLEAR_ANSWER = 2.0
#: Minimum answer of a spot [grey].
LEAST_ANSWER = 2.0
#: Length of a ray, and its parts inside and outside the rim between which the edge is half way [radius].
RAY_LENGTH = 1.8
INSIDE_UNTIL = 0.5
OUTSIDE = (1.25, 1.6)
#: Standard deviation of an edge point [pixel].
EDGE_NOISE = 0.1
#: Standard deviation of radii [radius], and a value that fixes them.
RADIUS_SPREAD = 0.04
FIXED_RADIUS = 1e-4
#: Maximum distance of an edge point from the usual radius [radius].
FARTHEST_EDGE = 0.6
#: Fraction of used rays below which an obstacle hides part of the rim.
FULL_RIM = 0.95
#: Shift of the centre over the change of the radius at such an obstacle: 0.9 to 2 behind posts.
HIDDEN_SHIFT = 1.2
#: Minimum and maximum radius of a circle over the usual one [-].
SMALLEST_RADIUS = 0.85
LARGEST_RADIUS = 1.35
#: Minimum contrast of a circle over the usual one [-].
MIN_CONTRAST = 0.6


@dataclass(frozen=True)
class MarkerAppearance:
    """Appearance of a marker: radius [pixel], brighter or darker than its rim, a seed's answer, contrast [grey]."""

    radius: float
    bright: bool
    answer: float
    contrast: float = 0.0


@dataclass(frozen=True)
class Circles:
    """Circles of a frame: centre (m, 2), its standard error, radius [pixel], rays used, contrast [grey], each (m,)."""

    centre: np.ndarray
    error: np.ndarray
    radius: np.ndarray
    rays: np.ndarray
    contrast: np.ndarray

    def __len__(self) -> int:
        return len(self.error)

    def pick(self, which: np.ndarray) -> Circles:
        """Some of them, by a mask or by number."""
        return Circles(
            self.centre[which], self.error[which], self.radius[which], self.rays[which], self.contrast[which]
        )


NO_CIRCLES = Circles(np.zeros((0, 2)), *[np.zeros(0)] * 4)


def learn_appearance(
    image: np.ndarray, nodes: int, radius: float | None = None, bright: bool | None = None
) -> MarkerAppearance:
    """The radius and shade at which the `nodes` strongest spots of a picture stand out most."""
    best = MarkerAppearance(radius or RADII[0], bool(bright), 0.0)
    shades = (True, False) if bright is None else (bright,)
    sizes = RADII if radius is None else (radius / RESPONSE_RADIUS,)
    for shade, size in product(shades, sizes):
        answers = _spots(image, size, shade)[1]
        if len(answers) >= nodes and answers[nodes - 1] > best.answer:
            best = MarkerAppearance(RESPONSE_RADIUS * size, shade, float(answers[nodes - 1]))
    if best.answer < LEAST_ANSWER:
        return replace(best, answer=0.0)
    for _ in range(3):  # the search radius for the rim depends on the radius
        fitted = detect(image, best)
        if len(fitted) < nodes:
            break
        whole = np.lexsort([fitted.error, -fitted.rays])[:nodes]
        answers = _spots(image, best.radius, best.bright)[1]
        best = replace(
            best,
            radius=float(np.median(fitted.radius[whole])),
            answer=float(answers[min(nodes, len(answers)) - 1]),
            contrast=float(np.median(np.sort(fitted.contrast)[-nodes:])),
        )
    return best


def stands_out(image: np.ndarray, appearance: MarkerAppearance, nodes: int) -> bool:
    """Whether the `nodes` strongest spots are clearly stronger than the many similar ones of noise."""
    others = _spots(image, appearance.radius, appearance.bright)[1][2 * nodes :]
    if len(others) < 2 * nodes:
        return appearance.answer > 0
    return appearance.answer > CLEAR_ANSWER * float(np.median(others))


def detect(image: np.ndarray, appearance: MarkerAppearance) -> Circles:
    """Circles that look like markers."""
    where, answers = _spots(image, appearance.radius, appearance.bright)
    return _at(image, appearance, where[answers > SEED_ANSWER * appearance.answer])


def detect_at(image: np.ndarray, appearance: MarkerAppearance, guesses: np.ndarray) -> Circles:
    """Circles at the positions (m, 2) [pixel] where markers are expected, and within a radius around them."""
    height, width = image.shape
    step = 0.7 * appearance.radius * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    seeds = (guesses[:, None] + step).reshape(-1, 2)
    return _at(image, appearance, seeds[((seeds >= 0) & (seeds <= (width - 1, height - 1))).all(axis=1)])


def _at(image: np.ndarray, appearance: MarkerAppearance, seeds: np.ndarray) -> Circles:
    """Circles around the seeds (m, 2) [pixel], fitted again around their centres, each one once."""
    smooth = opencv().GaussianBlur(image, (0, 0), 0.8).astype(np.float32)
    for _ in range(2):
        if not len(seeds):
            return NO_CIRCLES
        circles = _fit(smooth, seeds, appearance)
        seeds = circles.centre
    return _distinct(circles, appearance)


def _spots(image: np.ndarray, radius: float, bright: bool) -> tuple[np.ndarray, np.ndarray]:
    """Local extrema (m, 2) [pixel] and their answers (m,) [grey], strongest first."""
    cv2 = opencv()
    # pictures are reduced to a radius of 4 pixels for the search of seeds
    shrink = max(1.0, radius / 4.0)
    small = image.astype(np.float32)
    if shrink > 1:
        small = cv2.resize(small, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    r = radius / shrink
    # widths of the Gaussians [radius]; their difference responds best to discs `RESPONSE_RADIUS` times as large
    answer = cv2.GaussianBlur(small, (0, 0), 0.6 * r) - cv2.GaussianBlur(small, (0, 0), 1.2 * r)
    if not bright:
        answer = -answer
    reach = 2 * int(np.ceil(0.7 * r)) + 1
    where = np.argwhere((answer == cv2.dilate(answer, np.ones((reach, reach), np.uint8))) & (answer > 0))
    strength = answer[tuple(where.T)]
    order = np.argsort(-strength)[:200]
    factor = np.array(image.shape) / small.shape
    return ((where[order] + 0.5) * factor - 0.5)[:, ::-1], strength[order]


def _fit(image: np.ndarray, seeds: np.ndarray, appearance: MarkerAppearance) -> Circles:
    """A circle around each seed (m, 2); those without enough of an edge are omitted."""
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.arange(0.0, RAY_LENGTH * appearance.radius + RAY_STEP, RAY_STEP)
    edge, contrast = _edges(_brightness(image, seeds, ray, along), along, appearance)
    centre, radius, error, used = _circle(edge, ray, appearance.radius)
    size = radius / appearance.radius
    good = (used >= SHOWN_RAYS) & (size > SMALLEST_RADIUS) & (size < LARGEST_RADIUS)
    good &= (np.hypot(*centre.T) < appearance.radius) & (contrast > MIN_CONTRAST * appearance.contrast)
    return Circles(seeds + centre, error, radius, used, contrast).pick(good)


def _brightness(image: np.ndarray, seeds: np.ndarray, ray: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Samples (m, rays, k), bilinear; beyond the picture the nearest pixel."""
    position = seeds[:, None, None] + along[:, None] * ray[:, None]
    flat = position.reshape(-1, along.size, 2).astype(np.float32)
    cv2 = opencv()
    # in pieces: remap takes pictures of less than 32768 rows
    parts = []
    for part in np.array_split(flat, max(1, len(flat) // 20000)):
        parts.append(cv2.remap(image, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    return np.concatenate(parts).reshape(len(seeds), RAYS, along.size)


def _edges(light: np.ndarray, along: np.ndarray, appearance: MarkerAppearance) -> tuple[np.ndarray, np.ndarray]:
    """Distance (m, rays) at which each ray crosses half way from inside to outside, otherwise NaN; contrast (m,)."""
    if not appearance.bright:
        light = -light
    at = along / appearance.radius
    inside = np.median(light[..., at <= INSIDE_UNTIL], axis=(1, 2))
    outside = np.median(light[..., (at > OUTSIDE[0]) & (at < OUTSIDE[1])], axis=(1, 2))
    contrast = inside - outside
    over = light - (0.5 * (inside + outside))[:, None, None]
    last = np.argmin(over > 0, axis=2)  # the first sample beyond the edge
    known = (over[..., 0] > 0) & (last > 0) & (contrast > 0.3 * appearance.answer)[:, None]
    last = np.maximum(last, 1)[..., None]
    before = np.take_along_axis(over, last - 1, axis=2)[..., 0]
    after = np.take_along_axis(over, last, axis=2)[..., 0]
    step = np.where(after == before, 1.0, before - after)
    return np.where(known, along[last[..., 0] - 1] + RAY_STEP * before / step, np.nan), contrast


def _circle(edge: np.ndarray, ray: np.ndarray, usual: float) -> tuple[np.ndarray, ...]:
    """Centres (m, 2) relative to the seeds, radii, standard errors [pixel], fractions of rays used.

    To first order in the offset c, an edge point lies at `radius + c . ray` along its ray; the radius is known to a few
    per cent from the other circles.
    """
    design = np.column_stack([ray, np.ones(RAYS)])
    value = np.where(np.isfinite(edge), edge, usual) - usual
    used = _rim_rays(np.isfinite(edge) & (np.abs(value) < FARTHEST_EDGE * usual), design, value, usual)
    off, found = _solve(design, used / EDGE_NOISE**2, value, RADIUS_SPREAD * usual)
    count = used.sum(axis=1)
    variance = (used * off**2).sum(axis=1) / np.maximum(count - 2, 1)
    inverse = np.linalg.inv(np.einsum("mr,ri,rj->mij", used, ray, ray) + 1e-9 * np.eye(2))
    # neighbouring rays share pixels: at most one independent edge point per pixel of the rim
    shared = max(1.0, RAYS / (2 * np.pi * usual))
    error = np.sqrt(shared * variance * 0.5 * np.trace(inverse, axis1=1, axis2=2))
    # an obstacle that hides part of the rim shifts the centre and reduces the radius
    error = np.where(count < FULL_RIM * RAYS, np.hypot(error, HIDDEN_SHIFT * found[:, 2]), error)
    return found[:, :2], usual + found[:, 2], np.maximum(error, 1e-3), count / RAYS


def _rim_rays(near: np.ndarray, design: np.ndarray, value: np.ndarray, usual: float) -> np.ndarray:
    """Which rays (m, rays), of those whose edge is `near` the usual radius, show the rim.

    The sum of absolute deviations is minimised (by reweighting), so that the edge of a post that cuts off up to a third
    of the rays has no influence. Rays beyond three standard deviations are rejected.
    """
    weight = near / EDGE_NOISE**2
    for _ in range(8):
        off, _ = _solve(design, weight, value, FIXED_RADIUS * usual)
        weight = near / (EDGE_NOISE * np.maximum(np.abs(off), EDGE_NOISE))
    off = np.where(near, np.abs(off), np.nan)
    off[~near.any(axis=1)] = np.inf
    spread = MEDIAN_TO_DEVIATION * np.nanmedian(off, axis=1, keepdims=True)
    return off < np.maximum(3 * spread, 2 * EDGE_NOISE)


def _solve(design: np.ndarray, weight: np.ndarray, value: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (m, rays) and coefficients (m, 3) of weighted least squares, with the `spread` [pixel] of radii."""
    prior = np.diag([1e-9, 1e-9, 1 / spread**2])  # the centre is free
    normal = np.einsum("mr,ri,rj->mij", weight, design, design) + prior
    found = np.linalg.solve(normal, np.einsum("mr,ri,mr->mi", weight, design, value)[..., None])[..., 0]
    return value - found @ design.T, found


def _distinct(circles: Circles, appearance: MarkerAppearance) -> Circles:
    """One circle of each group whose centres nearly coincide: that with the most rays, then the smallest error."""
    kept: list[int] = []
    for i in np.lexsort([circles.error, -np.round(circles.rays, 1)]):
        apart = np.hypot(*(circles.centre[kept] - circles.centre[i]).T)
        if (apart > 0.5 * appearance.radius).all():
            kept.append(i)
    return circles.pick(np.array(kept, int))
